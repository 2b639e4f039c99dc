"""The line between agent and guard: who is heard, what is refused, and which descriptors come through."""

from __future__ import annotations

import errno
import os
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from agent.guard import agent_end, guard_end
from agent.guard.agent_end import AgentEnd
from agent.guard.guard_end import BACKLOG, GuardEnd
from agent.guard.guarded import AGAIN_AFTER, CRASHED, Guarded
from agent.guard.line import GuardError, Said, Word
from agent.guard.pulse import pulse_vigil
from agent.telemetry.row.event import Level
from drivers.dynamixel.line.ports import open_error

CELL, OTHER = "ab" * 32, "cd" * 32
vigil = partial(pulse_vigil, 5_000_000, shared=False)


@pytest.fixture
def guard(tmp_path: Path) -> Iterator[GuardEnd]:
    with GuardEnd(tmp_path / "left.guard", CELL) as end:
        yield end
    assert not (tmp_path / "left.guard").exists()


def path(tmp_path: Path) -> Path:
    return tmp_path / "left.guard"


def heard(guard: GuardEnd) -> Said:
    while (said := guard.hear()) is None:
        pass
    return said


class Asking(threading.Thread):
    """An agent's question, which waits for its answer."""

    def __init__(self, agent: AgentEnd, word: Word, fds: tuple[int, ...] = ()) -> None:
        super().__init__(daemon=True)
        self.fds: tuple[int, ...] = ()
        self.error: GuardError | None = None
        self._agent = agent
        self._ask = lambda: agent.ask(word, fds)
        self.start()

    def run(self) -> None:
        try:
            self.fds = self._ask()
        except GuardError as error:
            self.error = error
        self._agent.close()


def test_words_and_descriptors_come_through_both_ways(guard: GuardEnd, tmp_path: Path) -> None:
    agent = AgentEnd(path(tmp_path), CELL)
    out, into = os.pipe()
    asking = Asking(agent, Word.PORT, (out,))
    said = heard(guard)
    assert (said.word, len(said.fds)) == (Word.PORT, 1)
    os.write(into, b"x")
    assert os.read(said.fds[0], 1) == b"x", "the same pipe"
    guard.answer((into,))
    asking.join()
    assert os.path.sameopenfile(asking.fds[0], into)
    assert not os.get_inheritable(asking.fds[0])
    for fd in (out, into, *said.fds, *asking.fds):
        os.close(fd)


def test_a_port_that_the_guard_cannot_open_is_told_as_the_guard_found_it(guard: GuardEnd, tmp_path: Path) -> None:
    """With its name and what mends it, which a refusal around it would hide; of another word it is the guard's."""
    lost = open_error("/dev/left", FileNotFoundError(errno.ENOENT, "No such file or directory"))
    refused = str(lost).replace("port /dev/left", f"the guard at {path(tmp_path)} refuses 'watch'")
    for word, said in ((Word.PORT, str(lost)), (Word.WATCH, refused)):
        asking = Asking(AgentEnd(path(tmp_path), CELL), word)
        assert heard(guard).word is word
        guard.refuse(lost)
        asking.join()
        assert asking.error is not None
        assert str(asking.error) == said
        guard.hang_up()


@pytest.mark.fault("P7")
def test_an_answer_that_comes_late_is_not_taken_for_that_to_a_later_word(guard: GuardEnd, tmp_path: Path) -> None:
    """An agent that has found a guard again, and then loses its port."""
    agent = AgentEnd(path(tmp_path), CELL)
    out, into = os.pipe()
    agent.say(Word.WATCH)
    asking = Asking(agent, Word.PORT)
    assert heard(guard).word is Word.WATCH
    guard.answer()
    assert heard(guard).word is Word.PORT
    guard.answer((out,))
    asking.join(timeout=10.0)
    assert (asking.error, len(asking.fds)) == (None, 1)
    assert [agent.heard()] == [{"ok": True, "to": "watch"}], "and it is not lost"
    for fd in (out, into, *asking.fds):
        os.close(fd)


def test_a_word_of_another_cell_is_refused_and_what_it_brought_is_closed(guard: GuardEnd, tmp_path: Path) -> None:
    out, into = os.pipe()
    asking = Asking(AgentEnd(path(tmp_path), OTHER), Word.WATCH, (into,))
    while asking.is_alive():
        assert guard.hear() is None
    os.close(into)
    assert os.read(out, 1) == b"", "nobody else has the other end"
    os.close(out)
    assert asking.error is not None
    assert "found cell cdcdcdcdcdcd, expected cell abababababab; give both the same file" in str(asking.error)


@pytest.mark.parametrize("nonsense", [b'{"word": "dance"}', b"\0" * 4096, b"[" * 60_000, b'{"word": {}}', b"1"])
def test_nonsense_is_refused(guard: GuardEnd, tmp_path: Path, nonsense: bytes) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger:
        stranger.connect(str(path(tmp_path)))
        stranger.send(nonsense)
        assert guard.hear() is None
        assert b"one of port, watch, busy, leave, take" in stranger.recv(1000)


