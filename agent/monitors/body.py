"""Monitors of what the arm does as a whole: workspace, torques at their limits, load over time."""

from __future__ import annotations

import math

from agent.modes import Mode
from agent.monitors.bounds import Bounds
from agent.monitors.tick import Tick, digits, sentence
from agent.phases import ALONE
from agent.safety import Flag

LIMITED_TICKS = 100
LOAD_EVERY_S = 0.1
AT_LIMIT = 1.0 + 1e-9  # a shift that has stopped at its limit is rounded
_AXES = "xyz"


class Start:
    """Before the motion the object, as this arm sees it, is near its stated start; asked of arms that align themselves.

    Their motion begins where the object is.
    """

    def __init__(self, bounds: Bounds) -> None:
        self._start_m, self._start_rad = bounds.start_m, bounds.start_rad

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        if at.mode is not Mode.READY:
            return ""
        shift = at.outcome.memory.shift
        off_m, off_rad = math.hypot(*shift[:3]), math.hypot(*shift[3:])
        if off_m <= AT_LIMIT * self._start_m and off_rad <= AT_LIMIT * self._start_rad:
            return ""
        mm, mrad, most_mm, most_mrad = (1e3 * x for x in (off_m, off_rad, self._start_m, self._start_rad))
        m, rad = digits(1, mm, most_mm), digits(0, mrad, most_mrad)
        return sentence(
            "start of the object", f"{mm:.{m}f} mm and {mrad:.{rad}f} mrad from where the cell states it",
            f"at most {most_mm:g} mm and {most_mrad:g} mrad",
            "put it there; or look for another arm on this port, or a base, a grasp, a joint's zero that is not the "
            "file's; safety.start_error_max_m and start_error_max_rad bound it",
        )  # fmt: skip


class Workspace:
    """The object's origin, as this arm sees it, stays in a box in the world; asked while the arm holds it."""

    def __init__(self, bounds: Bounds) -> None:
        self._box = bounds.workspace_m

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        terms = at.outcome.terms
        if terms is None or at.mode in ALONE:
            return ""
        for axis, x, (low, high) in zip(_AXES, terms.kinematics.p_object, self._box, strict=True):
            if not low <= x <= high:
                n = digits(3, x, low, high)
                return sentence(
                    f"{axis} of the object", f"{x:.{n}f} m", f"{low:.{n}f} to {high:.{n}f} m",
                    "see what moved it; safety.monitors.workspace_m sets the box",
                )  # fmt: skip
        return ""


class Limited:
    """A flag of the last word on torques stands in no more than a share of the last ticks."""

    def __init__(self, bounds: Bounds, flag: Flag, what: str) -> None:
        self._bit, self._what = int(flag), what
        self._most = bounds.limited_share * LIMITED_TICKS
        self._ticks = [0] * LIMITED_TICKS
        self._place = self._count = 0

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        now = 1 if int(at.outcome.flags) & self._bit else 0
        place, ticks = self._place, self._ticks
        if now != ticks[place]:
            self._count += now - ticks[place]
            ticks[place] = now
        self._place = place + 1 if place + 1 < LIMITED_TICKS else 0
        if self._count <= self._most:
            return ""
        carries = self._bit == Flag.SATURATED and at.mode not in ALONE
        limp = "a neighbour that is limp, or " if carries else ""
        return sentence(
            self._what, f"in {self._count} of the last {LIMITED_TICKS} cycles", f"at most {self._most:.0f}",
            f"see `coop check` for the torque that the motion needs, and look for {limp}what the arm pushes against",
        )  # fmt: skip


class Load:
    """No joint's torque is, in the mean of its square, above a share of stall for longer than windings bear."""

    def __init__(self, bounds: Bounds) -> None:
        self._joints = bounds.joints
        self._square = bounds.load_share**2
        self._per_stall = [1.0 / stall for stall in bounds.stall_Nm]
        self._every = max(1, round(LOAD_EVERY_S / bounds.period_s))
        self._rate = self._every * bounds.period_s / bounds.load_time_s
        self._heat = [0.0] * len(bounds.joints)  # mean square of the share
        self._tick = 0

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        self._tick += 1
        if self._tick % self._every:
            return ""
        heat = self._heat
        for j, (tau, per_stall) in enumerate(zip(at.tau, self._per_stall, strict=True)):
            heat[j] += self._rate * ((tau * per_stall) ** 2 - heat[j])
        worst = max(heat)
        return "" if worst <= self._square else loaded(self._joints[heat.index(worst)], worst, self._square)


def loaded(what: str, found: float, bound: float) -> str:
    """What to say of a mean square of shares above its bound."""
    return sentence(
        f"load of {what}", f"{math.sqrt(found):.0%} of stall in the mean", f"at most {math.sqrt(bound):.0%}",
        "support the object and let the arm cool; a lighter object, a stronger arm or a pose with less load",
    )  # fmt: skip
