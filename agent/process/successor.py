"""What a guard does once its agent is gone: it holds the arm in the agent's place, until a release."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

from agent.around import RunSummary, Surroundings
from agent.config import monitors
from agent.config.cell import Arm, Cell
from agent.guard.black_box import BlackBox
from agent.guard.takeover import clock_of, go_on
from agent.guard.watched import Watched
from agent.host.notify import Notifier
from agent.host.signals import StopFlag
from agent.loop import Agent
from agent.modes import Mode
from agent.monitors.watch import Watch
from agent.operator.socket import ControlSocket, Standing
from agent.process.agent import ArmLost
from agent.process.build import Standby
from agent.process.commands import GuardOptions
from agent.process.hearing import Hearing
from agent.process.operated import Operator, tick_of
from agent.process.schedule import schedule_of
from agent.process.session import led_back
from agent.process.tellers import Heart, ServoTeller, Teller
from agent.runner import Runner
from agent.telemetry.row.event import Level
from agent.telemetry.row.fill import AgentRow
from drivers.clock import MonotonicClock
from drivers.interface import Refusal

POST_MORTEM_AFTER_S = 0.3  # of the hold, so that its first cycles are in it
HOLDS, HANDED_OVER = "holds in the agent's place", "the agent was asked to end"


class Successor:
    """Whoever holds one arm after its agent."""

    def __init__(
        self, cell: Cell, arm: Arm, agent: Agent, options: GuardOptions, stop: StopFlag, notifier: Notifier
    ) -> None:  # fmt: skip
        self._cell, self._arm, self._agent = cell, arm, agent
        self._options, self._stop, self._notifier = options, stop, notifier
        self._bounds = monitors.bounds(cell, arm)  # which takes longer than a cycle
        self._session = False  # whether the agent went from rest to rest
        self._tell: Teller | None = None

    def warn(self, text: str) -> None:
        """What the driver has to say, once there is somebody to tell."""
        if self._tell is not None:
            self._tell.warn(text)

    def hold(self, watched: Watched, driver: Standby, reason: str, *, session: bool) -> RunSummary:
        """Go on in HOLD, or as a session stands there, until a release.  Raises AdoptError, ArmLost."""
        options, arm = self._options, self._arm
        self._session = session
        self._stop.released = False  # said while there was nothing here to release
        rows = watched.last_rows()
        clock = clock_of(rows)
        tell = self._tell = Teller(arm.name, watched.texts)
        tell.clock = clock
        watched.inherit(tell.warn)
        with ExitStack() as stack:
            stack.callback(watched.texts.finish)
            stack.callback(watched.writer.finish)
            since = {"last_row_s": round(1e-9 * (clock.now_ns() - int(rows[-1]["stamp_ns"])), 6)} if len(rows) else {}
            level = Level.INFO if watched.handed_over else Level.ERROR
            tell.event(level, f"{reason}: the guard holds the arm", **since)
            standing = Standing(arm.name, Mode.HOLD, reason)
            schedule = schedule_of(self._cell, hold=True, shared=options.shared)
            try:
                begun = go_on(self._agent, driver, clock, rows, schedule, reason, session=session)
            except Refusal as error:
                tell.event(Level.ERROR, str(error))
                raise
            hearing = Hearing(
                options.control, self._cell.fingerprint, standing, watched.process, tell, stack, self._cell.file.rate_hz
            )
            control = hearing.begin()  # once the servos have a torque, which waits for nobody
            black_box = self._black_box(watched.ring, reason, wanted=not watched.handed_over)
            # it takes seconds: the arm is let go of first
            stack.callback(black_box.finish, self._notifier.alive, lambda why: tell.warn(f"no post-mortem: {why}"))
            stack.callback(driver.close)
            stack.callback(driver.disable)
            leads = session and begun.mode is not Mode.FAULT
            led = led_back(self._cell, arm, self._agent, driver, begun, standing) if leads else None
            around = self._around(control, standing, driver, watched, clock, tell, black_box, begun.mode, hearing)
            row = AgentRow(watched.writer.row, arm.n, self._cell.config_id)
            watch = Watch(self._bounds, tell.warn)
            cpu_s = time.process_time()
            runner = Runner(self._agent, driver, clock, schedule, row, watched.writer, around, watch, begun, led)
            summary = runner.run()
            tell.end(summary, time.process_time() - cpu_s)
        self._notifier.stopping("torque off")
        return ArmLost.check(arm.name, summary, session=session)

    def _around(
        self, control: ControlSocket | None, standing: Standing, driver: Standby, watched: Watched,
        clock: MonotonicClock, tell: Teller, black_box: BlackBox, begins: Mode, hearing: Hearing,
    ) -> Surroundings:  # fmt: skip
        rate_hz = self._cell.file.rate_hz
        heart = Heart(self._notifier, rate_hz)
        servos = ServoTeller(driver, watched.texts, clock.utc_offset_ns, rate_hz)
        options = self._options
        operator = Operator(
            self._stop, control, clock, tell.event, drops_on_stop=not options.hold, session=self._session,
            standing=standing,
        )  # fmt: skip
        fixed = {
            "pid": os.getpid(), "driver": options.driver.value, "guard": HOLDS, "session": self._session,
            "drops_on_stop": operator.drops_on_stop, "ring": str(watched.ring),
        }  # fmt: skip
        standing.details = lambda: {**fixed, "no_start": standing.no_start, "tick": tick_of(watched.writer)}
        heart.mode(begins)

        def mode_changed(mode: Mode) -> None:
            heart.mode(mode)
            operator.mode(mode)

        def beat() -> None:
            heart.beat()
            servos.beat()
            black_box.beat()
            if operator.is_deaf and (heard := hearing.look()) is not None:
                operator.listen(heard)

        return Surroundings(
            time.perf_counter_ns, operator.events, lambda: None, beat, mode_changed, tell.trouble, busy=heart.busy
        )

    def _black_box(self, ring: Path, reason: str, *, wanted: bool) -> BlackBox:
        """The post-mortem of what happened before this hold; none of a hand-over that was asked for."""
        options, arm = self._options, self._arm.name
        file = options.post_mortem / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{arm}-post-mortem.mcap"
        arguments = (options.cell, arm, ring, file, reason)
        cycles = round(POST_MORTEM_AFTER_S * self._cell.file.rate_hz)
        return BlackBox(list(map(str, arguments)), file, cycles, wanted=wanted)
