"""The operator's socket: what is accepted, from whom, and what is refused with a reason; polled as a loop would."""

from __future__ import annotations

import fcntl
import json
import os
import select
import socket
import stat
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from agent.host import unix_socket
from agent.modes import Event, Mode
from agent.operator import socket as control_socket
from agent.operator.ask import Silence, ask_sockets
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.socket import ControlSocket, Standing
from agent.operator.table import Verb
from agent.process.session import LEADS_BACK

FINGERPRINT = "ab" * 32
NOW_NS = 1_000_000_000_000
HERE_NS = 400_000_000_000  # CLOCK_MONOTONIC
OFFSET_NS = NOW_NS - HERE_NS
LATER_NS = NOW_NS + 1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "left.control"


@pytest.fixture
def control(path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ControlSocket]:
    """A control socket in a world whose time stands still."""
    monkeypatch.setattr(control_socket.time, "monotonic_ns", lambda: HERE_NS)
    monkeypatch.setattr(control_socket, "utc_offset_ns", lambda: OFFSET_NS)
    with closing(listening(path)) as made:
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


def given(control: ControlSocket, path: Path, request: dict[str, Any]) -> dict[str, Any]:
    """What an instant gets that the arm has been asked about, as an operator does."""
    shown = {"token": "mine", "asked_ns": HERE_NS} | request
    answer_to(control, path, shown | {"prepare": True})
    return answer_to(control, path, shown)


def listening(path: Path, mode: Mode = Mode.READY) -> ControlSocket:
    """An agent's socket in a mode."""
    return ControlSocket(path, FINGERPRINT, Standing("left", mode, "because", details=lambda: {"pid": 7}))


def asked_for(control: ControlSocket) -> tuple[int | None, list[Verb]]:
    """The start that counts, and the words that nobody has taken yet."""
    start = control.requests.start
    return start and start.start_utc_ns, control.requests.words


NOTHING: tuple[int | None, list[Verb]] = (None, [])
ACCEPTED = {
    "ok": True, "arm": "left", "mode": "READY", "reason": "because", "fingerprint": FINGERPRINT, "details": {"pid": 7},
}  # fmt: skip


def start(**changes: Any) -> dict[str, Any]:
    return {"verb": "start", "start_utc_ns": LATER_NS, "fingerprint": FINGERPRINT} | changes


# --- what is asked for -----------------------------------------------------------------------------------------------


def test_start_is_taken_over(control: ControlSocket, path: Path) -> None:
    assert given(control, path, start(clock_bound_s=2e-4)) == ACCEPTED
    assert asked_for(control) == (LATER_NS, [])
    assert control.requests.start is not None
    assert control.requests.start.clock_bound_s == 2e-4


def test_a_start_that_is_only_prepared_changes_nothing(control: ControlSocket, path: Path) -> None:
    assert answer_to(control, path, start(prepare=True, token="mine", asked_ns=HERE_NS)) == ACCEPTED
    assert asked_for(control) == NOTHING


def test_a_second_start_replaces_the_first_and_a_cancel_takes_it_back(control: ControlSocket, path: Path) -> None:
    given(control, path, start())
    given(control, path, start(start_utc_ns=LATER_NS + 5))
    assert asked_for(control) == (LATER_NS + 5, [])
    assert answer_to(control, path, {"verb": "cancel"}) == ACCEPTED
    assert asked_for(control) == NOTHING


def test_a_cancel_that_comes_after_the_instant_is_a_stop(control: ControlSocket, path: Path) -> None:
    control.standing.mode = Mode.TRACK
    assert answer_to(control, path, {"verb": "cancel"})["ok"] is True
    assert control.requests.take() == [Verb.STOP]
    assert control.requests.take() == []


def test_an_agent_that_starts_nothing_says_why(control: ControlSocket, path: Path) -> None:
    control.standing.no_start = {"found": "SCHED_OTHER", "expected": "SCHED_FIFO", "remedy": "give --priority"}
    answer = answer_to(control, path, start(prepare=True))
    assert (answer["ok"], answer["found"], answer["remedy"]) == (False, "SCHED_OTHER", "give --priority")
    assert answer_to(control, path, {"verb": "stop"})["ok"] is True


