"""Rows by column are the rows: every field, every part, every selection, whatever varies and wherever blocks end."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.log.columns import BLOCK_ROWS, ColumnFile, ColumnFileError, StoredRows, Table
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE, Layout
from tests.support.few import long

layouts = pytest.mark.parametrize("layout", [AGENT_STATE, PLANT_STATE], ids=lambda layout: layout.ros_name)


def some_rows(layout: Layout, count: int, seed: int) -> np.ndarray:
    """Rows in which some numbers vary, some do not, some only within a stretch, and some are no numbers."""
    random = np.random.default_rng(seed)
    rows = np.zeros(count, layout.dtype)
    rows["encapsulation"] = random.integers(1, 1000)
    for f in layout.fields:
        column = rows[f.name]
        kind = random.integers(5)
        if kind == 0:
            column[...] = random.integers(1, 1000)
        elif kind == 1:
            column[count // 2 :] = random.integers(1, 1000)
        elif kind > 2:
            column[...] = random.integers(0, 1000, column.shape)
        if f.ros_type == "float64" and kind == 4 and count:
            column[random.integers(count)] = np.nan
            column[random.integers(count)] = -0.0
    return rows


@contextmanager
def stored(rows: np.ndarray, pieces: int = 1, folder: Path | None = None) -> Iterator[Table]:
    with ColumnFile(folder) as file:
        store = StoredRows(file, rows.dtype)
        for piece in np.array_split(rows, pieces):
            store.add(piece.view(np.uint8).reshape(len(piece), rows.dtype.itemsize))
        store.finish()
        yield Table(store)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == np.ascontiguousarray(b).tobytes()


@layouts
@pytest.mark.parametrize(
    "count", [0, 1, *map(long, (2, BLOCK_ROWS - 1, BLOCK_ROWS)), BLOCK_ROWS + 1, long(2 * BLOCK_ROWS + 100)]
)
def test_every_column_is_that_of_the_rows_to_the_last_bit(layout: Layout, count: int) -> None:
    rows = some_rows(layout, count, count)
    with stored(rows, pieces=7) as table:
        assert len(table) == count
        assert table.messages().tobytes() == rows.tobytes()
        assert same(table["encapsulation"], rows["encapsulation"])
        for f in layout.fields:
            assert same(table[f.name], rows[f.name]), f.name
            if f.length:
                part = slice(1, f.length - 1)
                assert same(table.column(f.name, part), rows[f.name][:, part]), f.name


@given(st.data(), st.integers(1, 40), st.integers(0, 2**20))
def test_a_selection_of_a_selection_is_that_of_the_array(choice: st.DataObject, count: int, seed: int) -> None:
    rows = some_rows(PLANT_STATE, count, seed)
    with stored(rows, pieces=3) as on_disk:
        tables, expected = [on_disk, Table.of(rows)], rows
        for _ in range(3):
            key = choice.draw(keys(len(expected)))
            tables, expected = [table[key] for table in tables], expected[key]
            for table in tables:
                assert len(table) == len(expected)
                assert same(table["p_object"], expected["p_object"])
                assert same(table["arm_count"], expected["arm_count"])
                assert table.messages().tobytes() == expected.tobytes()


def keys(count: int) -> st.SearchStrategy[slice | np.ndarray]:
    masks = st.lists(st.booleans(), min_size=count, max_size=count).map(lambda m: np.array(m, bool))
    ends = st.integers(-2, count + 2)
    slices = st.builds(slice, ends, ends, st.sampled_from([None, 1, 2, -1]))
    numbers = st.lists(st.integers(0, count - 1), max_size=8).map(lambda n: np.array(n, int)) if count else masks
    return st.one_of(masks, slices, numbers)


@given(st.integers(0, 2**20))
def test_another_column_follows_the_rows_that_are_chosen(seed: int) -> None:
    rows = some_rows(AGENT_STATE, 30, seed)
    with stored(rows) as table:
        t = np.arange(30.0)
        moved = table.with_column("t", t)[5:][::2]
        assert same(moved["t"], t[5::2])
        assert same(moved["q"], rows["q"][5::2])
        assert same(table["t"], rows["t"])


def test_blocks_are_the_rows_in_their_order() -> None:
    rows = some_rows(PLANT_STATE, 25, 1)
    with stored(rows) as table:
        blocks = list(table.blocks(10))
        assert [len(block) for block in blocks] == [10, 10, 5]
        assert same(np.concatenate([block["energy"] for block in blocks]), rows["energy"])


def test_what_the_rows_do_not_have_is_a_key_error() -> None:
    rows = some_rows(AGENT_STATE, 3, 1)
    with stored(rows) as on_disk:
        for table in (on_disk, Table.of(rows)):
            with pytest.raises(KeyError, match="nonsense"):
                table["nonsense"]


def test_numbers_that_do_not_change_take_no_room() -> None:
    rows = np.zeros(4 * BLOCK_ROWS, AGENT_STATE.dtype)
    rows["sequence"] = np.arange(len(rows))
    with ColumnFile() as file:
        store = StoredRows(file, rows.dtype)
        store.add(rows.view(np.uint8).reshape(len(rows), -1))
        store.finish()
        assert file.bytes_written == 8 * len(rows)


def test_no_file_is_left_and_a_folder_that_is_not_there_is_refused() -> None:
    with TemporaryDirectory() as name:
        with stored(some_rows(AGENT_STATE, 3 * BLOCK_ROWS, 1), folder=Path(name)):
            assert list(Path(name).iterdir()) == []
        with pytest.raises(ColumnFileError, match="TMPDIR"):
            ColumnFile(Path(name) / "missing")


def test_a_full_disk_is_a_refusal(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(ColumnFileError, match=r"File too large.*make room"), stored(
            some_rows(AGENT_STATE, BLOCK_ROWS, 1), folder=tmp_path
        ):  # fmt: skip
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, old)
