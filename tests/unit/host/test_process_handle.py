"""A process by its handle: it is gone when it runs no code of its own any more, and has ended some time after that."""

from __future__ import annotations

import mmap
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from agent.host import process_handle
from agent.host.process_handle import ProcessHandle

# enough memory that giving it back takes a while
LARGE = """
import mmap, sys
held = mmap.mmap(-1, {size})
for page in range(0, len(held), mmap.PAGESIZE):
    held[page] = 1
print("ready", flush=True)
sys.stdin.read()
"""
SIZE = 256 * 2**20
PATIENCE_S = 20.0

Started = Callable[[int], "subprocess.Popen[bytes]"]


@pytest.fixture
def started() -> Iterator[Started]:
    """Starts a process that waits, with so many bytes of memory."""
    processes = []

    def start(size: int = mmap.PAGESIZE) -> subprocess.Popen[bytes]:
        words = (sys.executable, "-S", "-c", LARGE.format(size=size))
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        processes.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def handle_of(process: subprocess.Popen[bytes]) -> ProcessHandle:
    return ProcessHandle(os.pidfd_open(process.pid))


def waits_for(what: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline_s


class Meanwhile:
    """Is called while somebody waits, and gives up in the end."""

    def __init__(self) -> None:
        self.strokes = 0

    def __call__(self) -> None:
        self.strokes += 1
        assert self.strokes < 4000, "it has not ended for twenty seconds"


def test_a_process_that_works_or_is_stopped_is_neither_gone_nor_ended(started: Started) -> None:
    process = started(mmap.PAGESIZE)
    handle = handle_of(process)
    for number in (0, signal.SIGSTOP):
        process.send_signal(number)
        assert not handle.gone
        assert not handle.ended
    handle.close()


@pytest.mark.fault("P1")
def test_a_process_that_was_killed_is_gone_before_it_has_given_its_memory_back(started: Started) -> None:
    """The servos of its arm wait for a fifth of a second."""
    for _ in range(20):
        process = started(SIZE)
        handle = handle_of(process)
        process.kill()
        waits_for(lambda seen=handle: seen.gone)
        ended = handle.ended
        waits_for(lambda seen=handle: seen.ended)
        assert handle.gone
        handle.close()
        if not ended:
            return
    pytest.fail("it had always ended")


def test_where_it_cannot_be_seen_what_a_process_does_its_handle_alone_says_that_it_is_gone(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its folder is hidden, or refused: nobody may be taken for gone who is not."""
    real = Path.readlink

    def hidden(path: Path) -> Path:
        raise FileNotFoundError(path)

    def refused(path: Path) -> Path:
        raise PermissionError(path)

    process = started(mmap.PAGESIZE)
    handles = []
    for does in (hidden, refused):
        monkeypatch.setattr(Path, "readlink", does)
        handles.append(handle_of(process))
        assert not handles[-1].gone
    monkeypatch.setattr(Path, "readlink", real)
    assert not any(handle.gone for handle in handles)
    late = handle_of(process)
    monkeypatch.setattr(Path, "readlink", refused)
    assert not late.gone, "refused later"
    process.kill()
    for handle in (*handles, late):
        waits_for(lambda seen=handle: seen.gone)
        assert handle.ended
        handle.close()


@pytest.mark.fault("P2")
def test_one_that_is_stopped_is_killed_and_waited_for_until_it_is_gone_and_no_longer(started: Started) -> None:
    for _ in range(20):
        process = started(SIZE)
        process.send_signal(signal.SIGSTOP)
        handle = handle_of(process)
        handle.kill(Meanwhile())
        ended = handle.ended
        assert handle.gone
        assert process.wait() == -signal.SIGKILL
        handle.close()
        if not ended:
            return
    pytest.fail("it had always ended")


@pytest.mark.fault("P2")
def test_one_of_which_nothing_is_seen_is_killed_and_waited_for_until_it_has_ended(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "readlink", lambda _: (_ for _ in ()).throw(PermissionError))
    monkeypatch.setattr(process_handle, "KILL_LOOK_MS", 10_000)
    process = started(SIZE)
    handle = handle_of(process)
    handle.kill(lambda: pytest.fail("looked again and again"))
    assert handle.ended
    handle.close()


@pytest.mark.fault("P2")
def test_one_that_is_killed_is_waited_for_and_somebody_is_told_meanwhile(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = started(mmap.PAGESIZE)
    process.send_signal(signal.SIGSTOP)
    handle, really = handle_of(process), signal.pidfd_send_signal

    class Late(Meanwhile):
        """The signal takes its time."""

        def __call__(self) -> None:
            super().__call__()
            if self.strokes == 3:
                really(handle.fileno(), signal.SIGKILL)

    monkeypatch.setattr(signal, "pidfd_send_signal", lambda *_: None)
    late = Late()
    handle.kill(late)
    assert handle.gone
    assert late.strokes >= 3
    monkeypatch.setattr(signal, "pidfd_send_signal", really)
    process.wait()
    handle.kill(lambda: pytest.fail("it has ended"))
    handle.close()
    with suppress(OSError):
        os.close(handle.fileno())
        pytest.fail("it was closed")


def test_a_process_that_has_ended_already_is_gone(started: Started) -> None:
    process = started(mmap.PAGESIZE)
    pidfd = os.pidfd_open(process.pid)
    process.kill()
    process.wait()
    handle = ProcessHandle(pidfd)
    assert handle.gone
    assert handle.ended
    handle.close()