@pytest.mark.fault("G6")
def test_a_start_waits_until_the_torque_at_rest_has_been_looked_at(control: ControlSocket, path: Path) -> None:
    control.standing.enter(Mode.HOLD)
    assert (control.standing.mode, control.standing.ready_ns) == (Mode.HOLD, 0)
    control.standing.rest_s = 1.1
    control.standing.enter(Mode.READY)
    assert control.standing.ready_ns == HERE_NS
    control.standing.ready_ns = LATER_NS - OFFSET_NS - 1_050_000_000
    answer = answer_to(control, path, start(prepare=True))
    assert (answer["ok"], answer["found"]) == (False, "a start 1.1 s after READY")
    assert answer["expected"] == "1.1 s, in which the torque at rest is seen"
    control.standing.ready_ns -= 50_000_000
    assert given(control, path, start())["ok"] is True


@pytest.mark.parametrize("minutes", [-10, 10])
def test_a_clock_that_was_set_since_ready_is_no_rest_and_takes_none_away(
    control: ControlSocket, path: Path, monkeypatch: pytest.MonkeyPatch, minutes: int
) -> None:
    """The wall clock of a small computer is often set once chrony has found its servers."""
    control.standing.rest_s = 20.0
    control.standing.enter(Mode.READY)
    set_ns = minutes * 60 * 10**9
    monkeypatch.setattr(control_socket, "utc_offset_ns", lambda: OFFSET_NS + set_ns)
    soon = {**start(), "start_utc_ns": NOW_NS + set_ns + 15 * 10**9}
    assert answer_to(control, path, soon)["expected"] == "20 s, in which the torque at rest is seen"
    control.standing.ready_ns -= 10 * 10**9
    assert given(control, path, soon)["ok"] is True


@pytest.mark.parametrize("verb", ["stop", "release"])
def test_each_word_asks_for_itself_alone(control: ControlSocket, path: Path, verb: str) -> None:
    control.standing.mode = Mode.HOLD
    assert answer_to(control, path, {"verb": verb}) == ACCEPTED | {"mode": "HOLD"}
    assert asked_for(control) == (None, [Verb(verb)])


def test_asking_how_things_are_asks_for_nothing(control: ControlSocket, path: Path) -> None:
    assert answer_to(control, path, {"verb": "status"}) == ACCEPTED
    assert asked_for(control) == NOTHING


def test_a_word_out_of_order_is_refused_with_the_mode(control: ControlSocket, path: Path) -> None:
    answer = answer_to(control, path, {"verb": "release"})
    assert (answer["ok"], answer["found"]) == (False, "arm left in READY: it waits for the start with torque on")
    assert answer["remedy"] == "stop it first, support the object, then release it"
    assert asked_for(control) == NOTHING


@pytest.mark.fault("G2")
def test_another_cell_is_refused(control: ControlSocket, path: Path) -> None:
    answer = answer_to(control, path, start(fingerprint="cd" * 32))
    assert answer == ACCEPTED | {
        "ok": False, "found": "cell cdcdcdcdcdcd", "expected": "cell abababababab",
        "remedy": "give the file that its agent was started with; stop and release need none",
    }  # fmt: skip
    assert asked_for(control) == NOTHING


@pytest.mark.parametrize("instant_ns", [NOW_NS - 1, NOW_NS])
@pytest.mark.fault("C5")
def test_an_instant_that_is_not_ahead_is_refused(control: ControlSocket, path: Path, instant_ns: int) -> None:
    assert answer_to(control, path, start(start_utc_ns=instant_ns))["found"] == "a start that has passed"
    assert asked_for(control) == NOTHING


def test_the_last_instant_that_can_be_counted_is_one(control: ControlSocket, path: Path) -> None:
    assert given(control, path, start(start_utc_ns=2**63 - 1))["ok"] is True


