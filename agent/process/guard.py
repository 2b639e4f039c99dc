"""The guard process of one arm: it owns the port, watches the agent, and goes on in HOLD when that is gone.

Two never write: an agent that hangs is killed, and waited for, before the first byte.  The guard opens no network
socket and loads nothing that could; the post-mortem is written by a process of its own.
"""

from __future__ import annotations

import contextlib
import os
import select
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from agent.around import RunSummary, Surroundings
from agent.config import monitors
from agent.config.cell import Arm, Cell
from agent.config.schema.cell import DriverKind
from agent.guard.black_box import BlackBox
from agent.guard.line import GuardEnd, GuardError, Said, Word, close_all
from agent.guard.resume import beginning
from agent.guard.takeover import WATCH_NS, go_on, stale_ns
from agent.guard.vigil import Vigil
from agent.guard.watched import DESCRIPTORS, Watched
from agent.host.notify import Notifier, stored_fds
from agent.host.realtime import become_realtime, quiet_memory
from agent.host.signals import StopFlag
from agent.loop import Agent
from agent.modes import Mode
from agent.monitors.watch import Watch
from agent.operator.socket import ControlSocket, Standing
from agent.process.agent import LOST_REMEDY, ArmLost
from agent.process.build import Standby, build_agent, build_standby, port_of
from agent.process.operated import Operator, tick_of
from agent.process.schedule import AgentOptions, schedule_of
from agent.process.session import led_back
from agent.process.tellers import HEARTBEAT_S, Heart, ServoTeller, Teller
from agent.runner import Runner
from agent.telemetry.row.event import Level
from agent.telemetry.row.fill import AgentRow
from agent.verify.check import examine
from drivers.clock import MonotonicClock
from drivers.dynamixel.line.port import SerialPort
from drivers.interface import Refusal, Vector

PORT = "port"  # name under which the service manager keeps it
IDLE_NS = 100_000_000
REHEARSE_AT = 20  # rows, after which a hold is computed once for nothing, so that its code and memory are warm
POST_MORTEM_AFTER_S = 0.3  # of the hold, so that its first cycles are in it
PAUSE_S = 1e-3  # between two steps that compute: LimitRTTIME counts the time without one
BUSY_MAX_NS = 1_000_000_000
HOLDS, WAITING, HANDED_OVER = "holds in the agent's place", "waits for the agent", "the agent was asked to end"


@dataclass(frozen=True)
class GuardOptions:
    """How one guard is started."""

    agent: AgentOptions  # what the hold after the agent is run with
    cell: Path
    socket: Path
    post_mortem: Path  # folder


def run_guard(cell: Cell, options: GuardOptions, stop: StopFlag, ready: Callable[[str], None]) -> RunSummary | None:
    """Guard an arm until a stop, or until a hold of its own has been released; None when there was no hold.

    ready is told the socket once the port is open.  Raises Refusal; torque is then as the agent has it.
    """
    with ExitStack() as stack:
        guard = _Guard(cell, options, stop, stack)
        ready(f"socket={options.socket}")
        return guard.run()


