"""What is done to the processes that listen to a run, telemetry and recorder, and when; and what of it cannot be."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from agent.config.cell import Cell
from agent.faults.plan import OF_LISTENERS, FaultPlanError, Injection, Kind, Target, placed
from agent.telemetry.ring.writer import DEFAULT_SLOTS
from agent.telemetry.row.topics import PLANT, RECORDER

PERIOD_S: Final = 0.5  # of what stands and goes on in turn
STRANGE: Final = (Kind.GARBAGE, Kind.WRONG)  # what a stranger sends, at one instant
MARGIN_S: Final = 1.0  # rows that a listener has taken and not yet confirmed


class Deed(enum.Enum):
    """What is done."""

    KILL = enum.auto()  # SIGKILL
    BEGIN = enum.auto()  # a process in the place of one that was killed
    STOP = enum.auto()  # SIGSTOP
    GO_ON = enum.auto()  # SIGCONT
    BABBLE = enum.auto()  # a stranger's random messages
    FORGE = enum.auto()  # a stranger's rows


@dataclass(frozen=True)
class Strike:
    """One deed, at an instant of the trajectory."""

    at_s: float
    deed: Deed
    whom: str  # arm, PLANT or RECORDER


def is_of_listeners(faults: Sequence[Injection]) -> bool:
    """Whether any of them is of telemetry or of the recorder."""
    return any(fault.target in OF_LISTENERS for fault in faults)


def placed_at(cell: Cell, faults: Sequence[Injection]) -> tuple[Injection, ...]:
    """The faults with the arms of telemetry named, which may happen to a lockstep run of this cell.

    Raises FaultPlanError.
    """
    for fault in faults:
        _require_sense(fault)
    _require_run(cell, faults)
    for fault in faults:
        _require_room(cell, fault)
    named = placed(faults, [*(arm.name for arm in cell.arms), PLANT])
    return tuple(
        fault.model_copy(update={"arm": None}) if fault.target is Target.RECORDER else fault for fault in named
    )


def strikes(cell: Cell, faults: Sequence[Injection]) -> tuple[tuple[Strike, ...], ...]:
    """All deeds within the run, those of one instant together, in order of time; faults: `placed_at`."""
    last_s = _last_s(cell)
    every = (one for fault in faults for one in _of(fault, last_s) if one.at_s <= last_s)
    found = sorted(every, key=lambda one: one.at_s)
    return tuple(tuple(group) for _, group in groupby(found, key=lambda one: one.at_s))


def _last_s(cell: Cell) -> float:
    """The last instant at which the plant looks at the trajectory, and can wait."""
    return cell.file.duration_s - cell.file.observe_every / cell.file.rate_hz


def _of(fault: Injection, last_s: float) -> Iterator[Strike]:
    whom = RECORDER if fault.target is Target.RECORDER else str(fault.arm)
    begin_s, end_s = fault.at_s, fault.at_s + fault.for_s
    if fault.kind is Kind.OFF:
        yield from (Strike(begin_s, Deed.KILL, whom), Strike(end_s, Deed.BEGIN, whom))
    elif fault.kind is Kind.STUCK:
        yield from (Strike(begin_s, Deed.STOP, whom), Strike(end_s, Deed.GO_ON, whom))
    elif fault.kind is Kind.INTERMITTENT:
        end_s = min(end_s, last_s)  # when the run ends, it goes on
        for k in range(max(1, math.ceil((end_s - begin_s) / PERIOD_S))):
            at_s = begin_s + k * PERIOD_S
            yield Strike(at_s, Deed.STOP, whom)
            yield Strike(min(at_s + fault.amount * PERIOD_S, end_s), Deed.GO_ON, whom)
    else:
        yield Strike(begin_s, Deed.BABBLE if fault.kind is Kind.GARBAGE else Deed.FORGE, whom)


def _require_sense(fault: Injection) -> None:
    """Refuse what a fault of a process cannot have."""
    what = f"fault {fault.fault}"
    if fault.target not in OF_LISTENERS:
        raise FaultPlanError(
            what, found="it beside faults of telemetry or recorder", expected="these alone: arms are not struck here",
            remedy="let it happen by itself",
        )  # fmt: skip
    if fault.servo is not None:
        raise FaultPlanError(
            f"{what}: servo", found=fault.servo, expected="none: a process fails", remedy="leave --servo out"
        )
    if fault.target is Target.RECORDER and fault.arm is not None:
        raise FaultPlanError(
            f"{what}: arm", found=fault.arm, expected="none: all arms have one recorder", remedy="leave --arm out"
        )
    if fault.kind is Kind.WRONG and fault.arm == PLANT:
        raise FaultPlanError(
            f"{what}: arm", found=PLANT, expected="an arm, whose rows are altered", remedy="name an arm with --arm"
        )
    if fault.kind in STRANGE and math.isfinite(fault.for_s):
        raise FaultPlanError(
            f"{what}: how long", found=f"{fault.for_s:g} s", expected="nothing: a stranger sends one burst, at once",
            remedy="leave --for out",
        )  # fmt: skip
    if fault.kind is Kind.INTERMITTENT and fault.amount >= 1.0:
        raise FaultPlanError(
            f"{what}: size", found=f"{fault.amount:g} of the time", expected="a share below 1",
            remedy=f"for the whole of it: {fault.target}-{Kind.STUCK}",
        )  # fmt: skip


def _require_run(cell: Cell, faults: Sequence[Injection]) -> None:
    """Refuse a cell that does not run in lockstep, or for longer than its rings remember."""
    name = faults[0].fault
    for table, there in (("hil", cell.file.hil), ("floating", cell.file.floating)):
        if there is not None:
            raise FaultPlanError(
                f"fault {name}: cell {cell.file.name}", found=f"[{table}]", expected="a run in lockstep, which waits",
                remedy="remove the table",
            )  # fmt: skip
    last_s = _last_s(cell)
    for fault in faults:
        end_s = fault.at_s + (fault.for_s if math.isfinite(fault.for_s) else 0.0)
        if end_s > last_s:
            raise FaultPlanError(
                f"fault {fault.fault} from {fault.at_s:g} to {end_s:g} s",
                found=f"a run of {cell.file.duration_s:g} s", expected=f"instants up to {last_s:g} s",
                remedy="give a longer --duration, an earlier --at or a shorter --for; without --for it is for good",
            )  # fmt: skip
    rows_s = DEFAULT_SLOTS / cell.file.rate_hz
    lasts_s = cell.file.simulation.ready_s + cell.file.duration_s
    if lasts_s > rows_s:
        raise FaultPlanError(
            f"fault {name}: duration", found=f"{lasts_s:g} s from READY to the end",
            expected=f"at most {rows_s:g} s: a ring then still has every torque", remedy="give a shorter --duration",
        )  # fmt: skip


def _require_room(cell: Cell, fault: Injection) -> None:
    """Refuse a silence for which a run in lockstep would wait: in real time nobody does."""
    if fault.kind not in (Kind.OFF, Kind.STUCK):
        return
    silent_s = min(fault.for_s, cell.file.duration_s - fault.at_s)
    bearable_s = DEFAULT_SLOTS // 2 / cell.file.rate_hz - MARGIN_S
    if silent_s > bearable_s:
        raise FaultPlanError(
            f"fault {fault.fault}: how long", found=f"{silent_s:g} s",
            expected=f"at most {bearable_s:g} s: simulated time waits once half a ring is unread",
            remedy="give a shorter --duration, or a --for",
        )  # fmt: skip