@pytest.mark.parametrize(
    "nonsense",
    [
        b"{}",
        b"start",
        b"\xff\xfe",
        b'{"verb": "move"}',
        b'{"verb": "start"}',
        b'{"verb": "start", "start_utc_ns": []}',
        b'{"verb": "start", "start_utc_ns": 1e999}',
        b'{"verb": "start", "start_utc_ns": 9223372036854775808, "fingerprint": "%s"}' % FINGERPRINT.encode(),
        b'{"verb": "start", "start_utc_ns": -1}',
        b'{"verb": "lower", "start_utc_ns": 9223372036854775808}',
        b'{"verb": "start", "start_utc_ns": 1, "clock_bound_s": []}',
        b"[1]",
    ],
)
def test_nonsense_is_refused_and_changes_nothing(control: ControlSocket, path: Path, nonsense: bytes) -> None:
    answer = answer_to(control, path, nonsense)
    assert answer["ok"] is False
    assert answer["found"] == repr(nonsense[:80])
    assert answer["expected"] == f"one of {', '.join(Verb)}"
    assert asked_for(control) == NOTHING


def test_a_refusal_repeats_the_beginning_of_long_nonsense(control: ControlSocket, path: Path) -> None:
    assert answer_to(control, path, b"x" * 1000)["found"] == repr(b"x" * 80)


@pytest.mark.parametrize(("size", "accepted"), [(4096, True), (4097, False)])
def test_a_request_of_more_than_four_kilobytes_is_not_read_whole(
    control: ControlSocket, path: Path, size: int, accepted: bool
) -> None:
    answer = answer_to(control, path, json.dumps({"verb": "stop"}).encode().rjust(size))
    assert (answer["ok"], bool(control.requests.words)) == (accepted, accepted)


# --- in a session ----------------------------------------------------------------------------------------------------


@pytest.fixture
def asked(control: ControlSocket) -> list[Event]:
    """What the agent's session is asked about; it bears nothing but a stop and an approach."""
    heard: list[Event] = []

    def why_not(event: Event) -> str:
        heard.append(event)
        return "" if event in Event.STOP | Event.APPROACH | Event.LOWER | Event.PARK else "the load is being taken up"

    control.standing.session = why_not
    return heard


def test_a_word_of_a_session_counts_in_the_modes_of_its_table(
    control: ControlSocket, path: Path, asked: list[Event]
) -> None:
    control.standing.mode = Mode.REST
    assert answer_to(control, path, {"verb": "approach", "fingerprint": FINGERPRINT})["ok"] is True
    assert (asked, control.requests.take()) == ([Event.APPROACH], [Verb.APPROACH])
    assert answer_to(control, path, {"verb": "grasp", "fingerprint": FINGERPRINT})["expected"] == "another mode"
    assert answer_to(control, path, {"verb": "status"})["ok"] is True
    assert (asked, asked_for(control)) == ([Event.APPROACH], NOTHING)


def test_an_arm_that_its_guard_leads_back_names_what_works_and_not_to_say_it_again(
    control: ControlSocket, path: Path
) -> None:
    control.standing.mode, control.standing.no_start = Mode.REST, LEADS_BACK
    control.standing.session = lambda _: "the guard holds the arm in its agent's place and leads it back alone"
    answer = answer_to(control, path, {"verb": "approach", "fingerprint": FINGERPRINT})
    assert answer["remedy"] == "lead it back, `coop release` it, then start its guard and its agent anew"


def test_an_arm_that_would_refuse_the_start_refuses_to_go_to_its_grasp(control: ControlSocket, path: Path) -> None:
    control.standing.session = lambda _: ""
    control.standing.no_start = {"found": "SCHED_OTHER", "expected": "SCHED_FIFO", "remedy": "give --priority"}
    for mode, verb, taken in (
        (Mode.REST, "approach", False), (Mode.HALT, "approach", False), (Mode.HALT, "park", True),
        (Mode.APPROACH, "park", True), (Mode.HOLD, "lower", True), (Mode.REST, "release", True),
    ):  # fmt: skip
        control.standing.mode = mode
        answer = answer_to(control, path, {"verb": verb, "fingerprint": FINGERPRINT})
        assert (answer["ok"], answer.get("found")) == (taken, None if taken else "SCHED_OTHER")


