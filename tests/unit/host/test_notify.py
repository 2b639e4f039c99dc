"""The service manager's socket: descriptors that it keeps while a service is gone, and gives to its next process."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.guard.guarded import BUSY_S
from agent.host.notify import BUSY_US, FIRST_FD, LOADING_US, Notifier, stored_fds


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(str(tmp_path / "notify"))
        end.settimeout(5.0)
        yield end


def test_a_descriptor_is_kept_in_the_place_of_an_older_one(manager: socket.socket, tmp_path: Path) -> None:
    out, into = os.pipe()
    notifier = Notifier(str(tmp_path / "notify"))
    notifier.keep("port", out)
    assert manager.recv(1000) == b"FDSTOREREMOVE=1\nFDNAME=port"
    text, (fd,), _, _ = socket.recv_fds(manager, 1000, 4)
    assert text == b"FDSTORE=1\nFDNAME=port"
    assert os.path.sameopenfile(fd, out)
    for one in (fd, out, into):
        os.close(one)
    notifier.close()


def test_without_a_manager_nothing_is_kept() -> None:
    notifier = Notifier("")
    notifier.keep("port", 0)
    notifier.close()


@pytest.mark.parametrize("interval", ["500000", ""])
def test_a_process_that_loads_is_watched_from_its_first_stroke_on(
    manager: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interval: str
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", interval)
    notifier = Notifier(str(tmp_path / "notify"))

    def heard() -> list[str]:
        return manager.recv(1000).decode().split("\n")

    def every(microseconds: object) -> list[str]:
        return [f"WATCHDOG_USEC={microseconds}"] if interval else []

    assert LOADING_US == 60_000_000, "a minute, in which the other arms must be there"
    notifier.loading("loads")
    assert heard() == ["READY=1", "STATUS=loads", *every(LOADING_US)]
    notifier.alive()
    assert heard() == ["WATCHDOG=1", *every(interval)]
    notifier.alive()
    assert heard() == ["WATCHDOG=1"]
    notifier.loading("again")
    notifier.ready("waits")
    assert heard() == ["READY=1", "STATUS=again", *every(LOADING_US)]
    assert heard() == ["READY=1", "STATUS=waits", *every(interval)]
    notifier.alive()
    assert heard() == ["WATCHDOG=1"]
    notifier.close()


def test_a_process_that_is_busy_is_watched_less_closely_until_its_next_stroke(
    manager: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "100000")
    notifier = Notifier(str(tmp_path / "notify"))
    notifier.busy()
    notifier.alive()
    notifier.alive()
    heard = [manager.recv(1000).decode() for _ in range(3)]
    assert heard == [f"WATCHDOG=1\nWATCHDOG_USEC={BUSY_US}", "WATCHDOG=1\nWATCHDOG_USEC=100000", "WATCHDOG=1"]
    assert BUSY_US == 1_000_000, "a hang is still found within a second"
    assert BUSY_US * 1e-6 > BUSY_S, "of which bringing an arm back takes all at worst"
    notifier.close()


def test_a_process_that_does_not_load_strokes_and_says_nothing_of_its_interval(
    manager: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "500000")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    notifier = Notifier()
    notifier.alive()
    assert manager.recv(1000) == b"WATCHDOG=1"
    notifier.close()
    notifier.alive()
    notifier.close()


def test_a_manager_that_does_not_read_holds_nobody_up(manager: socket.socket, tmp_path: Path) -> None:
    notifier: Any = Notifier(str(tmp_path / "notify"))
    assert not notifier._socket.getblocking()
    for _ in range(2000):  # more than the line takes
        notifier.alive()
    assert manager.recv(1000) == b"WATCHDOG=1"
    notifier.close()


def test_a_manager_that_is_gone_ends_nobody_and_is_told_again_once_it_is_back(tmp_path: Path) -> None:
    """Of a loop that strokes it 50 times a second."""
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as first:
        first.bind(str(path))
        notifier = Notifier(str(path))
        out, into = os.pipe()
    for _ in range(3):
        notifier.alive()
        notifier.keep("port", out)
    path.unlink()
    notifier.alive()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as second:
        second.bind(str(path))
        second.settimeout(5.0)
        notifier.alive()
        assert second.recv(1000) == b"WATCHDOG=1"
    notifier.close()
    for fd in (out, into):
        os.close(fd)


def test_a_manager_that_nobody_serves_is_an_error_at_the_start(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Notifier(str(tmp_path / "nobody"))


def test_a_manager_may_have_a_name_without_a_file() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(f"\0coop-test-{os.getpid()}")
        end.settimeout(5.0)
        notifier = Notifier(f"@coop-test-{os.getpid()}")
        notifier.stopping("torque off")
        assert end.recv(1000) == b"STOPPING=1\nSTATUS=torque off"
        notifier.close()


def test_without_a_manager_nothing_is_said() -> None:
    notifier = Notifier("")
    notifier.alive()
    notifier.loading("x")
    notifier.ready("x")
    notifier.close()


@pytest.mark.parametrize(
    ("told", "found"),
    [
        ({"LISTEN_FDS": "2", "LISTEN_FDNAMES": "port:other"}, {"port": 900, "other": 901}),
        ({"LISTEN_FDS": "1", "LISTEN_FDNAMES": "port:other"}, {"port": 900}),
        ({"LISTEN_FDS": "two", "LISTEN_FDNAMES": "port"}, {}),
        ({"LISTEN_FDS": "2", "LISTEN_FDNAMES": "port:other", "LISTEN_PID": "1"}, {}),
    ],
)
def test_what_a_manager_kept_is_for_the_process_it_was_given_to(
    told: dict[str, str], found: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.host.notify.FIRST_FD", 900)
    ends = os.pipe()
    for fd, end in zip((900, 901), ends, strict=True):
        os.dup2(end, fd)
    environment = {"LISTEN_PID": str(os.getpid()), **told}
    assert stored_fds(environment) == found
    assert [os.get_inheritable(fd) for fd in found.values()] == [False] * len(found)
    assert stored_fds(environment) == {}, "once"
    for fd in (900, 901, *ends):
        os.close(fd)


def test_kept_descriptors_are_found_by_name_once() -> None:
    program = (
        "import os; from agent.host.notify import stored_fds; found = stored_fds();"
        "print(found, [os.get_inheritable(fd) for fd in found.values()], stored_fds())"
    )
    command = 'LISTEN_FDS=2 LISTEN_FDNAMES=port:other LISTEN_PID=$$ exec "$0" -c "$1" 3</dev/null 4</dev/null'
    done = subprocess.run(["sh", "-c", command, sys.executable, program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{{'port': {FIRST_FD}, 'other': {FIRST_FD + 1}}} [False, False] {{}}"


def test_what_was_kept_for_another_process_is_not_ours() -> None:
    environment = {"LISTEN_FDS": "1", "LISTEN_PID": "1", "LISTEN_FDNAMES": "port"}
    assert stored_fds(environment) == {}
    assert environment == {}, "and nobody that is started later takes it for its own"
