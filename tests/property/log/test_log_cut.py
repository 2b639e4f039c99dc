"""A log cut at any byte gives every chunk before the cut; a flipped byte never gives a wrong row in silence."""

from __future__ import annotations

from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.log.messages import Messages
from agent.log.read import LogError, RunLog, read_log
from agent.log.scan import LogScan
from tests.support.telemetry.log_maker import make_log

BATCHES, COUNT = 6, 12


@cache
def original() -> tuple[bytes, dict[str, np.ndarray], list[int]]:
    """A finished log, its rows, and where each chunk with messages ends."""
    with TemporaryDirectory() as folder:
        rows = make_log(Path(folder) / "run.mcap", COUNT, batches=BATCHES)
        data = (Path(folder) / "run.mcap").read_bytes()
    ends, scan = [], LogScan(BytesIO(data))
    before = 8
    for record in scan:
        if isinstance(record, Messages):
            length = int.from_bytes(data[scan.intact_bytes + 1 : scan.intact_bytes + 9], "little")
            before = scan.intact_bytes + 9 + length
            ends.append(before)
    return data, rows, ends


def read(data: bytes) -> RunLog | None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(data)
        try:
            return read_log(path)
        except LogError:
            return None


@pytest.mark.fault("D5")
def test_every_cut_gives_everything_before_it() -> None:
    data, rows, ends = original()
    assert len(ends) == BATCHES
    around_the_ends = {end + d for end in ends for d in (-1, 0, 1)}
    for cut in sorted({*range(0, len(data), 101), *around_the_ends}):
        check_cut(data, rows, ends, cut)


@given(st.data())
@pytest.mark.fault("D5")
def test_any_cut_gives_everything_before_it(choice: st.DataObject) -> None:
    data, rows, ends = original()
    check_cut(data, rows, ends, choice.draw(st.integers(0, len(data) - 1)))


def check_cut(data: bytes, rows: dict[str, np.ndarray], ends: list[int], cut: int) -> None:
    log = read(data[:cut])
    whole = sum(end <= cut for end in ends)
    if not whole:
        assert log is None
        return
    assert log is not None
    for arm in ("left", "right"):
        expected = rows[arm][: COUNT // BATCHES * whole]
        assert log.agents[arm].tobytes() == expected.tobytes()
    assert not log.complete
    assert log.problems


@given(st.data())
@pytest.mark.fault("D6")
def test_a_flipped_bit_is_told_of_and_never_gives_a_wrong_row(choice: st.DataObject) -> None:
    data, rows, _ = original()
    damaged = bytearray(data)
    damaged[choice.draw(st.integers(0, len(data) - 1))] ^= 1 << choice.draw(st.integers(0, 7))
    log = read(bytes(damaged))
    if log is None:
        return
    for arm, got in log.agents.items():
        true = {row.tobytes() for row in rows.get(arm, [])}
        assert all(row.tobytes() in true for row in got)
    assert not log.complete
