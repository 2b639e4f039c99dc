"""The operator's socket: what is accepted, from whom, and what is refused with a reason."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.operator.socket import ControlError, ControlSocket, Verb, ask

FINGERPRINT = "ab" * 32


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Path, ControlSocket]]:
    """A control socket that is polled as a loop would."""
    path = tmp_path / "left.control"
    control = ControlSocket(path, FINGERPRINT)
    end = threading.Event()

    def loop() -> None:
        while not end.is_set():
            control.poll()
            time.sleep(0.001)

    thread = threading.Thread(target=loop)
    thread.start()
    yield path, control
    end.set()
    thread.join()
    control.close()
    assert not path.exists()


def test_start_is_taken_over(served: tuple[Path, ControlSocket]) -> None:
    path, control = served
    instant = time.time_ns() + 10**12
    ask(path, Verb.START, start_utc_ns=instant, fingerprint=FINGERPRINT)
    assert control.requests.start_utc_ns == instant
    assert path.stat().st_mode & 0o777 == 0o600


def test_stop_and_release(served: tuple[Path, ControlSocket]) -> None:
    path, control = served
    ask(path, Verb.STOP)
    assert (control.requests.stopped, control.requests.released) == (True, False)
    ask(path, Verb.RELEASE)
    assert control.requests.released


def test_another_cell_is_refused(served: tuple[Path, ControlSocket]) -> None:
    path, control = served
    with pytest.raises(ControlError, match="give both the same file"):
        ask(path, Verb.START, start_utc_ns=time.time_ns() + 10**12, fingerprint="cd" * 32)
    assert control.requests.start_utc_ns is None


def test_an_instant_that_has_passed_is_refused(served: tuple[Path, ControlSocket]) -> None:
    path, control = served
    with pytest.raises(ControlError, match="a start that has passed"):
        ask(path, Verb.START, start_utc_ns=time.time_ns() - 1, fingerprint=FINGERPRINT)
    assert control.requests.start_utc_ns is None


@pytest.mark.parametrize("nonsense", [b"{}", b"start", b"\xff\xfe", b'{"verb": "move"}', b'{"verb": "start"}', b"[1]"])
def test_nonsense_changes_nothing(served: tuple[Path, ControlSocket], nonsense: bytes) -> None:
    path, control = served
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger:
        stranger.settimeout(5.0)
        stranger.connect(str(path))
        stranger.send(nonsense)
        assert b'"ok": false' in stranger.recv(4096)
    assert (control.requests.start_utc_ns, control.requests.stopped, control.requests.released) == (None, False, False)


def test_a_client_that_says_nothing_does_not_hold_up_others(served: tuple[Path, ControlSocket]) -> None:
    path, control = served
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as silent:
        silent.connect(str(path))
        ask(path, Verb.STOP)
    assert control.requests.stopped


def test_no_agent_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(ControlError, match="expected an agent that answers"):
        ask(tmp_path / "none.control", Verb.STOP)
