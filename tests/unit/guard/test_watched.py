"""An agent that is watched: a real process, ring and texts; what the guard sees, ends, reads and goes on with."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from agent.guard.line import GuardError, Said, Word
from agent.guard.pulse import Pulse
from agent.guard.resume import beginning
from agent.guard.vigil import Vigil
from agent.guard.watched import Watched
from agent.modes import Mode
from agent.process.build import build_agent
from agent.telemetry.ring.file import SLOTS_OFFSET, RingError
from agent.telemetry.ring.reader import RingReader, RowBlock
from agent.telemetry.ring.texts import TextReader, TextWriter, texts_path
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.runner_rig import paper, q_start, run

MS = 1_000_000
SLOTS = 128
LEFT = build_agent(paper(), paper().arms[0])


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@dataclass
class Agent:
    """A process that does nothing, with the ring and texts of one that commands an arm."""

    pid: int
    ring: RingWriter
    texts: TextWriter
    path: Path

    def said(self, count: int = 4) -> Said:
        """Its word, with descriptors of its own process, pulse, ring and texts, and one that nobody asked for."""
        with closing(Pulse.made()) as pulse:
            own = (pulse.fileno(), self.ring.fileno(), self.texts.fileno())
            fds = (os.pidfd_open(self.pid), *map(os.dup, own))
        return Said(Word.WATCH, {"ring": str(self.path)}, fds[:count])

    def rows(self, count: int) -> None:
        for _ in range(count):
            self.ring.row["sequence"] = self.ring.written
            self.ring.commit()


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[Agent]:
    path = tmp_path / "left.ring"
    texts, ring = TextWriter(path, "left"), RingWriter(path, AGENT_STATE, "left", slots=SLOTS)
    process = subprocess.Popen(["sleep", "600"])
    yield Agent(process.pid, ring, texts, path)
    process.kill()
    process.wait()
    ring.close()
    texts.close()


def watched(agent: Agent, **vigil: int) -> Watched:
    return Watched.of(agent.said(), Vigil(**{"stale_ns": 20 * MS, "look_ns": 2 * MS, **vigil}))


def ended(agent: Agent) -> int:
    """By which signal; waits until it has."""
    found = os.waitid(os.P_PID, agent.pid, os.WEXITED | os.WNOWAIT)
    assert found is not None
    return int(found.si_status)


def no_word(text: str) -> None:
    pytest.fail(text)


def test_an_agent_is_gone_once_its_process_has_ended_and_not_before(agent: Agent) -> None:
    seen = watched(agent)
    assert (seen.gone, seen.handed_over, seen.rehearsed, seen.ring) == (False, False, False, agent.path)
    os.kill(agent.pid, signal.SIGKILL)
    ended(agent)
    assert seen.gone
    seen.close()


def test_one_without_a_new_row_hangs_after_a_while(agent: Agent) -> None:
    seen = watched(agent)
    agent.rows(1)
    looks = [seen.hangs(2 * MS * n) for n in range(1, 12)]
    assert looks == [False] * 10 + [True]
    agent.rows(1)
    assert not seen.hangs(24 * MS)
    seen.close()


@pytest.mark.parametrize(("written", "first", "count"), [(0, 0, 0), (1, 0, 1), (64, 0, 64), (70, 6, 64)])
def test_the_last_rows_are_at_most_sixty_four(agent: Agent, written: int, first: int, count: int) -> None:
    seen = watched(agent)
    agent.rows(written)
    assert seen.last_rows()["sequence"].tolist() == list(range(first, first + count))
    seen.close()


@pytest.mark.parametrize(("bad", "left"), [(5, range(6, 25)), (22, range(23, 25)), (24, range(24))])
def test_behind_a_damaged_row_the_hold_begins_as_the_newest_rows_say(agent: Agent, bad: int, left: range) -> None:
    rows = run(q=lambda reads: q_start() + 2e-3 * reads).rows[:25]  # READY, then TRACK
    for row in rows:
        agent.ring.row[...] = row
        agent.ring.commit()
    slot = SLOTS_OFFSET + bad * agent.ring.header.stride
    with agent.path.open("r+b", buffering=0) as file:
        os.pwrite(file.fileno(), bytes(64), slot + 1000)  # as when memory fails
    seen = watched(agent)
    found = seen.last_rows()
    assert found["sequence"].tolist() == list(left)
    begun = beginning(LEFT, found, "")
    untouched = beginning(LEFT, rows[: left.stop], "")
    np.testing.assert_array_equal(begun.memory.flatten(), untouched.memory.flatten())
    assert (begun.mode, begun.zero_ns, begun.rows) == (Mode.HOLD, untouched.zero_ns, left.stop)
    seen.close()


def damage(agent: Agent, row: int) -> None:
    """As when memory fails."""
    with agent.path.open("r+b", buffering=0) as file:
        os.pwrite(file.fileno(), b"\xff" * 64, SLOTS_OFFSET + row * agent.ring.header.stride + 1000)


def test_a_row_that_is_damaged_after_it_was_seen_is_not_lost_and_one_before_it_counts_no_more(agent: Agent) -> None:
    seen = watched(agent)
    agent.rows(5)
    assert not seen.hangs(2 * MS)
    assert seen.rows == 5
    damage(agent, 4)
    assert seen.last_rows()["sequence"].tolist() == [0, 1, 2, 3, 4]
    agent.rows(1)
    assert not seen.hangs(4 * MS)
    assert seen.rows == 6
    assert seen.last_rows()["sequence"].tolist() == [5]
    seen.close()


def test_who_inherits_goes_on_behind_a_damaged_row_of_a_whole_file(agent: Agent) -> None:
    seen = watched(agent)
    agent.rows(5)
    damage(agent, 4)
    seen.inherit(no_word)
    assert (seen.damage, seen.rows) == ("", 5)
    assert seen.last_rows()["sequence"].tolist() == [0, 1, 2, 3]
    seen.close()


@pytest.mark.fault("P14")
def test_the_first_row_of_all_is_kept_too(agent: Agent) -> None:
    seen = watched(agent)
    agent.rows(3)
    assert not seen.hangs(2 * MS)
    os.truncate(agent.path, 0)
    assert seen.last_rows()["sequence"].tolist() == [0, 1, 2]
    seen.close()


def test_what_is_inherited_goes_on_behind_the_last_row_and_text(agent: Agent) -> None:
    seen, heard = watched(agent), TextReader(agent.path)
    agent.rows(3)
    agent.texts.event(Event(1, "left", Level.INFO, "its own"))
    seen.inherit(no_word)
    assert (seen.writer.written, seen.damage) == (3, "")
    seen.writer.row["sequence"] = 3
    seen.writer.commit()
    seen.texts.event(Event(2, "left", Level.INFO, "the guard's"))
    assert seen.last_rows()["sequence"].tolist() == [0, 1, 2, 3]
    assert [b"its own" in text for _, text in heard.read_new()] == [True, False]
    seen.close()
    heard.close()


def test_while_a_guard_goes_on_another_agent_is_refused_and_told_what_ends_it(agent: Agent) -> None:
    """With everything of the first one gone: what the guard has keeps its rows and texts."""
    seen = watched(agent)
    agent.ring.close()
    agent.texts.close()
    seen.inherit(no_word)
    with pytest.raises(RingError, match=r"has a writer already.*a guard that holds the arm .* `coop release`"):
        TextWriter(agent.path, "left")
    seen.close()
    TextWriter(agent.path, "left").close()


@pytest.mark.fault("P14")
@pytest.mark.parametrize("left", [0, SLOTS_OFFSET + 2000])
def test_where_its_files_are_cut_the_hold_begins_with_the_rows_that_were_seen(agent: Agent, left: int) -> None:
    """Those that came after the last look are lost; the files are rings again, and go on behind them."""
    seen, heard = watched(agent), TextReader(agent.path)
    agent.texts.event(Event(1, "left", Level.INFO, "its own"))
    for look in range(1, 11):
        agent.rows(9)
        assert not seen.hangs(2 * MS * look)
    agent.rows(1)
    assert len(heard.read_new()) == 1
    texts = texts_path(agent.path)
    sizes = [file.stat().st_size for file in (agent.path, texts)]
    for file in (agent.path, texts):
        os.truncate(file, left)
    assert seen.damage == (
        f"its ring was cut to {left} of {sizes[0]} bytes, the ring of its texts was cut to {left} of {sizes[1]} bytes"
    )
    assert not seen.hangs(22 * MS), "it is not what is judged by it"
    assert seen.last_rows()["sequence"].tolist() == list(range(26, 90))
    seen.inherit(no_word)
    assert (seen.damage, [file.stat().st_size for file in (agent.path, texts)]) == ("", sizes)
    seen.writer.row["sequence"] = 90
    seen.writer.commit()
    seen.texts.event(Event(2, "left", Level.INFO, "the guard's"))
    assert seen.last_rows()["sequence"].tolist() == list(range(27, 91))
    assert [b"the guard's" in text for _, text in heard.read_new()] == [True]
    with RingReader(agent.path, AGENT_STATE) as reader:
        assert reader.read_last(SLOTS).first == 26
    seen.close()
    heard.close()


@pytest.mark.fault("P14")
def test_rows_of_a_hold_that_cannot_be_written_are_told_of_once(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    seen, told = watched(agent), list[str]()

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwritev", full)
    seen.inherit(told.append)
    for _ in range(3):
        seen.writer.commit()
    assert told == ["rows of this hold are lost: No space left on device"]
    seen.close()


def test_a_guard_that_comes_late_reads_no_more_than_it_keeps(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand rows at one look would cost a real-time process more than it may take."""
    seen, asked = watched(agent), list[int]()
    reads = seen.reader.read_at

    def counted(first: int, count: int) -> RowBlock:
        asked.append(count)
        return reads(first, count)

    monkeypatch.setattr(seen.reader, "read_at", counted)
    agent.rows(100)
    seen.hangs(2 * MS)
    agent.rows(2)
    seen.hangs(4 * MS)
    assert asked == [64, 2]
    seen.close()


