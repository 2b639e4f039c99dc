"""The guard process of one arm: it owns the port, watches the agent, and goes on in HOLD when that is gone.

Two never write: an agent that hangs is killed, and waited for, before the first byte.  The guard opens no network
socket and loads no network library; the post-mortem is written by a process of its own.
"""

from __future__ import annotations

import contextlib
import select
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from typing import Any

import numpy as np

from agent.around import RunSummary
from agent.config.cell import Arm, Cell
from agent.config.floating import spec_of
from agent.config.schema.driver import DriverKind
from agent.guard.guard_end import GuardEnd
from agent.guard.line import GuardError, Said, Word, close_all
from agent.guard.resume import beginning
from agent.guard.takeover import WATCH_NS, vigil_of
from agent.guard.watched import DESCRIPTORS, Watched
from agent.host.aside import Aside
from agent.host.notify import Notifier, stored_fds
from agent.host.ready_line import pairs
from agent.host.realtime import become_realtime, leave_realtime, quiet_memory
from agent.host.signals import StopFlag
from agent.loop import Agent
from agent.process.build import Standby, build_agent, build_standby, port_of
from agent.process.commands import GuardOptions
from agent.process.float_successor import FloatSuccessor
from agent.process.successor import HANDED_OVER, Successor
from agent.process.tellers import HEARTBEAT_S
from agent.verify.check import examine
from drivers.clock import MonotonicClock
from drivers.dynamixel.line.port import SerialPort
from drivers.interface import Refusal, Vector

PORT = "port"  # name under which the service manager keeps it
IDLE_NS = 100_000_000
REHEARSE_AT = 20  # rows, after which a hold is computed once for nothing, so that its code and memory are warm
PAUSE_S = 1e-3  # between two steps that compute: LimitRTTIME counts the time without one
BUSY_MAX_NS = 1_000_000_000
WAITING = "waits for the agent"


def run_guard(cell: Cell, options: GuardOptions, stop: StopFlag, ready: Callable[[str], None]) -> RunSummary | None:
    """Guard an arm until a stop, or until a hold of its own has been released; None when there was no hold.

    ready is told the socket once the port is open.  Raises Refusal; torque is then as the agent has it.
    """
    with ExitStack() as stack:
        guard = _Guard(cell, options, stop, stack)
        ready(pairs(socket=options.socket))
        return guard.run()


def _told(reason: str, watched: Watched) -> str:
    """The reason, with what has become of the agent's files."""
    return f"{reason}: {damage}" if (damage := watched.damage) else reason


def _handed_over(watched: Watched) -> str:
    """That the agent was asked to end, and by which signal, for the reason of the hold that follows names it."""
    return f"{HANDED_OVER} ({watched.asked_by})" if watched.asked_by else HANDED_OVER


def _q_start(cell: Cell, arm: Arm) -> Vector:
    """Where the arm begins; one that floats does so anywhere, in a cell that need not be right.  Raises CheckError."""
    spec = spec_of(cell, arm)
    if spec is not None and not spec.moves(arm.name):
        return np.array(arm.entry.q_near_rad)
    report = examine(cell)
    report.require()
    return report.q_start[cell.arms.index(arm)]