def test_a_second_agent_is_refused_and_the_first_stays(guard: GuardEnd, tmp_path: Path) -> None:
    first = AgentEnd(path(tmp_path), CELL)
    assert guard.hear() is None
    second = Asking(AgentEnd(path(tmp_path), CELL), Word.PORT)
    while second.is_alive():
        assert guard.hear() is None
    assert second.error is not None
    assert second.error.found == "a second agent"
    first.say(Word.BUSY)
    assert heard(guard).word is Word.BUSY
    first.close()


@pytest.mark.parametrize(("uid", "heard_of"), [(0, True), (4710, True), (4711, False)])
def test_an_agent_of_another_user_is_refused(
    guard: GuardEnd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uid: int, heard_of: bool
) -> None:
    """As the kernel says who asks; of a guard of user 4710."""
    monkeypatch.setattr(guard_end, "peer_uid", lambda _: uid)
    monkeypatch.setattr(os, "getuid", lambda: 4710)
    agent = AgentEnd(path(tmp_path), CELL)
    guard.hear()
    assert (len(guard.filenos()) == 2) is heard_of
    if not heard_of:
        assert agent.heard() == {
            "ok": False, "found": "user 4711", "expected": "one agent, of user 4710", "remedy": "stop one",
        }  # fmt: skip
    agent.close()


def test_after_an_agent_that_has_hung_up_the_next_one_is_heard(guard: GuardEnd, tmp_path: Path) -> None:
    AgentEnd(path(tmp_path), CELL).close()
    assert guard.hear() is None
    assert len(guard.filenos()) == 1
    agent = AgentEnd(path(tmp_path), CELL)
    agent.say(Word.LEAVE)
    said = guard.hear()
    assert said is not None
    assert said.word is Word.LEAVE
    agent.close()


def test_of_those_who_are_refused_and_stay_only_some_are_kept(guard: GuardEnd, tmp_path: Path) -> None:
    agents = [AgentEnd(path(tmp_path), CELL)]
    for _ in range(guard_end.REFUSED_MAX + 3):
        guard.hear()
        agents.append(AgentEnd(path(tmp_path), CELL))
    guard.hear()
    assert len(guard._refused) == guard_end.REFUSED_MAX
    for agent in agents:
        agent.close()


def test_the_socket_is_its_users_own_and_a_second_guard_is_refused(guard: GuardEnd, tmp_path: Path) -> None:
    assert stat.S_IMODE(path(tmp_path).stat().st_mode) == 0o600
    with pytest.raises(GuardError, match="found another guard, expected one per arm"):
        GuardEnd(path(tmp_path), CELL)
    AgentEnd(path(tmp_path), CELL).close()


def test_the_socket_of_a_dead_guard_is_taken_over(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(path(tmp_path)))
    GuardEnd(path(tmp_path), CELL).close()


def test_the_socket_of_a_guard_that_hangs_is_left_alone(guard: GuardEnd, tmp_path: Path) -> None:
    """Its queue of agents is full, and nobody takes them in."""
    with ExitStack() as stack:
        for _ in range(BACKLOG + 1):
            stack.callback(AgentEnd(path(tmp_path), CELL).close)
        with pytest.raises(GuardError, match="found another guard, expected one per arm"):
            GuardEnd(path(tmp_path), CELL)


