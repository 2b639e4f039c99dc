"""Serve emulated arms on pseudo terminals in real time: `coop emulate CELL`.

One loop for the whole cell: wait for bytes or the next due time, let physics catch up, answer.  No arm
waits for another, and servos keep the clock's pace.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.interface import Refusal
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.faults import parse_lines, read_lines
from sim_backend.wire.injector import Injector, by_arm
from sim_backend.wire.pty import PtyPort

log = logging.getLogger(__name__)

TICK_NS = 1_000_000  # physics and watchdogs are looked after at least this often
STALL_NS = 20_000_000  # a loop later than this was not running itself: bytes that wait count before watchdogs do
COMMAND_BYTES = 65536
TIMER_SLACK = Path("/proc/self/timerslack_ns")  # of the main thread
CLEAR = "clear"  # ends all faults


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Where the ports appear and where faults come from."""

    ports: Mapping[str, Path]  # arm -> path of its port
    faults_file: Path | None = None  # JSON lines, times from the start of serving
    control_socket: Path | None = None  # Unix datagram socket: JSON lines or "clear", times from arrival
    seed: int = 0
    on_tick: Callable[[int], None] | None = None  # called with the time every tick_ns; must not block
    tick_ns: int = 5_000_000


class _Endpoint:
    """One arm on its port."""

    def __init__(self, cell: EmulatedCell, index: int, port: PtyPort, seed: int) -> None:
        self.cell = cell
        self.arm = cell.arms[index]
        self.port = port
        self.injector = Injector(self.arm, port, seed)

    def receive(self, now_ns: int) -> None:
        """Take what the client wrote."""
        port = self.port
        if port.present and not self.injector.stalled:
            data = port.read()
            if data:
                self.cell.sense(self.arm, now_ns)
                self.arm.bus.receive(data, now_ns, port.baud())

    def send(self, now_ns: int) -> None:
        """Give the client what is due."""
        data = self.arm.bus.take(now_ns)
        if data and self.port.present:
            self.port.write(data)