class _Guard:
    """One arm's guard."""

    def __init__(self, cell: Cell, options: GuardOptions, stop: StopFlag, stack: ExitStack) -> None:
        stack.callback(leave_realtime)
        self._cell, self._options, self._stop = cell, options, stop
        self._arm: Arm = cell.arm(options.arm)
        self._q_start = _q_start(cell, self._arm)
        self._agent: Agent = build_agent(cell, self._arm)
        emulated, simulated = options.emulated, options.driver is DriverKind.SIM
        floats = spec_of(cell, self._arm) is not None
        self._vigil = partial(vigil_of, cell.period_ns, emulated=emulated, simulated=simulated, floating=floats)
        self._notifier = stack.enter_context(closing(Notifier()))
        self._successor: Successor | FloatSuccessor
        if floats:
            self._successor = FloatSuccessor(cell, self._arm, self._agent, self._notifier, shared=options.shared)
        else:
            self._successor = Successor(cell, self._arm, self._agent, options, stop, self._notifier)
        self._clock = MonotonicClock()
        self._port = self._open_port()
        stack.callback(self._close_port)
        quiet_memory()
        if options.priority is not None:
            become_realtime(options.priority)
        # an agent that comes is answered at once: memory takes a second to lock
        self._line = stack.enter_context(GuardEnd(options.socket, cell.fingerprint))
        self._aside = Aside()
        self._told, self._drivers = dict[str, Any](), tuple[int, ...]()  # by the agent: of its driver
        self._session = False  # whether the agent goes from rest to rest
        self._watched: Watched | None = None
        self._driver: Standby | None = None
        stack.callback(self._let_go)
        self._stroked_ns = 0
        self._notifier.ready(WAITING)

    def _open_port(self) -> SerialPort | None:
        """None of a simulated arm; else kept by the service manager while this guard was gone, or opened and locked."""
        if self._options.driver is DriverKind.SIM:
            return None
        path, kept = port_of(self._arm, self._options), stored_fds()
        if PORT in kept:  # where this guard was gone alone, its agent is in the middle of an exchange
            port = SerialPort(path, self._arm.baud, self._clock, lambda: kept[PORT], in_use=True)
        else:
            port = SerialPort(path, self._arm.baud, self._clock)
        port.open()
        self._notifier.keep(PORT, port.fileno())
        return port

    def _close_port(self) -> None:
        if self._port is not None:
            self._port.close()

    # --- while there is an agent ----------------------------------------------------------------------------------

    def run(self) -> RunSummary | None:
        """Until a stop, or the end of a hold; an agent that was gone before the stop came has handed its arm over."""
        while True:
            stopped = self._stop.stopped
            reason = self._look()
            if reason and self._watched is not None and self._driver is not None:
                self._aside(f"arm {self._arm.name}: {reason}: the guard goes on in its place until `coop release`")
                return self._successor.hold(self._watched, self._driver, reason, session=self._session)
            if stopped and not self._has_said_yes():
                return None
            self._wait()

    def _has_said_yes(self) -> bool:
        """Whether an agent ends because this guard goes on."""
        return self._watched is not None and self._watched.handed_over

    def _wait(self) -> None:
        poller = select.poll()
        watched = self._watched
        for fd in (*self._line.filenos(), *([] if watched is None else [watched.process.fileno()])):
            poller.register(fd, select.POLLIN)
        with contextlib.suppress(InterruptedError):
            poller.poll((IDLE_NS if watched is None else WATCH_NS) * 1e-6)

    def _look(self) -> str:
        """One look at everything; why to take over, or nothing."""
        now_ns = time.monotonic_ns()
        if now_ns - self._stroked_ns >= HEARTBEAT_S * 1e9:
            self._stroked_ns = now_ns
            self._notifier.alive()
        while (said := self._line.hear()) is not None:  # all of them: an agent that has left is gone, and not dead
            self._answer(said, now_ns)
        watched = self._watched
        if watched is None:
            return ""
        if why := self._end_of(watched, now_ns):
            return _handed_over(watched) if watched.handed_over else _told(why, watched)
        if not watched.rehearsed and watched.rows >= REHEARSE_AT:
            watched.rehearsed = True
            beginning(self._agent, watched.last_rows(), "", session=self._session)
        return ""

    def _end_of(self, watched: Watched, now_ns: int) -> str:
        """How the agent has come to its end, or has been brought to it; nothing of one that works."""
        if watched.gone:
            return "the agent has died"
        if not watched.hangs(now_ns) or self._waits_for_others(watched):
            return ""
        watched.process.kill(self._notifier.alive)
        return f"the agent hung (no row for {watched.vigil.still_ns * 1e-6:.0f} ms) and was ended"

    def _waits_for_others(self, watched: Watched) -> bool:
        """Whether its arm is simulated and time has not begun there: that needs every arm, and holds nothing."""
        return self._options.driver is DriverKind.SIM and watched.rows == 0

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
                self._watched.handed_over, self._watched.asked_by = True, str(said.content.get("why", ""))
                self._line.answer()
        except Refusal as error:
            self._line.refuse(error)
        except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:  # it came from another process
            found, remedy = f"{type(error).__name__} {error}", "start agent and guard from one release"
            self._line.refuse(GuardError(said.word, found=found, expected="what an agent says", remedy=remedy))

    def _lend(self, *, again: bool, now_ns: int) -> None:
        """The port; again: opened anew, for the agent has lost it."""
        if self._port is None:
            raise GuardError(
                f"port from the guard at {self._options.socket}", found="a simulated arm", expected="one with a port",
                remedy="give both one driver",
            )  # fmt: skip
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
        own, self._drivers = said.fds[:DESCRIPTORS], said.fds[DESCRIPTORS:]
        try:
            self._told, self._session = dict(said.content["driver"]), bool(said.content.get("session"))
            self._driver = self._prepared()
        except BaseException:
            close_all(own)
            raise
        time.sleep(PAUSE_S)
        self._watched = Watched.of(said, self._vigil())
        time.sleep(PAUSE_S)
        self._notifier.send("STATUS=watches the agent")
        self._line.answer()

    def _prepared(self) -> Standby:
        return build_standby(
            self._cell, self._arm, self._options, self._port, self._q_start, self._successor.warn, self._drivers,
            self._told,
        )  # fmt: skip

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
