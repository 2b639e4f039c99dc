"""Time and serial lines that exist in this process alone: each arm is a greenlet, and the one that is due first goes.

Every run is the same, however fast the machine is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from greenlet import getcurrent, greenlet

from drivers.clock import LOCKSTEP_UTC_NS
from drivers.dynamixel.errors import PortError, PortLostError, WriteTimeoutError
from drivers.interface import Clock
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.bus import Bus
from sim_backend.wire.injector import Injector

STEP_NS = 1_000_000  # in which time passes, so that watchdogs and faults can follow
UTC_OFFSET_NS = LOCKSTEP_UTC_NS // 2  # by which nobody takes it for time that waits for every arm


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

    utc_offset_ns = UTC_OFFSET_NS

    def __init__(
        self, cell: Advancing, injectors: Sequence[Injector], passed: Callable[[int], None] = lambda _: None
    ) -> None:
        """passed: is told after each step of time what time it is."""
        self._ns = cell.time_ns
        self._cell = cell
        self._injectors = injectors
        self._passed = passed
        self._due: dict[greenlet, int] = {}  # until when each waits

    def now_ns(self) -> int:
        """Virtual now; asking takes a little time, as everything does."""
        self._ns += 200
        return self._ns

    def sleep_until(self, deadline_ns: int) -> None:
        """Let the others go on until it is time."""
        me = getcurrent()
        self._due[me] = deadline_ns
        goes = self._next()
        if goes is not me:
            goes.switch()

    def live(self, lives: Sequence[Callable[[], None]]) -> None:
        """Carry these out, beside each other, to the end of all.

        Raises what the first in order that failed has raised; what is no Exception, as a Ctrl-C, at once: the others
        end where they are.
        """
        failed: dict[int, Exception] = {}

        def one(place: int) -> None:
            try:
                lives[place]()
            except Exception as error:  # noqa: BLE001 - raised again below
                failed[place] = error
            finally:
                self._due.pop(getcurrent(), None)

        begun = [greenlet(partial(one, place)) for place in range(len(lives))]
        self._due = {life: self._ns + place for place, life in enumerate(begun)}
        try:
            while self._due:
                self._next().switch()  # is back when one has ended
        finally:
            self._due.clear()  # who is ended waits for nobody
            for life in begun:
                life.throw()
        if failed:
            raise failed[min(failed)]

    def _next(self) -> greenlet:
        """Let time pass until somebody is due; return who."""
        goes = min(self._due, key=self._due.__getitem__)
        self._pass_until(self._due[goes])
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
