"""Time and serial lines that exist in this process alone: arms in threads, one of which goes at a time.

Every run is the same, however fast the machine is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from drivers.dynamixel.errors import PortError, PortLostError, WriteTimeoutError
from drivers.interface import Clock
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.bus import Bus
from sim_backend.wire.injector import Injector

NOBODY = 0
STEP_NS = 1_000_000  # in which time passes, so that watchdogs and faults can follow


class Advancing(Protocol):
    """Servos, and what moves them, that go where time goes; the emulated cell is one."""

    @property
    def arms(self) -> Sequence[EmulatedArm]:
        """On whose buses time passes."""

    @property
    def time_ns(self) -> int:
        """At which it stands."""

    def advance_to(self, now_ns: int) -> None:
        """Go there."""


class SharedClock:
    """One time for all arms; it passes while all of them wait, and stops for the one that is due."""

    utc_offset_ns = 0

    def __init__(
        self, cell: Advancing, injectors: Sequence[Injector], members: int,
        passed: Callable[[int], None] = lambda _: None,
    ) -> None:  # fmt: skip
        """members: threads that join it; passed: is told after each step of time what time it is."""
        self._ns = cell.time_ns
        self._cell = cell
        self._injectors = injectors
        self._missing = members
        self._passed = passed
        self._joining = threading.Lock()  # afterwards who goes is alone
        self._due: dict[int, int] = {}  # by thread
        self._turns: dict[int, threading.Lock] = {}  # by thread; each is held until it is that one's turn
        self._goes = NOBODY

    def now_ns(self) -> int:
        """Virtual now; asking takes a little time, as everything does."""
        self._ns += 200
        return self._ns

    def sleep_until(self, deadline_ns: int) -> None:
        """Let the others go on until it is time."""
        me = threading.get_ident()
        self._due[me] = deadline_ns
        if self._next() != me:
            self._turns[me].acquire()

    def live(self, lives: Sequence[Callable[[], None]]) -> None:
        """Carry these out, each in a thread of its own, to the end of all; as many as there are members.

        Raises what the first in order that failed has raised.
        """
        failed: dict[int, BaseException] = {}

        def one(place: int) -> None:
            self._join()
            try:
                lives[place]()
            except BaseException as error:  # noqa: BLE001 - raised again below
                failed[place] = error
            finally:
                self._leave()

        threads = [threading.Thread(target=one, args=(place,), daemon=True) for place in range(len(lives))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if failed:
            raise failed[min(failed)]

    def _join(self) -> None:
        """Called by each thread before it does anything; returns when all have, one after the other."""
        me = threading.get_ident()
        turn = self._turns[me] = threading.Lock()
        turn.acquire()
        with self._joining:
            self._due[me] = self._ns + self._missing  # they begin in the order in which they came
            self._missing -= 1
            if not self._missing:
                self._next()
        turn.acquire()

    def _leave(self) -> None:
        """The calling thread waits for nothing any more."""
        self._due.pop(threading.get_ident(), None)
        self._next()

    def _next(self) -> int:
        """Let time pass until somebody is due, wake that thread where it is another than before; return which.

        Who has woken another looks at nothing here any more until its own turn comes.
        """
        before = self._goes
        goes = self._goes = min(self._due, key=self._due.__getitem__, default=NOBODY)
        if goes != NOBODY:
            self._pass_until(self._due[goes])
            if goes != before:
                self._turns[goes].release()
        return goes

    def _pass_until(self, deadline_ns: int) -> None:
        while self._ns < deadline_ns:
            self._ns = min(deadline_ns, self._ns + STEP_NS)
            for injector in self._injectors:
                injector.tick(self._ns)
            self._cell.advance_to(self._ns)
            for arm in self._cell.arms:
                arm.bus.tick(self._ns)
            self._passed(self._ns)


class Plug:
    """Where an adapter is plugged; an injector pulls it and puts it back."""

    def __init__(self) -> None:
        self.lost = False
        self.pulled = 0  # how often: what was opened before is gone for good

    def vanish(self) -> None:
        """Pull the adapter."""
        self.lost, self.pulled = True, self.pulled + 1

    def appear(self) -> None:
        """Put it back."""
        self.lost = False


@dataclass
class Line:
    """The serial line of one arm."""

    cell: Advancing
    index: int
    injector: Injector
    clock: Clock
    plug: Plug = field(default_factory=Plug)
    user: VirtualPort | None = None

    @property
    def bus(self) -> Bus:
        """The emulated line of this arm."""
        return self.cell.arms[self.index].bus


class VirtualPort:
    """`drivers.dynamixel.line.port.Port` straight on the emulated bus."""

    def __init__(self, line: Line, baud: int) -> None:
        self.baud = baud
        self.latency_timer_ms: int | None = None
        self.is_open = False
        self._line = line
        self._pulled = line.plug.pulled

    def open(self) -> None:
        """Take the line.  Raises PortError."""
        if self._line.plug.lost:
            raise PortError("port virtual", found="no such file", expected="an adapter", remedy="plug it in")
        if self._line.user not in (None, self):
            raise PortError("port virtual", found="in use by this process", expected="nobody", remedy="close the other")
        self._line.user = self
        self._pulled = self._line.plug.pulled
        self.is_open = True

    def close(self) -> None:
        """Give the line back."""
        self.is_open = False
        if self._line.user is self:
            self._line.user = None

    def set_baud(self, baud: int) -> None:
        """Change the host's rate."""
        self.baud = baud

    def read_now(self) -> bytes:
        """What has arrived.  Raises PortLostError."""
        self._need()
        clock = self._line.clock
        clock.sleep_until(clock.now_ns())
        return self._line.bus.take(clock.now_ns())[:4096]

    def read_until(self, deadline_ns: int) -> bytes:
        """The first bytes that arrive, or none by the deadline.  Raises PortLostError."""
        clock, bus = self._line.clock, self._line.bus
        while True:
            data = self.read_now()
            now_ns = clock.now_ns()
            if data or now_ns >= deadline_ns:
                return data
            due_ns = bus.due_ns()
            wake_ns = min(deadline_ns, now_ns + STEP_NS)
            clock.sleep_until(min(wake_ns, max(due_ns, now_ns + 1)) if due_ns is not None else wake_ns)

    def discard_input(self) -> int:
        """Forget what has arrived; how many bytes."""
        return len(self.read_now())

    def write(self, data: bytes, deadline_ns: int) -> None:
        """Send.  Raises PortLostError, WriteTimeoutError."""
        self._need()
        clock = self._line.clock
        if self._line.injector.stalled:
            clock.sleep_until(deadline_ns)
            raise WriteTimeoutError("port virtual", found="0 bytes taken", expected="all", remedy="none")
        clock.sleep_until(clock.now_ns())
        self._line.cell.advance_to(clock.now_ns())
        self._line.bus.receive(data, clock.now_ns(), self.baud)

    def _need(self) -> None:
        plug = self._line.plug
        if plug.lost or plug.pulled != self._pulled or not self.is_open:
            raise PortLostError("port virtual", found="closed", expected="open", remedy="none")
