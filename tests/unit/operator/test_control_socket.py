"""The operator's socket: what is accepted, from whom, and what is refused with a reason; polled as a loop would."""

from __future__ import annotations

import json
import os
import socket
import stat
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from agent.operator import socket as control_socket
from agent.operator.socket import ControlError, ControlSocket, Verb, ask

FINGERPRINT = "ab" * 32
NOW_NS = 1_000_000_000_000
LATER_NS = NOW_NS + 1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "left.control"


@pytest.fixture
def control(path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ControlSocket]:
    """A control socket in a world whose time stands still."""
    monkeypatch.setattr(control_socket.time, "time_ns", lambda: NOW_NS)
    with closing(ControlSocket(path, FINGERPRINT)) as made:
        yield made
    assert not path.exists()


@contextmanager
def person(path: Path) -> Iterator[socket.socket]:
    """Somebody who has connected to the agent."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as own:
        own.settimeout(5.0)
        own.connect(str(path))
        yield own


def answer_to(control: ControlSocket, path: Path, request: Any) -> dict[str, Any]:
    """What a request gets, as bytes or as a document."""
    with person(path) as own:
        own.send(request if isinstance(request, bytes) else json.dumps(request).encode())
        control.poll()
        answer: dict[str, Any] = json.loads(own.recv(4096))
        return answer


def asked_for(control: ControlSocket) -> tuple[int | None, bool, bool]:
    """Start, stop and release as they have been asked for."""
    return control.requests.start_utc_ns, control.requests.stopped, control.requests.released


NOTHING = (None, False, False)


def start(**changes: Any) -> dict[str, Any]:
    return {"verb": "start", "start_utc_ns": LATER_NS, "fingerprint": FINGERPRINT} | changes


# --- what is asked for -----------------------------------------------------------------------------------------------


def test_start_is_taken_over(control: ControlSocket, path: Path) -> None:
    assert answer_to(control, path, start()) == {"ok": True}
    assert asked_for(control) == (LATER_NS, False, False)


@pytest.mark.parametrize(("verb", "expected"), [("stop", (None, True, False)), ("release", (None, False, True))])
def test_each_verb_asks_for_itself_alone(
    control: ControlSocket, path: Path, verb: str, expected: tuple[int | None, bool, bool]
) -> None:
    assert answer_to(control, path, {"verb": verb}) == {"ok": True}
    assert asked_for(control) == expected


def test_what_was_asked_for_stays_while_more_is_asked_for(control: ControlSocket, path: Path) -> None:
    for request in (start(), {"verb": "stop"}, {"verb": "release"}):
        answer_to(control, path, request)
    assert asked_for(control) == (LATER_NS, True, True)


@pytest.mark.fault("G2")
def test_another_cell_is_refused(control: ControlSocket, path: Path) -> None:
    answer = answer_to(control, path, start(fingerprint="cd" * 32))
    assert answer == {
        "ok": False, "found": "cell cdcdcdcdcdcd", "expected": "cell abababababab",
        "remedy": "give both the same file",
    }  # fmt: skip
    assert asked_for(control) == NOTHING


@pytest.mark.parametrize("instant_ns", [NOW_NS - 1, NOW_NS])
@pytest.mark.fault("C5")
def test_an_instant_that_is_not_ahead_is_refused(control: ControlSocket, path: Path, instant_ns: int) -> None:
    assert answer_to(control, path, start(start_utc_ns=instant_ns))["found"] == "a start that has passed"
    assert asked_for(control) == NOTHING


@pytest.mark.parametrize(
    "nonsense",
    [
        b"{}",
        b"start",
        b"\xff\xfe",
        b'{"verb": "move"}',
        b'{"verb": "start"}',
        b'{"verb": "start", "start_utc_ns": []}',
        b"[1]",
    ],
)
def test_nonsense_is_refused_and_changes_nothing(control: ControlSocket, path: Path, nonsense: bytes) -> None:
    answer = answer_to(control, path, nonsense)
    assert answer["ok"] is False
    assert answer["found"] == repr(nonsense)
    assert answer["expected"] == "one of start, stop, release"
    assert asked_for(control) == NOTHING


def test_a_refusal_repeats_the_beginning_of_long_nonsense(control: ControlSocket, path: Path) -> None:
    assert answer_to(control, path, b"x" * 1000)["found"] == repr(b"x" * 80)


@pytest.mark.parametrize(("size", "accepted"), [(2048, True), (2049, False)])
def test_a_request_of_more_than_two_kilobytes_is_not_read_whole(
    control: ControlSocket, path: Path, size: int, accepted: bool
) -> None:
    answer = answer_to(control, path, json.dumps({"verb": "stop"}).encode().rjust(size))
    assert (answer["ok"], control.requests.stopped) == (accepted, accepted)


# --- from whom -------------------------------------------------------------------------------------------------------


@dataclass
class Client:
    """A connected client as the kernel shows it."""

    data: bytes | OSError = b'{"verb": "stop"}'
    pid: int = 0
    uid: int = 0
    gid: int = 0
    sent: list[dict[str, Any]] = field(default_factory=list)
    reads: int = 0
    closed: bool = False

    def recv(self, _: int) -> bytes:
        self.reads += 1
        if isinstance(self.data, OSError):
            raise self.data
        return self.data

    def getsockopt(self, level: int, option: int, size: int) -> bytes:
        assert (level, option, size) == (socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        return struct.pack("3i", self.pid, self.uid, self.gid)

    def send(self, data: bytes) -> None:
        self.sent.append(json.loads(data))

    def close(self) -> None:
        self.closed = True


AGENT = 4242


@pytest.mark.parametrize("verb", ["stop", "release"])
@pytest.mark.parametrize("uid", [1, AGENT - 1, AGENT + 1, 65534])
def test_another_user_is_refused_and_changes_nothing(
    control: ControlSocket, monkeypatch: pytest.MonkeyPatch, uid: int, verb: str
) -> None:
    monkeypatch.setattr(os, "getuid", lambda: AGENT)
    stranger = Client(json.dumps({"verb": verb}).encode(), pid=AGENT, uid=uid, gid=AGENT)
    control._clients.append(stranger)  # type: ignore[arg-type]
    control.poll()
    (answer,) = stranger.sent
    assert (answer["ok"], answer["found"], answer["expected"]) == (False, f"user {uid}", f"user {AGENT} or root")
    assert asked_for(control) == NOTHING


@pytest.mark.parametrize("uid", [0, AGENT])
def test_the_agents_user_and_root_are_heard(control: ControlSocket, monkeypatch: pytest.MonkeyPatch, uid: int) -> None:
    monkeypatch.setattr(os, "getuid", lambda: AGENT)
    own = Client(pid=7, uid=uid, gid=8)
    control._clients.append(own)  # type: ignore[arg-type]
    control.poll()
    assert own.sent == [{"ok": True}]
    assert control.requests.stopped


STRANGER = """
import os, socket, sys
with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as own:
    os.chdir(os.path.dirname(sys.argv[1]))  # further up nobody else may enter
    os.setresgid(65534, 65534, 65534)
    os.setresuid(65534, 65534, 65534)
    own.connect(os.path.basename(sys.argv[1]))
    own.send(b'{"verb": "release"}')
    print("sent", flush=True)
    print(own.recv(4096).decode())
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_a_process_of_another_user_is_refused_even_when_it_gets_at_the_socket(
    control: ControlSocket, path: Path
) -> None:
    for place in (path, path.parent):
        place.chmod(0o777)
    command = [sys.executable, "-c", STRANGER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as stranger:
        assert stranger.stdout is not None
        assert stranger.stdout.readline() == "sent\n"
        control.poll()
        assert json.loads(stranger.stdout.readline())["found"] == "user 65534"
    assert asked_for(control) == NOTHING


# --- one client after the other --------------------------------------------------------------------------------------


def test_a_client_is_served_once_and_closed(control: ControlSocket) -> None:
    client = Client(uid=os.getuid())
    control._clients.append(client)  # type: ignore[arg-type]
    for _ in range(3):
        control.poll()
    assert (client.reads, len(client.sent), client.closed) == (1, 1, True)


def test_a_client_that_says_nothing_yet_is_waited_for_and_holds_up_nobody(control: ControlSocket, path: Path) -> None:
    with person(path) as slow:
        control.poll()
        assert answer_to(control, path, {"verb": "release"}) == {"ok": True}
        assert asked_for(control) == (None, False, True)
        slow.send(b'{"verb": "stop"}')
        control.poll()
        assert json.loads(slow.recv(4096)) == {"ok": True}
    assert asked_for(control) == (None, True, True)


def test_a_client_that_is_gone_or_broken_is_let_go(control: ControlSocket, path: Path) -> None:
    with person(path):
        control.poll()
    broken = Client(ConnectionResetError())
    control._clients.append(broken)  # type: ignore[arg-type]
    control.poll()
    assert (broken.sent, broken.closed) == ([], True)
    assert answer_to(control, path, {"verb": "stop"}) == {"ok": True}


def test_of_many_silent_clients_the_last_eight_are_kept(control: ControlSocket) -> None:
    silent = [Client(BlockingIOError()) for _ in range(10)]
    control._clients += silent  # type: ignore[arg-type]
    control.poll()
    assert [client.reads for client in silent] == [0] * 2 + [1] * 8


def test_all_who_wait_are_heard_in_one_poll(control: ControlSocket, path: Path) -> None:
    with person(path) as one, person(path) as other:
        one.send(b'{"verb": "stop"}')
        other.send(b'{"verb": "release"}')
        control.poll()
        assert one.recv(100) == other.recv(100) == b'{"ok": true}'


# --- the socket itself -----------------------------------------------------------------------------------------------


def test_the_socket_is_its_owners_alone_and_its_folder_is_made(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "left"
    with closing(ControlSocket(path, FINGERPRINT)):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_ISSOCK(path.stat().st_mode)


def test_a_socket_that_nobody_serves_is_replaced(path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left_behind:
        left_behind.bind(str(path))
    with closing(ControlSocket(path, FINGERPRINT)) as control:
        assert answer_to(control, path, {"verb": "stop"}) == {"ok": True}


def test_somebodys_own_file_is_refused_and_left_alone(path: Path) -> None:
    path.write_text("mine")
    with pytest.raises(ControlError, match="expected a free name"):
        ControlSocket(path, FINGERPRINT)
    assert path.read_text() == "mine"


def test_a_place_that_cannot_be_made_is_refused_and_nothing_stays_open(tmp_path: Path) -> None:
    def descriptors() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    (tmp_path / "file").write_text("")
    before = descriptors()
    with pytest.raises(ControlError, match=r"control socket .*: found .*, expected .* folder that can be written") as e:
        ControlSocket(tmp_path / "file" / "left.control", FINGERPRINT)
    assert descriptors() == before
    assert (e.value.exit_code, ControlError.exit_code) == (7, 7)


def test_closing_twice_is_fine_and_lets_clients_go(path: Path) -> None:
    control = ControlSocket(path, FINGERPRINT)
    with person(path) as own:
        control.poll()
        control.close()
        control.close()
        assert own.recv(10) == b""


# --- asking ----------------------------------------------------------------------------------------------------------


@contextmanager
def replies(path: Path, reply: bytes | None) -> Iterator[None]:
    """Somebody who answers every request with these bytes, or not at all."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(path))
        listening.listen()

        def serve() -> None:
            client, _ = listening.accept()
            with client:
                client.recv(4096)
                if reply is not None:
                    client.send(reply)
                client.recv(4096)  # until it is gone

        thread = threading.Thread(target=serve)
        thread.start()
        yield
        thread.join()


def test_asking_sends_the_verb_and_what_belongs_to_it(path: Path) -> None:
    with closing(ControlSocket(path, FINGERPRINT)) as control:
        asking = threading.Thread(
            target=ask, args=(path, Verb.START), kwargs={"start_utc_ns": 10**19, "fingerprint": FINGERPRINT}
        )
        asking.start()
        while asking.is_alive():
            control.poll()
    assert asked_for(control) == (10**19, False, False)


def test_a_refusal_is_raised_with_what_the_agent_says(path: Path) -> None:
    answer = {"ok": False, "found": "a", "expected": "b", "remedy": "c"}
    with (
        replies(path, json.dumps(answer).encode()),
        pytest.raises(ControlError, match=r"left\.control refuses to release: found a, expected b; c"),
    ):
        ask(path, Verb.RELEASE)


def test_no_agent_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(ControlError, match="found No such file or directory, expected an agent that answers"):
        ask(tmp_path / "none.control", Verb.STOP)


def test_an_answer_that_does_not_say_yes_is_no(path: Path) -> None:
    answer = {"found": "a", "expected": "b", "remedy": "c"}
    with replies(path, json.dumps(answer).encode()), pytest.raises(ControlError, match="refuses to stop"):
        ask(path, Verb.STOP)


@pytest.mark.parametrize("reply", [None, b"hello"], ids=["silence", "nonsense"])
def test_an_agent_that_does_not_answer_is_given_up(
    path: Path, monkeypatch: pytest.MonkeyPatch, reply: bytes | None
) -> None:
    monkeypatch.setattr(control_socket, "REPLY_TIMEOUT_S", 0.05)
    with replies(path, reply), pytest.raises(ControlError, match="found no answer, expected an agent that answers"):
        ask(path, Verb.STOP)
