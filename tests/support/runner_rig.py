"""The control loop of one arm on a clock that the test moves, with an arm that does and fails as the test says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

import configs
from agent.around import Beginning, RunSummary, Schedule, Surroundings
from agent.config.cell import Cell, load_cell
from agent.control.memory import Memory
from agent.cycles import Patience
from agent.loop import Agent
from agent.modes import Event, Mode
from agent.monitors.watch import Watch
from agent.process.build import build_agent
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from drivers.interface import (
    ArmInfo,
    BusCounters,
    DriverError,
    JointState,
    ServoFault,
    ServoHealth,
    StaleStateError,
    Vector,
)
from tests.support.starts import start_joints

START_AFTER = 10  # cycles of READY
HOLD_AFTER_STALE, FAULT_AFTER_STALE = 3, 8
PATIENCE = Patience(hold=HOLD_AFTER_STALE, blind=FAULT_AFTER_STALE)
WALL_NS = (
    3_000_000,
    1_000,
    20_000,
    400_000,
)  # until the cycle begins, its state is there, its step is done, it is sent


@cache
def paper() -> Cell:
    """The cell of the paper."""
    return load_cell(configs.CELLS_DIR / "paper.toml")


@cache
def period_ns() -> int:
    """Of its cycle."""
    return paper().period_ns


def q_start() -> Vector:
    """Where its first arm starts."""
    return _start().copy()


def wandering(read: int) -> Vector:
    """A little beside it, and elsewhere with every read."""
    return q_start() + 1e-3 * np.sin(0.7 * read + np.arange(3))


@cache
def _start() -> Vector:
    return start_joints(paper())[0]


class MovedClock:
    """Time passes in `sleep_until`, and where the test says so.

    oversleeps_ns: by number of the sleep, how long after its deadline it returns.
    """

    utc_offset_ns = 6_000_000_000

    def __init__(self, oversleeps_ns: Mapping[int, int]) -> None:
        self.ns = 1_000_000_000
        self.sleeps = 0
        self._oversleeps_ns = oversleeps_ns

    def now_ns(self) -> int:
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None:
        self.sleeps += 1
        self.ns = max(self.ns, deadline_ns + self._oversleeps_ns.get(self.sleeps, 0))


@dataclass
class Arm:
    """An arm that fails on the reads and writes the test names, counted from 1."""

    clock: MovedClock
    q: Callable[[int], Vector]  # joints at a read
    failures: Mapping[int, Exception]
    pauses_ns: Mapping[int, int]  # that a read takes
    refused: frozenset[int]  # writes
    counters: BusCounters = field(default_factory=lambda: BusCounters(timeouts=2, corrupt=3, alerts=4, retries=5))
    reads: int = 0
    written: list[Vector] = field(default_factory=list)

    def connect(self) -> ArmInfo:
        raise NotImplementedError

    def enable(self) -> None: ...

    def read(self) -> JointState:
        self.reads += 1
        self.clock.ns += self.pauses_ns.get(self.reads, 0)
        if self.reads in self.failures:
            raise self.failures[self.reads]
        return JointState(self.clock.ns, self.q(self.reads), np.zeros(3), np.full(3, np.nan))

    def write(self, tau_Nm: Vector) -> Vector:
        assert np.isfinite(tau_Nm).all()
        self.written.append(tau_Nm.copy())
        if len(self.written) in self.refused:
            raise DriverError("write", found="0 bytes taken", expected="all", remedy="look at the cable")
        return tau_Nm + 0.001  # what the counts stand for

    def health(self) -> ServoHealth:
        return ServoHealth.none(self.clock.ns)

    def disable(self) -> None: ...

    def close(self) -> None: ...


@dataclass
class Returning(Arm):
    """An arm that can come back, after the answers of its attempts; the last one stands for all that follow."""

    lapses: frozenset[int] = frozenset()  # reads after which it does nothing until it is brought back
    answers: tuple[bool | DriverError, ...] = (True,)
    tried: list[int] = field(default_factory=list)  # after how many reads

    @property
    def lapsed(self) -> bool:
        return self.reads in self.lapses

    def recover(self) -> bool:
        self.tried.append(self.reads)
        answer = self.answers[min(len(self.tried), len(self.answers)) - 1]
        if isinstance(answer, DriverError):
            raise answer
        return answer


@dataclass
class Log:
    """Rows as they were committed."""

    message: Any = field(default_factory=lambda: np.zeros((), AGENT_STATE.dtype))
    rows: list[Any] = field(default_factory=list)
    waits: int = 0

    def commit(self) -> None:
        self.rows.append(self.message.copy())

    def wait_for_space(self) -> None:
        self.waits += 1


class Wall:
    """A wall clock that moves on by WALL_NS from call to call."""

    def __init__(self) -> None:
        self.ns = 0
        self._calls = 0

    def __call__(self) -> int:
        self.ns += WALL_NS[self._calls % len(WALL_NS)]
        self._calls += 1
        return self.ns


@dataclass
class Done:
    """What a run of the loop left."""

    summary: RunSummary
    arm: Arm
    rows: Any
    modes: list[Mode]
    beats: int
    waits: int
    troubles: list[str]  # why it held, as the process was told
    refused: list[str]  # why a session went no further
    memory: Memory

    def of(self, mode: Mode) -> Any:
        """Rows in a mode."""
        return self.rows[self.rows["mode"] == mode]


def lost() -> StaleStateError:
    """A cycle without a state."""
    return StaleStateError("state", found="no reply", expected="a reply", remedy="check the cable")


def lost_at(*reads: int) -> dict[int, Exception]:
    """These reads bring no state."""
    return {read: lost() for read in reads}


def fault(with_state: bool) -> ServoFault:
    """A servo that does not do its part, with a fresh state or without."""
    error = ServoFault("servo 2", found="torque off", expected="on", remedy="look")
    if with_state:
        error.state = JointState(0, q_start(), np.zeros(3), np.full(3, np.nan))
    return error


def run(
    operator: Callable[[int], Event] = lambda _: Event.NONE,
    failures: Mapping[int, Exception] | None = None,
    pauses_ns: Mapping[int, int] | None = None,
    *,
    oversleeps_ns: Mapping[int, int] | None = None,
    refused: frozenset[int] = frozenset(),
    q: Callable[[int], Vector] = lambda _: q_start(),
    cell: Cell | None = None,
    agent: Mapping[str, Any] | None = None,
    watch: Watch | None = None,
    session: Any = None,
    beginning: Beginning | None = None,
    happened: Event | None = None,
    returning: Mapping[str, Any] | None = None,
    told: bool = True,
    of_host: str = "",
    start_ns: Callable[[int, int], int | None] = lambda reads, zero_ns: zero_ns if reads > 2 else None,
    **schedule: Any,
) -> Done:
    """Run the loop to its end.

    operator: requests by the number of reads; agent: changed fields of the agent; start_ns: the common start as the
    loop is told, from the number of reads and an instant START_AFTER cycles and a third from the beginning; returning:
    fields of an arm that can come back; told: whether anybody hears of troubles and refusals; of_host: what is wrong
    with it; schedule: changed fields of the schedule.
    """
    clock, of = MovedClock(oversleeps_ns or {}), cell or paper()
    given = (clock, q, failures or {}, pauses_ns or {}, refused)
    arm = Arm(*given) if returning is None else Returning(*given, **returning)
    log = Log()
    modes: list[Mode] = []
    beats: list[int] = []
    troubles: list[str] = []
    refusals: list[str] = []
    zero_ns = clock.ns + START_AFTER * period_ns() + period_ns() // 3
    plan = Schedule(period_ns(), 20, False, hold_at_end=False, patience=PATIENCE)
    around = Surroundings(
        wall_ns=Wall(),
        operator=lambda: operator(arm.reads),
        start_ns=lambda: start_ns(arm.reads, zero_ns),
        heartbeat=lambda: beats.append(arm.reads),
        mode_changed=modes.append,
        trouble=troubles.append if told else None,
        refused=refusals.append if told else None,
        of_host=lambda: of_host,
    )
    row = AgentRow(log.message, 3, of.config_id)
    made: Agent = replace(build_agent(of, of.arms[0]), **(agent or {}))
    runner = Runner(made, arm, clock, replace(plan, **schedule), row, log, around, watch, beginning, session)
    summary = runner.run() if happened is None else runner.run(happened)
    rows = np.array(log.rows, AGENT_STATE.dtype)
    return Done(summary, arm, rows, modes, len(beats), log.waits, troubles, refusals, runner.memory)