def test_a_damaged_row_is_not_kept_and_neither_is_what_was_before_it(agent: Agent) -> None:
    seen = watched(agent)
    agent.rows(5)
    seen.hangs(2 * MS)
    agent.rows(3)
    with agent.path.open("r+b", buffering=0) as file:
        os.pwrite(file.fileno(), b"x" * 64, SLOTS_OFFSET + 5 * agent.ring.header.stride + 1000)
    seen.hangs(4 * MS)
    os.truncate(agent.path, 0)
    assert seen.last_rows()["sequence"].tolist() == [6, 7]
    seen.close()


def test_everything_of_an_agent_is_let_go(agent: Agent) -> None:
    before = descriptors()
    seen = watched(agent)
    assert descriptors() > before
    seen.close()
    assert descriptors() == before


@pytest.mark.parametrize("count", [0, 3])
def test_a_word_without_all_descriptors_is_refused_and_they_are_closed(agent: Agent, count: int) -> None:
    said = agent.said()
    for fd in said.fds[count:]:
        os.close(fd)
    before = descriptors() - count
    with pytest.raises(
        GuardError, match=f"word 'watch': found {count} descriptors, expected process, pulse, ring and texts"
    ):
        Watched.of(Said(Word.WATCH, {}, said.fds[:count]), Vigil(1, 1))
    assert descriptors() == before