def test_a_guard_that_answers_nobody_may_hold_the_arm_and_who_asks_is_told_what_ends_that(
    guard: GuardEnd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While it holds it takes no agent in: one is left without an answer, and more find its queue full."""
    monkeypatch.setattr(agent_end, "REPLY_S", 0.01)
    with ExitStack() as stack:
        asking = AgentEnd(path(tmp_path), CELL)
        stack.callback(asking.close)
        told = r"expected a guard that waits for its agent; if it holds the arm .*`coop release`; else its log"
        with pytest.raises(GuardError, match=rf"found no answer to 'port' within 0.01 s, {told}"):
            asking.ask(Word.PORT)
        for _ in range(BACKLOG):
            stack.callback(AgentEnd(path(tmp_path), CELL).close)
        with pytest.raises(GuardError, match=f"found others who wait for its answer, {told}"):
            AgentEnd(path(tmp_path), CELL)


def test_a_guard_that_ends_before_it_answers_is_not_one_that_holds(tmp_path: Path) -> None:
    guard = GuardEnd(path(tmp_path), CELL)
    agent = AgentEnd(path(tmp_path), CELL)
    guard.close()
    told = "found that it went before it answered 'port', expected an answer; its log says why; start it again"
    with pytest.raises(GuardError, match=told):
        agent.ask(Word.PORT)
    agent.close()


def test_closing_leaves_the_socket_of_a_guard_that_has_taken_the_name(tmp_path: Path) -> None:
    first = GuardEnd(path(tmp_path), CELL)
    path(tmp_path).unlink()
    with GuardEnd(path(tmp_path), CELL):
        first.close()
        AgentEnd(path(tmp_path), CELL).close()


def test_a_path_that_no_socket_can_have_is_told_by_both_ends(tmp_path: Path) -> None:
    long = tmp_path / ("x" * 150)
    with pytest.raises(
        GuardError, match=r"found AF_UNIX path too long, expected a free name.* name another with --socket"
    ):
        GuardEnd(long, CELL)
    with pytest.raises(GuardError, match="found AF_UNIX path too long, expected the guard of this arm"):
        AgentEnd(long, CELL)


def test_an_agent_without_its_guard_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GuardError, match="start it first"):
        Guarded(path(tmp_path), CELL)


def watched(folder: Path, told: list[tuple[Level, str]]) -> tuple[GuardEnd, Guarded, Said]:
    """A guard, the agent that it watches, and what that asked of it."""
    guard = GuardEnd(path(folder), CELL)
    agent = Guarded(path(folder), CELL)
    watching = threading.Thread(target=lambda: agent.watch((0,), lambda *event: told.append(event), vigil, ring="r"))
    watching.start()
    said = heard(guard)
    guard.answer()
    watching.join()
    return guard, agent, said


@pytest.mark.fault("P7")
def test_a_guard_that_is_gone_is_noticed_once_and_a_new_one_is_asked_to_watch(tmp_path: Path) -> None:
    told: list[tuple[Level, str]] = []
    first, agent, said = watched(tmp_path, told)
    assert agent.there
    assert not agent.poll()
    said.drop()
    first.close()
    assert [agent.poll() for _ in range(3)] == ["the guard is gone", "", ""]
    assert not agent.there
    second = GuardEnd(path(tmp_path), CELL)
    for _ in range(AGAIN_AFTER):
        assert not agent.poll()
    said = heard(second)
    assert (said.word, said.content["ring"], len(said.fds)) == (Word.WATCH, "r", 3)
    assert not agent.there, "it has not said yes yet"
    second.answer()
    assert not agent.poll()
    assert agent.there
    assert [level for level, _ in told] == [Level.ERROR, Level.INFO]
    assert "the guard is gone: nobody takes over" in told[0][1]
    said.drop()
    second.close()
    agent.leave()
    agent.leave()


def test_a_guard_of_another_cell_in_the_place_of_one_that_is_gone_is_told_of_and_not_counted_on(tmp_path: Path) -> None:
    told: list[tuple[Level, str]] = []
    first, agent, said = watched(tmp_path, told)
    said.drop()
    first.close()
    assert agent.poll()
    second = GuardEnd(path(tmp_path), OTHER)
    for _ in range(3 * AGAIN_AFTER):
        agent.poll()
        assert second.hear() is None
        assert not agent.there
    assert [level for level, _ in told] == [Level.ERROR, Level.ERROR]
    assert "the guard is back and does not watch: found cell abababababab" in told[1][1]
    second.close()
    agent.leave()


@pytest.mark.parametrize(("guarded", "code", "words"), [(True, 3, "the guard goes on"), (False, 0, "")])
def test_a_loop_that_fails_ends_its_process_at_once_where_somebody_goes_on(
    guarded: bool, code: int, words: str
) -> None:
    program = f"""
import sys
from agent.guard.guarded import Guarded
from drivers.interface import StaleStateError
agent = Guarded.__new__(Guarded)
agent._end, agent._watch, agent._asked_back = (object(), ((), {{}}), False) if {guarded} else (None, None, False)
agent._hangs = False
agent._tell = lambda level, text: print(level.name, text)
try:
    raise StaleStateError("state", found="no reply", expected="a reply", remedy="look")
except Exception as error:
    agent.give_up(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == code
    assert words in done.stdout
    assert ("Traceback" in done.stderr) is guarded


@pytest.mark.parametrize("deaf", [1, 2])
def test_a_loop_that_fails_ends_its_process_at_once_though_nobody_reads_what_it_says(deaf: int) -> None:
    program = f"""
import os
from agent.guard.guarded import Guarded
agent = Guarded.__new__(Guarded)
agent._end, agent._watch, agent._asked_back = object(), ((), {{}}), False
agent._hangs = False
agent._tell = lambda level, text: None  # into the ring
print("not flushed yet")
try:
    raise RuntimeError("a defect")
except RuntimeError as error:
    reader, writer = os.pipe()
    os.close(reader)
    os.dup2(writer, {deaf})
    try:
        agent.give_up(error)
    finally:
        os._exit(77)  # an orderly end, which would switch the torque off
"""
    buffered = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=buffered)
    assert done.returncode == CRASHED
    assert ("not flushed yet" in done.stdout) is (deaf == 2)
    assert ("RuntimeError: a defect" in done.stderr) is (deaf == 1)
