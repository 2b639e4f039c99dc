"""Changes written by hand: those that got through once, and those that a syntax tree does not suggest."""

from __future__ import annotations

from collections.abc import Mapping

Change = tuple[str, str]  # what stands in the module once, and what it becomes

BY_HAND: Mapping[str, tuple[Change, ...]] = {
    "agent.safety": (
        ("flags |= _NOT_FINITE", "flags ^= _NOT_FINITE"),  # lost when two joints have no number
    ),
    "agent.loop": (("SINGULAR_MARGIN = 1.5", "SINGULAR_MARGIN = 1.0"),),
    "agent.control.errors": (("return 2.0 * math.atan2", "return math.atan2"),),  # OFF_TRACK's angle halved
    "agent.runner": (
        (" | Flag.OFF_TRACK", ""),
        ("if lost <= patience.hold:", "if lost < patience.hold:"),
        ("lost > patience.repeat", "lost >= patience.repeat"),
        ("late_ns > period_ns", "late_ns > 2 * period_ns"),
    ),
    "agent.cycles": (
        ("if lost <= patience.blind:", "if lost < patience.blind:"),
        ("share >= self._patience.success_min", "share > self._patience.success_min"),
    ),
    "agent.operator.socket": (("if uid not in (0, os.getuid()):", "if False:"),),
}
