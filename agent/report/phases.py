"""The phases of a session from rest to rest, from the rows of its log: when each began, when it ended, and how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from agent.log.columns import Table
from agent.modes import FLOATING, Mode, mode_of
from agent.report.arithmetic import NAN
from agent.report.quantity import Unit
from agent.report.series import attitude_error, rotation_angle

if TYPE_CHECKING:
    from agent.log.read import AnyLog

_OF_SESSION: Final = frozenset(mode for mode in Mode if mode > Mode.FAULT) - FLOATING
_OUTCOME: Final[Mapping[tuple[Mode, Mode], str]] = {
    (Mode.REST, Mode.APPROACH): "left",
    (Mode.APPROACH, Mode.GRASP): "at the grasp",
    (Mode.APPROACH, Mode.PARK): "turned back",
    (Mode.GRASP, Mode.READY): "gripped",
    (Mode.GRASP, Mode.APPROACH): "not gripped",
    (Mode.READY, Mode.TRACK): "load taken up",
    (Mode.READY, Mode.RELEASE): "not started",
    (Mode.TRACK, Mode.HOLD): "held",
    (Mode.HOLD, Mode.LOWER): "goes on",
    (Mode.HOLD, Mode.RELEASE): "goes on",
    (Mode.LOWER, Mode.RELEASE): "lowered",
    (Mode.LOWER, Mode.HOLD): "held",
    (Mode.RELEASE, Mode.PARK): "let go",
    (Mode.PARK, Mode.REST): "back at rest",
}


@dataclass(frozen=True, slots=True)
class Phase:
    """One phase of one arm; times from the first row of all arms."""

    arm: str
    name: str
    begin: Annotated[float, Unit("s")]
    end: Annotated[float, Unit("s")]
    outcome: str


def session_of(log: AnyLog) -> tuple[tuple[Phase, ...], tuple[float, float]]:
    """Phases and `set_down_error` of a log."""
    found = phases({name: Table.of(rows) for name, rows in log.agents.items()})
    return found, set_down_error(None if log.plant is None else Table.of(log.plant), found)


def phases(agents: Mapping[str, Table]) -> tuple[Phase, ...]:
    """Of all arms, in the order of their beginning; none of a log that has no session."""
    used = {name: rows for name, rows in agents.items() if len(rows)}
    if not any(np.isin(rows["mode"], [int(m) for m in _OF_SESSION]).any() for rows in used.values()):
        return ()
    zero_ns = min(int(rows["utc_ns"][0]) for rows in used.values())
    found = [phase for name, rows in used.items() for phase in _of_arm(name, rows, zero_ns)]
    return tuple(sorted(found, key=lambda phase: (phase.begin, phase.arm)))


def set_down_error(plant: Table | None, found: Sequence[Phase]) -> tuple[float, float]:
    """m and rad between where the object is at the end of the log and where it stood at its beginning.

    NaN without the truth, and where no arm has come back to its rest.
    """
    if plant is None or not len(plant) or not any(phase.outcome == "back at rest" for phase in found):
        return NAN, NAN
    p, quat = plant["p_object"], plant["quat_object"]
    angle = rotation_angle(attitude_error(quat[:1], quat[-1:]))
    return float(np.linalg.norm(p[-1] - p[0])), float(angle[0])


def _of_arm(name: str, rows: Table, zero_ns: int) -> list[Phase]:
    numbers, utc_ns = rows["mode"], rows["utc_ns"]
    begins = np.flatnonzero(np.diff(numbers, prepend=numbers[:1] + 1))
    modes = [mode_of(int(numbers[k])) for k in begins]
    ends = [*begins[1:].tolist(), len(numbers) - 1]
    after: list[Mode | None] = [*modes[1:], None]
    return [
        Phase(
            name,
            mode.name if mode else f"mode {numbers[k]}",
            round((int(utc_ns[k]) - zero_ns) * 1e-9, 3),
            round((int(utc_ns[end]) - zero_ns) * 1e-9, 3),
            _outcome(mode, following),
        )
        for k, end, mode, following in zip(begins.tolist(), ends, modes, after, strict=True)
    ]


def _outcome(mode: Mode | None, following: Mode | None) -> str:
    if mode is None:
        return "unknown"
    if following is None:
        return "torque off" if mode in (Mode.REST, Mode.HALT) else "ended"
    if following is Mode.HALT:
        return "stopped"
    return _OUTCOME.get((mode, following), following.name)
