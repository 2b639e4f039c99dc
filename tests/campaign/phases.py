"""Every phase of a session met by a stop, dead agents, lost power and a lost port: what arms do, how they come back.

`python -m tests.campaign.phases [stop,kill-one,kill-all,power-one,power-all,dip-one,unplug-blink,unplug-second,
unplug-gone]`: a line per phase and event, exit 1 where an arm that obeys is not back at its rest, one without power or
port is not given up, or the object is not where it stood.  An arm that carried nothing and was limp for most of a
second has fallen from its path: it stands, and says that a person must bring it to its rest.  Five minutes of CPU.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

import configs
from agent.config.cell import load_cell
from agent.modes import Mode
from agent.operator.table import Verb
from tests.soak.watch import say
from tests.support.servos.phase_rig import At, PhaseRun, Step

QUICK = [
    "session.speed_max_rad_per_s=2.0", "session.back_off_m=0.04", "session.lift_m=0.015", "session.lift_s=0.8",
    "session.lower_s=0.7", "session.take_up_s=0.3", "session.ease_s=0.3", "duration_s=2.0",
]  # fmt: skip
LIMIT_S, SET_DOWN_M, LOOK_S = 9.0, 3e-3, 0.3
GIVEN_UP_S = 4.0
FALLEN = "rad from the arm's path"
CARRY = [Step(Mode.READY, Verb.START, Mode.TRACK, 0.35)]
HELD = [*CARRY, Step(Mode.TRACK, Verb.STOP, Mode.HOLD, 0.5)]
LET_GO = [Step(Mode.READY, Verb.STOP, Mode.HOLD, 0.35), Step(Mode.HOLD, Verb.RELEASE, Mode.RELEASE)]


class Phase(NamedTuple):
    """How to get into the middle of a phase."""

    begins: At
    steps: Sequence[Step]
    mode: Mode
    after_s: float


PHASES = {
    "REST": Phase(At.REST, [], Mode.REST, 0.1),
    "APPROACH": Phase(At.REST, [Step(Mode.REST, Verb.APPROACH, Mode.APPROACH)], Mode.APPROACH, 0.6),
    "GRASP": Phase(At.GRASP, [Step(Mode.APPROACH, Verb.GRASP, Mode.GRASP)], Mode.GRASP, 0.25),
    "READY, load going over": Phase(At.GRIPPED, [], Mode.READY, 0.15),
    "TRACK": Phase(At.GRIPPED, CARRY, Mode.TRACK, 0.5),
    "HOLD": Phase(At.GRIPPED, HELD, Mode.HOLD, 0.15),
    "LOWER": Phase(At.GRIPPED, [*HELD, Step(Mode.HOLD, Verb.LOWER, Mode.LOWER, 0.1)], Mode.LOWER, 0.3),
    "RELEASE, load going over": Phase(At.GRIPPED, LET_GO, Mode.RELEASE, 0.12),
    "RELEASE, gripper opening": Phase(At.GRIPPED, LET_GO, Mode.RELEASE, 0.5),
    "PARK": Phase(At.GRASP, [Step(Mode.APPROACH, Verb.PARK, Mode.PARK)], Mode.PARK, 0.5),
    "HALT": Phase(At.GRASP, [Step(Mode.APPROACH, Verb.STOP, Mode.HALT)], Mode.HALT, 0.2),
}
EVENTS: dict[str, Callable[[PhaseRun], None]] = {
    "stop": PhaseRun.interrupt,
    "kill-one": lambda rig: rig.kill("left"),
    "kill-all": PhaseRun.kill,
    "power-one": lambda rig: rig.power("left", on=False),
    "power-all": lambda rig: rig.power("left", "right", on=False),
    "dip-one": lambda rig: rig.dip("left"),
    "unplug-blink": lambda rig: rig.unplug("left", 0.1),
    "unplug-second": lambda rig: rig.unplug("left", 1.0),
    "unplug-gone": lambda rig: rig.unplug("left"),
}
LOST = {"power-one": {"left"}, "power-all": {"left", "right"}, "dip-one": {"left"}, "unplug-gone": {"left"}}


def _met(rig: PhaseRun, lost: set[str], *, falls: bool) -> str:
    """What is wrong; empty where nothing is.  falls: an arm without an object may have fallen from its path."""
    away = [name for name in rig.arms if name not in lost and rig.way(name)[-2] is not Mode.REST]
    fallen = [
        name for name in away if falls and rig.way(name)[-2] is Mode.HALT and FALLEN in rig.arms[name].refused[-1]
    ]
    if away != fallen:
        return f"not back: {', '.join(away)}"
    if kept := [name for name in lost if rig.arms[name].modes[-1][0] > rig.step_ns[-1] * 1e-9 + GIVEN_UP_S]:
        return f"not given up: {', '.join(kept)}"
    if not lost and rig.world.set_down_error()[0] > SET_DOWN_M:
        return f"set down {rig.world.set_down_error()[0] * 1e3:.1f} mm off"
    return ""


def _step_share(rig: PhaseRun) -> float:
    shares = [
        np.abs(np.diff(arm.rows["tau_limited"][:, : arm.agent.model.n], axis=0)) / arm.agent.limits.tau_step_max_Nm
        for arm in rig.arms.values()
    ]
    return max(float(np.nanmax(share)) for share in shares)


def main(events: Sequence[str]) -> int:
    """Go through all phases; the number of lines with something wrong, at most 1."""
    cell, bad = load_cell(configs.CELLS_DIR / "two_wx200.toml", QUICK), 0
    say(f"{'event':10} {'phase':26} {'down mm':>8} {'up mm':>7} {'step/limit':>11}  modes of the first arm")
    for event in events:
        for name, phase in PHASES.items():
            steps = [*phase.steps, Step(phase.mode, EVENTS[event], None, phase.after_s)]
            rig = PhaseRun(cell, phase.begins, steps, back=True, real=event.startswith("unplug"), limit_s=LIMIT_S)
            begun = rig.step_ns[-1]
            after = [z for ns, z in rig.heights if begun <= ns < begun + LOOK_S * 1e9]
            down, up = after[0] - min(after), max(after) - after[0]
            wrong = _met(rig, LOST.get(event, set()), falls=event == "unplug-second")
            bad += bool(wrong)
            way = " ".join(mode.name for mode in rig.way("left")[:-1])
            figures = f"{down * 1e3:8.2f} {up * 1e3:7.2f} {_step_share(rig):11.2f}"
            say(f"{event:10} {name:26} {figures}  {way} {wrong}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1].split(",") if len(sys.argv) > 1 else list(EVENTS)))
