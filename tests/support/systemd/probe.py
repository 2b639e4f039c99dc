"""What runs in a unit's place to find out what the kernel allows there.  Usage: systemd_probe.py WHAT [PATH ...]."""

from __future__ import annotations

import ctypes
import errno
import json
import mmap
import os
import resource
import signal
import socket
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

FAMILIES = ("AF_UNIX", "AF_INET", "AF_INET6", "AF_NETLINK", "AF_PACKET")


def outcome(attempt: Callable[[], object]) -> str:
    """ "ok", or the name of the error."""
    try:
        attempt()
    except OSError as error:
        return errno.errorcode[error.errno or 0]
    return "ok"


def kernel(paths: list[str]) -> None:
    """Print what happens to every attempt, as one line of JSON, and wait to be stopped."""
    libc = ctypes.CDLL(None, use_errno=True)

    def set_clock() -> None:
        time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME))

    def write_and_execute() -> None:
        mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC).close()

    def new_namespace() -> None:
        if libc.unshare(0x10000000):
            raise OSError(ctypes.get_errno(), "unshare")

    status = dict(line.split(":\t", 1) for line in Path("/proc/self/status").read_text().splitlines() if ":\t" in line)
    attempts: dict[str, Callable[[], object]] = {family: partial(_open_socket, family) for family in FAMILIES}
    attempts |= {"clock": set_clock, "write and execute": write_and_execute, "namespace": new_namespace}
    for path in map(Path, paths):
        attempts |= {f"read {path}": partial(_read, path), f"write {path}": partial(_write, path)}
    found = {name: outcome(attempt) for name, attempt in attempts.items()}
    found |= {name: status[name].strip() for name in ("CapEff", "CapBnd", "NoNewPrivs", "Seccomp")}
    if resource.getrlimit(resource.RLIMIT_RTPRIO)[0] >= 80:
        found["real time"] = outcome(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(80)))
    print(json.dumps(found), flush=True)  # noqa: T201
    notify("READY=1")
    while True:
        notify("WATCHDOG=1")
        time.sleep(0.02)


def _open_socket(family: str) -> None:
    socket.socket(getattr(socket, family), socket.SOCK_DGRAM).close()


def _read(path: Path) -> None:
    if path.is_dir():
        list(path.iterdir())
    else:
        path.read_bytes()


def _write(path: Path) -> None:
    with (path / "probe" if path.is_dir() else path).open("a"):
        pass


def hold(_: list[str]) -> None:
    """Behave as an agent: SIGTERM means HOLD, SIGUSR1 then means released; no sign of life is needed in HOLD."""
    got: set[int] = set()
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, lambda number, _: got.add(number))
    notify("READY=1")
    while not got >= {signal.SIGTERM, signal.SIGUSR1}:
        if signal.SIGTERM in got:
            notify("STATUS=HOLD")
        else:
            notify("WATCHDOG=1")
        time.sleep(0.02)


def hang(_: list[str]) -> None:
    """Get ready, leave a black box, and never come back."""
    Path(os.environ["RUNTIME_DIRECTORY"], "hang.ring").write_text("last words")
    notify("READY=1")
    endless_loop()


def endless_loop() -> None:
    """The name that has to be in the journal."""
    while True:
        pass


def notify(state: str) -> None:
    """Tell systemd, if it listens."""
    if "NOTIFY_SOCKET" in os.environ:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
            out.sendto(state.encode(), os.environ["NOTIFY_SOCKET"])


if __name__ == "__main__":
    {"kernel": kernel, "hold": hold, "hang": hang}[sys.argv[1]](sys.argv[2:])
