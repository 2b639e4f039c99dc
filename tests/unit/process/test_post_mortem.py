"""A post-mortem has its name once it is whole; what a full disk leaves of it has another, and can be mended."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.log import file as log_file
from agent.log.file import LogFileError
from agent.log.read import read_log
from agent.log.recover import recover
from agent.process.post_mortem import write_post_mortem
from agent.report.prepared import prepare
from agent.telemetry.ring.file import SLOTS_OFFSET
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextWriter, _TextKind
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import UTC_END_NS, Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.telemetry.telemetry_cell import UTC_0_NS, make_rows

CELL, ROWS = configs.CELLS_DIR / "paper.toml", 40


def rows_of_cell() -> np.ndarray:
    rows = make_rows("left", ROWS)
    rows["config_id"] = load_cell(CELL).config_id
    return rows


@pytest.fixture
def ring(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "left.ring"
    with RingWriter(path, AGENT_STATE, "left", ("shoulder", "elbow"), slots=64) as writer:
        for row in rows_of_cell():
            writer.row[...] = row
            writer.commit()
        yield path


def test_it_has_its_name_once_it_is_whole(tmp_path: Path, ring: Path) -> None:
    out = tmp_path / "folder" / "left-post-mortem.mcap"
    assert write_post_mortem(CELL, "left", ring, out, "the agent has died") == ROWS
    assert list(out.parent.iterdir()) == [out]
    log = read_log(out)
    assert not log.problems
    assert log.agents["left"].tobytes() == rows_of_cell().tobytes()
    assert log.metadata["post_mortem"] == {"arm": "left", "cause": "the agent has died"}


def test_rows_on_both_sides_of_a_damaged_one_are_in_it(tmp_path: Path, ring: Path) -> None:
    with RingReader(ring, AGENT_STATE) as reader, ring.open("r+b", buffering=0) as file:
        os.pwrite(file.fileno(), bytes(64), SLOTS_OFFSET + 7 * reader.header.stride + 100)
    out = tmp_path / "left-post-mortem.mcap"
    assert write_post_mortem(CELL, "left", ring, out, "the agent has died") == ROWS - 1
    assert read_log(out).agents["left"]["sequence"].tolist() == [*range(7), *range(8, ROWS)]


@pytest.mark.parametrize("utc_ns", [-1, UTC_END_NS, (1 << 63) - 1])
def test_a_row_of_an_impossible_time_keeps_nothing_else_out_and_is_counted(tmp_path: Path, utc_ns: int) -> None:
    """As where the host's clock was set to before 1970."""
    rows = make_rows("left", ROWS).copy()
    rows["utc_ns"][7] = utc_ns
    with RingWriter(tmp_path / "left.ring", AGENT_STATE, "left", ("shoulder", "elbow"), slots=64) as writer:
        for row in rows:
            writer.row[...] = row
            writer.commit()
        out = tmp_path / "left-post-mortem.mcap"
        assert write_post_mortem(CELL, "left", tmp_path / "left.ring", out, "the agent has died") == ROWS - 1
    log = read_log(out)
    assert log.agents["left"]["sequence"].tolist() == [*range(7), *range(8, ROWS)]
    assert "1 messages that do not belong to this run were left out: impossible time" in prepare(log).missing


def test_a_text_that_makes_no_sense_keeps_nothing_else_out(tmp_path: Path, ring: Path) -> None:
    with closing(TextWriter(ring, "left")) as texts:
        texts.event(Event(UTC_0_NS, "left", Level.INFO, "before"))
        for kind in _TextKind:
            for payload in (b"{}", b'{"utc_ns": -1}'):
                texts._write(kind, payload)
        texts.event(Event(UTC_0_NS + 1, "left", Level.INFO, "after"))
    out = tmp_path / "left-post-mortem.mcap"
    assert write_post_mortem(CELL, "left", ring, out, "the agent has died") == ROWS
    assert [event.text for event in read_log(out).events] == ["before", "after"]


def test_a_name_that_is_taken_is_told_and_the_whole_file_has_its_other_name(tmp_path: Path, ring: Path) -> None:
    out = tmp_path / "left-post-mortem.mcap"
    out.mkdir()
    part = out.with_name(f"{out.name}.part")
    with pytest.raises(LogFileError, match=f"cannot name {out}: found Is a directory.*the whole post-mortem is {part}"):
        write_post_mortem(CELL, "left", ring, out, "the agent has died")
    assert len(read_log(part).agents["left"]) == ROWS


def test_a_full_disk_is_told_and_leaves_what_can_be_mended(
    tmp_path: Path, ring: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class FullAtTheEnd(log_file.BatchWriter):
        def finish(self) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(log_file, "BatchWriter", FullAtTheEnd)
    out = tmp_path / "folder" / "left-post-mortem.mcap"
    part = out.with_name(f"{out.name}.part")
    with pytest.raises(LogFileError, match=f"found No space left on device.*`coop recover {part}` mends"):
        write_post_mortem(CELL, "left", ring, out, "the agent has died")
    assert list(out.parent.iterdir()) == [part]
    assert recover(part).repaired
    assert len(read_log(part).agents["left"]) == ROWS