@pytest.mark.parametrize(("request_", "event"), [(start(), Event.STARTED), ({"verb": "release"}, Event.RELEASED)])
def test_a_word_before_its_time_is_refused_with_the_reason_of_the_session(
    control: ControlSocket, path: Path, asked: list[Event], request_: dict[str, Any], event: Event
) -> None:
    answer = answer_to(control, path, request_)
    assert (answer["ok"], answer["expected"], answer["remedy"]) == (False, "one that is done", "say it again")
    assert answer["found"] == "arm left in READY: the load is being taken up"
    assert (asked, asked_for(control)) == ([event], NOTHING)


def test_a_lowering_at_an_instant_is_kept_until_it_is_taken_back(
    control: ControlSocket, path: Path, asked: list[Event]
) -> None:
    control.standing.mode = Mode.HOLD
    assert given(control, path, {"verb": "lower", "fingerprint": FINGERPRINT, "start_utc_ns": LATER_NS})["ok"] is True
    assert control.requests.lower == Request(Verb.LOWER, FINGERPRINT, LATER_NS, token="mine", asked_ns=HERE_NS)
    assert answer_to(control, path, {"verb": "cancel"})["ok"] is True
    assert (control.requests.lower, control.requests.words) == (None, [])
    answer_to(control, path, {"verb": "lower", "fingerprint": FINGERPRINT})
    assert (control.requests.lower, control.requests.take()) == (None, [Verb.LOWER])
    control.standing.mode = Mode.HALT
    answer_to(control, path, {"verb": "park", "fingerprint": FINGERPRINT, "start_utc_ns": LATER_NS})
    assert (control.requests.lower, control.requests.take()) == (None, [Verb.PARK])
    assert asked == [Event.LOWER, Event.LOWER, Event.LOWER, Event.PARK], "an instant twice: before it is given, too"


@pytest.mark.parametrize(("word", "kept"), [("stop", False), ("release", False), ("status", True), ("cancel", False)])
def test_an_arm_that_is_told_to_stop_is_not_lowered_at_an_instant_that_was_given_before(
    control: ControlSocket, path: Path, word: str, kept: bool
) -> None:
    control.standing.mode, control.standing.session = Mode.HOLD, lambda _: ""
    given(control, path, {"verb": "lower", "fingerprint": FINGERPRINT, "start_utc_ns": LATER_NS})
    answer_to(control, path, {"verb": word, "prepare": True})
    assert control.requests.lower is not None, "what is only asked changes nothing"
    assert answer_to(control, path, {"verb": word})["ok"] is True
    assert (control.requests.lower is not None) is kept
    given(control, path, {"verb": "lower", "fingerprint": FINGERPRINT, "start_utc_ns": LATER_NS})
    assert control.requests.lower is not None, "but at one that is given afterwards"


def test_a_cancel_that_comes_when_the_arm_is_on_its_way_down_is_a_stop(
    control: ControlSocket, path: Path, asked: list[Event]
) -> None:
    control.standing.mode = Mode.LOWER
    assert answer_to(control, path, {"verb": "cancel"})["ok"] is True
    assert (asked, control.requests.words) == ([], [Verb.STOP])


@pytest.mark.fault("P11")
@pytest.mark.parametrize("gone", [True, False])
@pytest.mark.parametrize(("verb", "late"), [("release", False), ("lower", False), ("stop", True), ("cancel", True)])
def test_of_those_who_gave_up_waiting_only_a_stop_is_obeyed(
    control: ControlSocket, path: Path, verb: str, late: bool, gone: bool
) -> None:
    """They were told that this arm does not answer, as one that stood still when they asked."""
    control.standing.mode, control.standing.session = Mode.LOWER if verb == "cancel" else Mode.HOLD, lambda _: ""
    with person(path) as own:
        own.send(json.dumps({"verb": verb, "fingerprint": FINGERPRINT}).encode())
        if gone:
            own.close()
        control.poll()
    assert control.requests.take() == ([Verb.STOP if verb == "cancel" else Verb(verb)] if late or not gone else [])


