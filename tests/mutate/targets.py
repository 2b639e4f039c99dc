"""Which tests answer for which module."""

from __future__ import annotations

from dataclasses import dataclass

UNIT = "tests/unit"


@dataclass(frozen=True)
class Target:
    """A module and the tests that must notice every change to it; generate: whether changes are generated."""

    module: str
    tests: tuple[str, ...]
    generate: bool = True


TARGETS = (
    Target("agent.safety", (f"{UNIT}/test_safety.py",)),
    Target("agent.modes", (f"{UNIT}/test_modes.py",)),
    Target("agent.loop", (f"{UNIT}/test_step.py", f"{UNIT}/test_singular.py")),
    Target("agent.runner", (f"{UNIT}/test_runner.py",)),
    Target("agent.operator.socket", (f"{UNIT}/operator",)),
)
