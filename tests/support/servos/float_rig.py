"""Arms that a hand guides, with the real driver, loop and ending on emulated servos, in virtual time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from agent.around import RunSummary
from agent.config.cell import Arm, Cell
from agent.config.floating import taking_part
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line, SharedClock
from agent.guard.takeover import go_on
from agent.loop import Agent
from agent.modes import Mode
from agent.process.build import build_agent
from agent.process.emulate import about_the_object, wiring
from agent.process.float_loop import FloatLoop, Floats
from agent.process.floats import require_within
from agent.process.simulated import lone_spec
from agent.process.tellers import Teller
from agent.replay.chain import Chain
from agent.telemetry.row.event import Event as TextEvent
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.standby import Handover, StandbyDriver
from drivers.interface import JointState, Vector
from sim_backend.wire.faults import Fault
from sim_backend.wire.injector import Injector
from sim_backend.wire.lone_world import emulate_alone
from sim_backend.wire.timing import BusTiming
from tests.support.servos.dxl_rig import VirtualPort
from tests.support.servos.guarded_rig import HOST_NS, Died, MortalClock
from tests.support.starts import start_joints


class Rows:
    """A ring that keeps everything."""

    def __init__(self) -> None:
        self.row: Any = np.zeros((), AGENT_STATE.dtype)
        self.kept: list[Any] = []

    @property
    def written(self) -> int:
        return len(self.kept)

    def commit(self) -> None:
        self.kept.append(self.row.copy())

    def wait_for_space(self) -> None: ...


@dataclass
class Texts:
    """Events and health texts as they were told."""

    events: list[TextEvent] = field(default_factory=list)
    healths: list[Any] = field(default_factory=list)

    def event(self, event: TextEvent) -> None:
        self.events.append(event)

    def health(self, utc_ns: int, values: Any) -> None:
        self.healths.append((utc_ns, values))

    @property
    def said(self) -> list[str]:
        return [event.text for event in self.events]


class Silent:
    """Nobody manages this service."""

    def send(self, state: str) -> None: ...

    def alive(self) -> None: ...

    def busy(self) -> None: ...


@dataclass
class FloatArm:
    """What one floating arm left."""

    ring: Rows = field(default_factory=Rows)
    texts: Texts = field(default_factory=Texts)
    summary: RunSummary | None = None
    error: BaseException | None = None
    driver: DynamixelDriver | None = None
    port: VirtualPort | None = None
    loop: FloatLoop | None = None
    handover: Handover | None = None

    @property
    def rows(self) -> Any:
        """Its rows."""
        return np.array(self.ring.kept, AGENT_STATE.dtype)


Hand = Callable[["FloatRun", float], Vector]  # wrench (6,) N, N·m, world axes, at an instant after torque came on


OFF = (
    "simulation.reality.arms.left.base_m=[0.006,0.0,-0.005]",
    "simulation.reality.arms.left.zeros_rad=[0.012,-0.01,0.014]",
    "simulation.reality.arms.right.zeros_rad=[-0.01,0.013,-0.012]",
    "simulation.reality.pads_N_per_m=1e4", "simulation.reality.pads_Nm_per_rad=400.0",
)  # fmt: skip


class FloatRun:
    """All arms that [floating] of a cell names; truth: what the emulated arms are, if it is not the cell.

    hand: what pushes, at the end effector of the one arm, or at the object of arms that hold it; stop_s: when a stop is
    asked for; faults count from the first torque; q_start: where the one arm is; at: what the test does at an instant;
    until_s: when the arms are taken away, wherever they are; dies_s: when their processes are killed, a second before
    the end, or, guarded, before their guards let them down; starts_s: when arms that move while others float begin.
    """

    def __init__(
        self,
        cell: Cell,
        *,
        truth: Cell | None = None,
        hand: Hand | None = None,
        stop_s: float = math.inf,
        faults: Sequence[Fault] = (),
        q_start: Vector | None = None,
        at: Sequence[tuple[float, Callable[[FloatRun], None]]] = (),
        until_s: float | None = None,
        dies_s: float | None = None,
        guarded: bool = False,
        starts_s: float = math.inf,
    ) -> None:
        spec = cell.file.floating
        assert spec is not None
        self.cell, self._hand, self._stop_s, self._at, self._until_s = cell, hand, stop_s, list(at), until_s
        self._dies_s, self._guarded = dies_s, guarded
        starts = list(start_joints(cell))
        names = [arm.name for arm in cell.arms]
        if q_start is not None:
            starts[names.index(spec.arms[0])] = q_start
        real = truth or cell
        if spec.holding:
            self.emulated, self.world = about_the_object(real, starts, BusTiming())
        else:
            one = names.index(spec.arms[0])
            wired = [wiring(cell.arms[one], 0, cell.arms[one].baud)]
            self.emulated, self.world = emulate_alone(lone_spec(real, starts), [(one, wired[0])], timing=BusTiming())  # type: ignore[assignment]
        self.injectors = [Injector(arm, None, seed=1) for arm in self.emulated.arms]
        self.arms = {arm.name: FloatArm() for arm in taking_part(cell)}
        self.clock = SharedClock(self.emulated, self.injectors, self._pass)
        self._starts_s = starts_s
        self._faults = list(faults)
        self._on: set[str] = set()
        self.zero_ns: int | None = None
        self.seen: list[tuple[float, Vector, Vector]] = []  # s, q and dq of the one arm
        self.clock.live([partial(self._run, self.cell.arm(name), i) for i, name in enumerate(self.arms)])

    @property
    def one(self) -> FloatArm:
        """The arm of a run that has one."""
        return next(iter(self.arms.values()))

    @property
    def lone(self) -> Any:
        """The physics of the one arm."""
        return self.world.arms[0]  # type: ignore[attr-defined]

    def since_s(self, now_ns: int | None = None) -> float:
        """Seconds since all of them have torque."""
        now_ns = self.clock._ns if now_ns is None else now_ns
        return -1.0 if self.zero_ns is None else (now_ns - self.zero_ns) * 1e-9

    def tip(self) -> pin.SE3:
        """Where the one arm's end effector is, world."""
        return self.lone.end_effector()

    def _pass(self, ns: int) -> None:
        if self.zero_ns is None:
            return
        t = self.since_s(ns)
        while self._at and self._at[0][0] <= t:
            self._at.pop(0)[1](self)
        lone = not self.cell.file.floating.holding  # type: ignore[union-attr]
        if lone:
            self.seen.append((t, self.lone.q.copy(), self.lone.dq.copy()))
        if self._hand is not None:
            wrench = self._hand(self, t)
            if lone:
                self.lone.touch(wrench)
            else:
                self.world.plant.push(wrench)

    def _run(self, arm: Arm, index: int) -> None:
        run = self.arms[arm.name]
        try:
            run.summary = self._loop(run, arm, index)
        except Died:
            if self._guarded:
                run.summary = self._let_down(run, arm)
                return
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000_000)
            run.driver = None  # it sends nothing any more
        except BaseException as error:  # noqa: BLE001 - the test looks at it
            run.error = error
        finally:
            if run.driver is not None:
                run.driver.disable()
                run.driver.close()

    def _loop(self, run: FloatArm, arm: Arm, index: int) -> RunSummary:
        floats = Floats.of(self.cell, arm.name)
        clock = MortalClock(self.clock)
        line = Line(self.emulated, index, self.injectors[index], clock)
        run.port = VirtualPort(line, arm.baud)
        texts: Any = run.texts
        tell = Teller(arm.name, texts)
        run.driver = DynamixelDriver(floats.servos("virtual"), clock, scan_s=0.02, port=run.port)
        run.driver.connect()
        tell.clock = clock
        if not floats.moves:
            require_within(floats, run.driver)
        run.handover = Handover.of(run.driver)
        run.loop = self._float_loop(run, floats, clock, tell)
        run.driver.enable()
        self._on.add(arm.name)
        if len(self._on) == len(self.arms):
            self.zero_ns = self.clock._ns
            for injector in self.injectors:
                injector.add([f for f in self._faults if f.arm == injector.arm.name], self.zero_ns)
        if self._dies_s is not None:
            clock.end_ns = self.clock._ns + round(1e9 * self._dies_s)
        if self._until_s is not None:
            ticks = round((self._until_s - (self._starts_s if floats.moves else 0.0)) * self.cell.file.rate_hz)
            run.loop.schedule = replace(run.loop.schedule, hold_at_end=False, ticks=ticks)
        return run.loop.run()

    def _float_loop(
        self, run: FloatArm, floats: Floats, clock: Any, tell: Teller, agent: Agent | None = None
    ) -> FloatLoop:
        ring: Any = run.ring
        texts: Any = run.texts
        notifier: Any = Silent()
        assert run.driver is not None
        return FloatLoop(
            floats, run.driver, clock, ring, lambda: self.since_s() >= self._stop_s, tell, texts, notifier,
            shared=False, agent=agent, told=self if floats.moves else None,
        )  # fmt: skip

    def start_ns(self) -> int | None:
        """As an arm that moves is told it, when half of the time until then is over."""
        if self.zero_ns is None or self.since_s() < 0.5 * self._starts_s:
            return None
        return self.zero_ns + round(1e9 * self._starts_s)

    def entered(self, mode: Mode) -> None:
        """An arm that moves has entered it."""

    def _let_down(self, run: FloatArm, arm: Arm) -> RunSummary:
        """What a guard does, from the instant at which the arm's process has done nothing more."""
        floats, clock = Floats.of(self.cell, arm.name), self.clock
        assert run.port is not None
        assert run.handover is not None
        run.port._line.clock = clock
        servos = arm_map(self.cell, arm, "virtual", np.array(arm.entry.q_near_rad))
        driver = run.driver = StandbyDriver(servos, clock, port=run.port)
        driver.prepare(run.handover)
        clock.sleep_until(clock.now_ns() + HOST_NS)
        texts: Any = run.texts
        tell = Teller(arm.name, texts)
        tell.clock = clock
        agent = build_agent(self.cell, arm)
        run.loop = self._float_loop(run, floats, clock, tell, agent)
        begun = go_on(agent, driver, clock, run.rows[-64:], run.loop.schedule, "the agent has died")
        return run.loop.run(begun)


def modes_of(rows: Any) -> list[str]:
    return [Mode(m).name for m, _ in itertools.groupby(rows["mode"].tolist())]


def replayed(arm: FloatArm) -> None:
    """The rows of the arm follow from each other, as a replay of the log computes them."""
    agent = arm.loop._agent  # type: ignore[union-attr]
    chain, n = Chain(agent), agent.model.n
    chain.start()
    for row in arm.rows:
        state = JointState(int(row["stamp_ns"]), *(row[f][:n] for f in ("q_measured", "dq_measured", "tau_measured")))
        _, outcome = chain.pass_row(state, float(row["t"]), Mode(int(row["mode"])), int(row["flags"]))
        assert np.array_equal(outcome.tau, row["tau_limited"][:n])