@pytest.mark.parametrize(
    ("mode", "verb", "taken"),
    [
        (Mode.REST, "approach", False), (Mode.APPROACH, "grasp", False), (Mode.HOLD, "lower", False),
        (Mode.RELEASE, "park", False), (Mode.HOLD, "release", True), (Mode.TRACK, "stop", True),
        (Mode.REST, "status", True), (Mode.TRACK, "cancel", True),
    ],
)  # fmt: skip
@pytest.mark.parametrize("other", ["", "cd" * 32])
def test_what_moves_an_arm_is_of_its_own_cell_file_and_what_stops_it_of_any(
    control: ControlSocket, path: Path, mode: Mode, verb: str, taken: bool, other: str
) -> None:
    control.standing.mode, control.standing.session = mode, lambda _: ""
    answer = answer_to(control, path, {"verb": verb, "fingerprint": other})
    assert answer["ok"] is taken
    assert taken or answer["found"] == f"cell {other[:12]}"
    assert bool(control.requests.words) is (taken and verb != "status")


def test_an_agent_that_has_said_nothing_yet_is_off_and_looks_at_no_torque() -> None:
    own = Standing("left")
    assert (own.mode, own.rest_s) == (Mode.OFF, 0.0)


@pytest.mark.fault("P7")
@pytest.mark.parametrize(
    ("mode", "verb", "taken"),
    [
        (Mode.REST, "approach", False), (Mode.HALT, "approach", False), (Mode.APPROACH, "grasp", False),
        (Mode.READY, "start", False), (Mode.HALT, "park", True), (Mode.HOLD, "lower", True),
        (Mode.HOLD, "release", True), (Mode.TRACK, "stop", True), (Mode.REST, "status", True),
    ],
)  # fmt: skip
def test_an_arm_that_nobody_goes_on_for_goes_back_and_not_forward(
    control: ControlSocket, path: Path, asked: list[Event], mode: Mode, verb: str, taken: bool
) -> None:
    control.standing.mode, control.standing.session = mode, lambda _: ""
    request = (
        start(token="mine", asked_ns=HERE_NS, prepare=True)
        if verb == "start"
        else {"verb": verb, "fingerprint": FINGERPRINT}
    )
    control.standing.alone = lambda: "the guard hangs"
    answer = answer_to(control, path, request)
    assert answer["ok"] is taken
    if not taken:
        assert (answer["found"], answer["expected"]) == (
            f"arm left in {mode.name}: the guard hangs",
            "a guard that watches it",
        )
        control.standing.alone = str
        assert answer_to(control, path, request)["ok"]


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

    def recv(self, _: int, flags: int = 0) -> bytes:
        if flags:
            raise BlockingIOError  # it waits
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