class Server:
    """The loop's state.  Use as a context: ports exist inside it."""

    def __init__(self, cell: EmulatedCell, options: ServeOptions, clock_ns: Callable[[], int]) -> None:
        self.cell = cell
        self.options = options
        self.laps = 0
        self._clock_ns = clock_ns
        self._endpoints = [
            _Endpoint(cell, index, PtyPort(options.ports[arm.name]), options.seed + index)
            for index, arm in enumerate(cell.arms)
        ]
        self._injectors = {endpoint.arm.name: endpoint.injector for endpoint in self._endpoints}
        self._control: socket.socket | None = None
        self._last_tick_ns = self._next_call_ns = clock_ns()

    def __enter__(self) -> Server:
        """Create the ports.  Raises OSError, FaultError."""
        servos = {name: injector.servo_ids for name, injector in self._injectors.items()}
        faults = read_lines(self.options.faults_file, servos) if self.options.faults_file else []
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            for endpoint in self._endpoints:
                endpoint.port.appear()
            if self.options.control_socket is not None:
                self._control = _listen(self.options.control_socket)
            by_arm(self._injectors, faults, self._clock_ns())
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove ports and socket.  Safe twice."""
        for endpoint in self._endpoints:
            endpoint.port.vanish()
        if self._control is not None and self.options.control_socket is not None:
            self._control.close()
            self.options.control_socket.unlink(missing_ok=True)
            self._control = None

    def lap(self) -> None:
        """Wait for bytes or the next due time, then do all that is due."""
        self.laps += 1
        self._wait()
        now_ns = self._clock_ns()
        self.cell.catch_up(now_ns)
        ticking = now_ns - self._last_tick_ns >= TICK_NS
        stalled = now_ns - self._last_tick_ns > STALL_NS
        if ticking:
            self._last_tick_ns = now_ns
            self._tick(now_ns)
        for endpoint in self._endpoints:
            if ticking and not stalled:
                self._watchdogs(endpoint, now_ns)
            endpoint.receive(now_ns)
            endpoint.send(now_ns)

    def command(self, text: str) -> None:
        """Carry out fault commands now.  Raises FaultError."""
        now_ns = self._clock_ns()
        if text.strip() == CLEAR:
            for injector in self._injectors.values():
                injector.clear(now_ns)
        else:
            by_arm(self._injectors, parse_lines(text), now_ns)
            for injector in self._injectors.values():
                injector.tick(now_ns)  # a fault without delay has begun when its sender hears "ok"

    def _tick(self, now_ns: int) -> None:
        for endpoint in self._endpoints:
            endpoint.injector.tick(now_ns)
            if endpoint.port.present:
                endpoint.port.forget_exclusive()
        if self._control is not None:
            self._read_commands(self._control)
        if self.options.on_tick is not None and now_ns >= self._next_call_ns:
            self._next_call_ns = max(self._next_call_ns + self.options.tick_ns, now_ns)
            self.options.on_tick(now_ns)

    def _watchdogs(self, endpoint: _Endpoint, now_ns: int) -> None:
        fired = endpoint.arm.bus.tick(now_ns)
        if fired:
            log.warning("arm %s: the bus watchdog of %d servos fired", endpoint.arm.name, fired)

    def _wait(self) -> None:
        """Sleep until a client writes, a reply is due or the next tick."""
        due_ns = self._last_tick_ns + TICK_NS
        files: list[PtyPort] = []
        for endpoint in self._endpoints:
            reply_ns = endpoint.arm.bus.due_ns()
            if reply_ns is not None and reply_ns < due_ns:
                due_ns = reply_ns
            if endpoint.port.present and not endpoint.injector.stalled:
                files.append(endpoint.port)
        remaining_ns = due_ns - self._clock_ns()
        select.select(files, (), (), max(0, remaining_ns) * 1e-9)

    def _read_commands(self, control: socket.socket) -> None:
        while True:
            try:
                data, sender = control.recvfrom(COMMAND_BYTES)
            except BlockingIOError:
                return
            try:
                self.command(data.decode(errors="replace"))
                answer = "ok"
            except Refusal as refusal:
                answer = str(refusal)
                log.warning("%s", answer)
            if sender:
                with contextlib.suppress(OSError):  # the sender may be gone
                    control.sendto(answer.encode(), sender)


def _listen(path: Path) -> socket.socket:
    """The control socket at `path` (mode 0600), in the place of one that an emulator has left.  Raises OSError."""
    if path.is_socket():
        path.unlink(missing_ok=True)
    made = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        made.setblocking(False)
        os.fchmod(made.fileno(), 0o600)  # before bind: the path is never there with another mode
        made.bind(str(path))
    except OSError as error:
        made.close()
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    return made


def serve(
    cell: EmulatedCell, options: ServeOptions, stop: Callable[[], bool], ready: Callable[[], None] = lambda: None
) -> Server:
    """Serve until `stop()` is true; return the server for its counters.  Raises OSError, FaultError, PlantError.

    ready: called once faults are read and ports are there.
    """
    clock_ns = time.monotonic_ns
    cell.time_ns = clock_ns()
    with _punctual(), Server(cell, options, clock_ns) as server:
        ready()
        while not stop():
            server.lap()
    return server


@contextlib.contextmanager
def _punctual() -> Iterator[None]:
    """Wake up within microseconds instead of 50 later; no garbage collection (a lap makes no cycles)."""
    slack = None
    if threading.current_thread() is threading.main_thread():
        with contextlib.suppress(OSError):  # a kernel that does not offer it only delivers a little later
            slack = TIMER_SLACK.read_text()
            TIMER_SLACK.write_text("1000")
    collecting = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
        if slack is not None:
            TIMER_SLACK.write_text(slack)