class _Guard:
    """One arm's guard."""

    def __init__(self, cell: Cell, options: GuardOptions, stop: StopFlag, stack: ExitStack) -> None:
        report = examine(cell)
        report.require()
        self._cell, self._options, self._stop = cell, options, stop
        self._arm: Arm = cell.arm(options.agent.arm)
        self._q_start: Vector = report.q_start[cell.arms.index(self._arm)]
        self._agent: Agent = build_agent(cell, self._arm)
        emulated, simulated = options.agent.connection.emulated, options.agent.driver is DriverKind.SIM
        self._stale_ns = stale_ns(cell.period_ns, emulated, simulated)
        self._notifier = stack.enter_context(closing(Notifier()))
        self._clock = MonotonicClock()
        self._port = self._open_port()
        stack.callback(self._close_port)
        self._line = stack.enter_context(GuardEnd(options.socket, cell.fingerprint))
        self._told, self._drivers = dict[str, Any](), tuple[int, ...]()  # by the agent: of its driver
        self._session = False  # whether the agent goes from rest to rest
        self._watched: Watched | None = None
        self._driver: Standby | None = None
        self._tell: Teller | None = None
        stack.callback(self._let_go)
        self._stroked_ns = 0
        quiet_memory()
        if options.agent.priority is not None:
            become_realtime(options.agent.priority)
        self._notifier.ready(WAITING)

    def _open_port(self) -> SerialPort | None:
        """None of a simulated arm; else kept by the service manager while this guard was gone, or opened and locked."""
        if self._options.agent.driver is DriverKind.SIM:
            return None
        path, kept = port_of(self._arm, self._options.agent.connection), stored_fds()
        port = SerialPort(path, self._arm.baud, self._clock, (lambda: kept[PORT]) if PORT in kept else None)
        port.open()
        self._notifier.keep(PORT, port.fileno())
        return port

    def _close_port(self) -> None:
        if self._port is not None:
            self._port.close()

    # --- while there is an agent ----------------------------------------------------------------------------------

    def run(self) -> RunSummary | None:
        """Until a stop, or the end of a hold."""
        while not self._stop.stopped:
            reason = self._look()
            if reason and self._watched is not None and self._driver is not None:
                return self._hold(self._watched, self._driver, reason)
            self._wait()
        return None

    def _wait(self) -> None:
        poller = select.poll()
        watched = self._watched
        for fd in (*self._line.filenos(), *([] if watched is None else [watched.pidfd])):
            poller.register(fd, select.POLLIN)
        with contextlib.suppress(InterruptedError):
            poller.poll((IDLE_NS if watched is None else WATCH_NS) * 1e-6)

    def _look(self) -> str:
        """One look at everything; why to take over, or nothing."""
        now_ns = time.monotonic_ns()
        if now_ns - self._stroked_ns >= HEARTBEAT_S * 1e9:
            self._stroked_ns = now_ns
            self._notifier.alive()
        said = self._line.hear()
        if said is not None:
            self._answer(said, now_ns)
        watched = self._watched
        if watched is None:
            return ""
        if watched.gone:
            return HANDED_OVER if watched.handed_over else "the agent has died"
        if watched.hangs(now_ns):
            watched.kill(self._notifier.alive)
            return f"the agent hung (no row for {watched.vigil.still_ns * 1e-6:.0f} ms) and was ended"
        if not watched.rehearsed and watched.reader.written >= REHEARSE_AT:
            watched.rehearsed = True
            beginning(self._agent, watched.last_rows(), "", session=self._session)
        return ""

    def _answer(self, said: Said, now_ns: int) -> None:
        """Do what the agent says.  What a stranger could send is refused, and its descriptors are closed."""
        try:
            if said.word is Word.WATCH:
                self._watch(said)
            elif said.word is Word.PORT:
                self._lend(again=bool(said.content.get("again")), now_ns=now_ns)
            elif said.word is Word.LEAVE:
                self._let_go()
                self._line.answer()
            elif self._watched is not None and said.word is Word.BUSY:
                self._watched.vigil.excuse(now_ns + min(BUSY_MAX_NS, round(float(said.content["for_s"]) * 1e9)))
            elif self._watched is not None and said.word is Word.TAKE:
                self._watched.handed_over = True
        except Refusal as error:
            self._line.refuse(error)
        except (KeyError, IndexError, TypeError, ValueError) as error:  # it came from another process
            found, remedy = f"{type(error).__name__} {error}", "start agent and guard from one release"
            self._line.refuse(GuardError(said.word, found=found, expected="what an agent says", remedy=remedy))

    def _lend(self, *, again: bool, now_ns: int) -> None:
        """The port; again: opened anew, for the agent has lost it."""
        if self._port is None:
            raise GuardError("port", found="a simulated arm", expected="one with a port", remedy="give both one driver")
        if again:
            self._port.close()
            self._port = self._open_port()
            if self._watched is not None:
                self._watched.vigil.excuse(now_ns + BUSY_MAX_NS)
                self._driver = self._prepared()
        if self._port is not None:
            self._line.answer((self._port.fileno(),))

    def _watch(self, said: Said) -> None:
        """Make ready to go on without this agent.  Raises Refusal."""
        self._let_go()
        vigil = Vigil(self._stale_ns, WATCH_NS)
        own, self._drivers = said.fds[:DESCRIPTORS], said.fds[DESCRIPTORS:]
        try:
            self._told, self._session = dict(said.content["driver"]), bool(said.content.get("session"))
            self._driver = self._prepared()
        except BaseException:
            close_all(own)
            raise
        time.sleep(PAUSE_S)
        self._watched = Watched.of(said, vigil)
        time.sleep(PAUSE_S)
        self._notifier.send("STATUS=watches the agent")
        self._line.answer()

    def _prepared(self) -> Standby:
        connection, port = self._options.agent.connection, self._port
        return build_standby(
            self._cell, self._arm, connection, port, self._q_start, self._warn, self._drivers, self._told
        )

    def _warn(self, text: str) -> None:
        if self._tell is not None:
            self._tell.warn(text)

    def _let_go(self) -> None:
        if self._driver is not None:
            self._driver.drop()
            self._driver = None
        close_all(self._drivers)
        self._drivers = ()
        if self._watched is not None:
            self._watched.close()
            self._watched = None
            self._notifier.send(f"STATUS={WAITING}")

    # --- without an agent -----------------------------------------------------------------------------------------

    def _hold(self, watched: Watched, driver: Standby, reason: str) -> RunSummary:
        """Go on in HOLD, or as a session stands there, until a release.  Raises AdoptError, ArmLost."""
        options, arm = self._options.agent, self._arm
        watched.inherit()
        rows = watched.last_rows()
        offset_ns = int(rows[-1]["utc_ns"] - rows[-1]["stamp_ns"]) if len(rows) else None
        clock = MonotonicClock(offset_ns)
        tell = self._tell = Teller(arm.name, watched.texts)
        tell.clock = clock
        with ExitStack() as stack:
            stack.callback(watched.texts.finish)
            stack.callback(watched.writer.finish)
            since = {"last_row_s": round(1e-9 * (clock.now_ns() - int(rows[-1]["stamp_ns"])), 6)} if len(rows) else {}
            level = Level.INFO if reason == HANDED_OVER else Level.ERROR
            tell.event(level, f"{reason}: the guard holds the arm", **since)
            standing = Standing(arm.name, Mode.HOLD, reason)
            control = ControlSocket(options.control, self._cell.fingerprint, standing) if options.control else None
            if control is not None:
                stack.callback(control.close)
            try:
                begun = go_on(self._agent, driver, clock, rows, self._cell.period_ns, reason, session=self._session)
            except Refusal as error:
                tell.event(Level.ERROR, str(error))
                raise
            stack.callback(driver.close)
            stack.callback(driver.disable)
            black_box = self._black_box(watched.ring, reason)
            stack.callback(black_box.finish)
            session = led_back(self._cell, arm, self._agent, driver, begun, standing) if self._session else None
            around = self._around(control, driver, watched, clock, tell, black_box, begun.mode)
            schedule = replace(schedule_of(self._cell, options), hold_at_end=True)
            row = AgentRow(watched.writer.row, arm.n, self._cell.config_id)
            watch = Watch(monitors.bounds(self._cell, arm), tell.warn)
            cpu_s = time.process_time()
            runner = Runner(self._agent, driver, clock, schedule, row, watched.writer, around, watch, begun, session)
            summary = runner.run()
            tell.end(summary, time.process_time() - cpu_s)
        self._notifier.stopping("torque off")
        if summary.mode is Mode.FAULT:
            raise ArmLost(
                f"arm {arm.name}", found=summary.reason, expected="a fresh state every cycle",
                remedy=LOST_REMEDY if self._session else "see the log",
            )  # fmt: skip
        return summary

    def _around(
        self, control: ControlSocket | None, driver: Standby, watched: Watched, clock: MonotonicClock,
        tell: Teller, black_box: BlackBox, begins: Mode,
    ) -> Surroundings:  # fmt: skip
        rate_hz = self._cell.file.rate_hz
        heart = Heart(self._notifier, rate_hz)
        servos = ServoTeller(driver, watched.texts, clock.utc_offset_ns, rate_hz)
        agent = self._options.agent
        operator = Operator(self._stop, control, clock, tell.event, drops_on_stop=not agent.hold, session=self._session)
        fixed = {"pid": os.getpid(), "driver": agent.driver.value, "guard": HOLDS, "session": self._session}
        if control is not None:
            control.standing.details = lambda: {**fixed, "tick": tick_of(watched.writer)}
        heart.mode(begins)

        def mode_changed(mode: Mode) -> None:
            heart.mode(mode)
            operator.mode(mode)

        def beat() -> None:
            heart.beat()
            servos.beat()
            black_box.beat()

        return Surroundings(time.perf_counter_ns, operator.events, lambda: None, beat, mode_changed, tell.trouble)

    def _black_box(self, ring: Path, reason: str) -> BlackBox:
        """The post-mortem of what happened before this hold; none of a hand-over that was asked for."""
        options, arm = self._options, self._arm.name
        file = options.post_mortem / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{arm}-post-mortem.mcap"
        arguments = (options.cell, arm, ring, file, reason)
        cycles = round(POST_MORTEM_AFTER_S * self._cell.file.rate_hz)
        return BlackBox(list(map(str, arguments)), cycles, wanted=reason != HANDED_OVER)