def test_a_cycle_waits_for_nobody(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waited_ms: list[float] = []
    asked = select.poll()

    class Asked:
        register = asked.register

        def poll(self, timeout_ms: float) -> list[tuple[int, int]]:
            waited_ms.append(timeout_ms)
            return asked.poll(timeout_ms)

    monkeypatch.setattr(control_socket.select, "poll", Asked)
    with closing(listening(path)) as control:
        control.poll()
    assert waited_ms == [0]


@pytest.mark.parametrize("uid", [0, AGENT])
def test_the_agents_user_and_root_are_heard(control: ControlSocket, monkeypatch: pytest.MonkeyPatch, uid: int) -> None:
    monkeypatch.setattr(os, "getuid", lambda: AGENT)
    own = Client(pid=7, uid=uid, gid=8)
    control._clients.append(own)  # type: ignore[arg-type]
    control.poll()
    assert own.sent == [ACCEPTED]
    assert control.requests.words == [Verb.STOP]


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
        assert answer_to(control, path, {"verb": "status"}) == ACCEPTED
        slow.send(b'{"verb": "stop"}')
        control.poll()
        assert json.loads(slow.recv(4096)) == ACCEPTED
    assert asked_for(control) == (None, [Verb.STOP])


def test_a_client_that_is_gone_or_broken_is_let_go(control: ControlSocket, path: Path) -> None:
    with person(path):
        control.poll()
    broken = Client(ConnectionResetError())
    control._clients.append(broken)  # type: ignore[arg-type]
    control.poll()
    assert (broken.sent, broken.closed) == ([], True)
    assert answer_to(control, path, {"verb": "stop"}) == ACCEPTED


def test_of_many_silent_clients_the_last_eight_are_kept(control: ControlSocket) -> None:
    silent = [Client(BlockingIOError()) for _ in range(10)]
    control._clients += silent  # type: ignore[arg-type]
    control.poll()
    assert [client.closed for client in silent] == [True] * 2 + [False] * 8


def test_who_has_said_something_is_heard_however_many_are_silent(control: ControlSocket) -> None:
    first = Client(uid=os.getuid())
    control._clients += [first, *(Client(BlockingIOError()) for _ in range(10))]  # type: ignore[list-item]
    control.poll()
    assert control.requests.words == [Verb.STOP]


def test_all_who_wait_are_heard_in_one_poll(control: ControlSocket, path: Path) -> None:
    with person(path) as one, person(path) as other:
        one.send(b'{"verb": "stop"}')
        other.send(b'{"verb": "status"}')
        control.poll()
        assert json.loads(one.recv(4096)) == json.loads(other.recv(4096)) == ACCEPTED


# --- the socket itself -----------------------------------------------------------------------------------------------


def test_the_socket_is_its_owners_alone_and_its_folder_is_made(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "left"
    with closing(listening(path)):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_ISSOCK(path.stat().st_mode)


def test_a_socket_that_nobody_serves_is_replaced(path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left_behind:
        left_behind.bind(str(path))
    with closing(listening(path)) as control:
        assert answer_to(control, path, {"verb": "stop"}) == ACCEPTED


@pytest.mark.parametrize("clients", [0, 9], ids=["idle", "full queue"])
@pytest.mark.fault("P13")
def test_a_socket_that_somebody_serves_is_left_alone(control: ControlSocket, path: Path, clients: int) -> None:
    """P13: a second agent that fails must not harm the first."""
    with ExitStack() as stack:
        for _ in range(clients):
            stack.enter_context(person(path))
        with pytest.raises(ControlError, match="found an agent that listens there, expected none"):
            listening(path)
        control.poll()
    assert answer_to(control, path, {"verb": "stop"}) == ACCEPTED


def test_two_agents_that_begin_at_once_take_a_folder_one_after_the_other(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []

    def another_tries(_: Path) -> bool:
        other = os.open(path.parent, os.O_RDONLY)
        try:
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            tried.append("waits")
        finally:
            os.close(other)
        return True

    monkeypatch.setattr(unix_socket, "_remove_unserved", another_tries)
    with closing(listening(path)):
        assert tried == ["waits"]


def test_a_folder_that_a_reader_keeps_locked_is_waited_for_not_for_ever_and_who_has_it_is_named(path: Path) -> None:
    reader = os.open(path.parent, os.O_RDONLY)
    try:
        fcntl.flock(reader, fcntl.LOCK_SH)
        with pytest.raises(
            ControlError, match=rf"found for 0.05 s a lock of process {os.getpid()} \(.+\) on its folder"
        ):
            ControlSocket(path, FINGERPRINT, Standing("left"), wait_s=0.05)
    finally:
        os.close(reader)
    with closing(listening(path)):
        assert path.is_socket()


def test_a_folder_that_becomes_free_while_an_agent_waits_is_taken(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reader = os.open(path.parent, os.O_RDONLY)
    slept: list[float] = []
    fcntl.flock(reader, fcntl.LOCK_SH)
    monkeypatch.setattr(unix_socket.time, "sleep", lambda s: (slept.append(s), os.close(reader)))
    with closing(listening(path)):
        assert path.is_socket()
    assert slept == [unix_socket._LOOK_S]  # looked at again soon, and not at the end of the wait


def test_closing_leaves_a_socket_that_has_taken_the_name(path: Path) -> None:
    first = listening(path)
    path.unlink()
    with closing(listening(path)) as second:
        first.close()
        assert answer_to(second, path, {"verb": "stop"}) == ACCEPTED


def test_somebodys_own_file_is_refused_and_left_alone(path: Path) -> None:
    path.write_text("mine")
    with pytest.raises(ControlError, match="found Address already in use, expected a free name"):
        listening(path)
    with pytest.raises(ControlError, match="found AF_UNIX path too long, expected a free name"):
        listening(path.parent / ("x" * 150))
    assert path.read_text() == "mine"


def test_a_place_that_cannot_be_made_is_refused_and_nothing_stays_open(tmp_path: Path) -> None:
    def descriptors() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    (tmp_path / "file").write_text("")
    before = descriptors()
    with pytest.raises(ControlError, match=r"control socket .*: found .*, expected .* folder that can be written") as e:
        listening(tmp_path / "file" / "left.control")
    assert descriptors() == before
    assert (e.value.exit_code, ControlError.exit_code) == (2, 7)


def test_closing_twice_is_fine_and_lets_clients_go(path: Path) -> None:
    control = listening(path)
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


def one_answer(path: Path, request: Request, timeout_s: float = 5.0) -> Reply | Silence:
    return ask_sockets([path], request, timeout_s)[path]


def test_asking_sends_the_word_and_what_belongs_to_it(path: Path) -> None:
    heard: list[Reply | Silence] = []
    request = Request(
        Verb.START, FINGERPRINT, 9 * 10**18, clock_bound_s=1e-3, token="mine", asked_ns=time.monotonic_ns()
    )
    with closing(listening(path)) as control:
        control._answer(replace(request, prepare=True).encode(), os.getuid())
        asking = threading.Thread(target=lambda: heard.append(one_answer(path, request)))
        asking.start()
        while asking.is_alive():
            control.poll()
        assert control.requests.start == request
    assert heard == [Reply(True, "left", "READY", "because", FINGERPRINT, {}, {"pid": 7})]


def test_a_refusal_is_heard_with_what_the_agent_says(path: Path) -> None:
    refusal = {"found": "a", "expected": "b", "remedy": "c"}
    with replies(path, Reply(False, "left", "HOLD", refusal=refusal).encode()):
        heard = one_answer(path, Request(Verb.RELEASE))
    assert isinstance(heard, Reply)
    assert (heard.ok, heard.mode, heard.refusal) == (False, "HOLD", refusal)


def test_no_agent_is_silence_with_its_reason(tmp_path: Path) -> None:
    assert one_answer(tmp_path / "none", Request(Verb.STOP)) == Silence("No such file or directory", nowhere=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left_behind:
        left_behind.bind(str(tmp_path / "dead"))
    assert one_answer(tmp_path / "dead", Request(Verb.STOP)) == Silence("Connection refused")
    assert one_answer(tmp_path / ("x" * 200), Request(Verb.STOP)) == Silence("AF_UNIX path too long")


@pytest.mark.parametrize(
    ("reply", "found"),
    [
        (None, "no answer within 0.05 s"),
        (b"hello", "an answer that makes no sense"),
        (b"{}", "an answer that makes no sense"),
        (ACCEPTED | {"mode": "DANCE"}, "an answer that makes no sense"),
        (ACCEPTED | {"ok": "yes"}, "an answer that makes no sense"),
    ],
)
def test_an_agent_that_does_not_answer_is_given_up(path: Path, reply: Any, found: str) -> None:
    sent = json.dumps(reply).encode() if isinstance(reply, dict) else reply
    with replies(path, sent):
        assert one_answer(path, Request(Verb.STOP), 0.05 if reply is None else 5.0) == Silence(found, hung=True)


def test_a_full_queue_of_clients_is_tried_again_until_the_time_is_over(path: Path) -> None:
    with closing(listening(path)) as control, ExitStack() as stack:
        for _ in range(9):
            stack.enter_context(person(path))
        heard = one_answer(path, Request(Verb.STOP), 0.05)
        assert heard == Silence("no answer within 0.05 s", hung=True)
        asking: list[Reply | Silence] = []
        thread = threading.Thread(target=lambda: asking.append(one_answer(path, Request(Verb.STOP))))
        thread.start()
        while thread.is_alive():
            control.poll()
        assert isinstance(asking[0], Reply)