@pytest.mark.fault("P7")
def test_each_look_at_its_rows_raises_the_pulse_that_the_agent_sees(agent: Agent) -> None:
    said = agent.said()
    with closing(Pulse(os.dup(said.fds[1]))) as pulse, closing(Watched.of(said, Vigil(20 * MS, 2 * MS))) as seen:
        assert pulse.count == 0
        for _ in range(3):
            seen.hangs(5000 * MS)
        assert pulse.count == 3


def test_a_pulse_that_is_none_is_refused_and_everything_is_closed(agent: Agent) -> None:
    before = descriptors()
    fds = list(agent.said().fds)
    os.close(fds[1])
    fds[1] = os.memfd_create("short")
    with pytest.raises(ValueError, match="length"):
        Watched.of(Said(Word.WATCH, {}, tuple(fds)), Vigil(1, 1))
    assert descriptors() == before


@pytest.mark.parametrize("wrong", [2, 3])
def test_a_ring_or_texts_that_are_none_are_refused_and_everything_is_closed(agent: Agent, wrong: int) -> None:
    before = descriptors()
    fds = list(agent.said().fds)
    os.close(fds[wrong])
    fds[wrong] = os.open("/proc/self/exe", os.O_RDONLY)
    with pytest.raises(RingError):
        Watched.of(Said(Word.WATCH, {}, tuple(fds)), Vigil(1, 1))
    assert descriptors() == before
