"""Any order of writing and reading: a reader gets consecutive rows, and what it does not get it counts."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given
from hypothesis import strategies as st

from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import PLANT_STATE

actions = st.lists(st.tuples(st.integers(0, 40), st.integers(1, 40)), max_size=12)


@given(actions, st.integers(2, 24))
def test_every_row_is_read_once_in_order_or_counted_as_missed(steps: list[tuple[int, int]], slots: int) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "r"
        with RingWriter(path, PLANT_STATE, "plant", slots=slots) as writer, RingReader(path, PLANT_STATE) as reader:
            seen: list[int] = []
            for write, read in steps:
                for _ in range(write):
                    writer.row["sequence"] = writer.written
                    writer.commit()
                block = reader.read_new(read)
                got = PLANT_STATE.decode(block.payload)["sequence"].tolist()
                assert got == list(range(block.first, block.first + block.count))
                assert block.count <= read
                seen += got
                assert seen == sorted(set(seen))
                assert len(seen) + reader.missed == reader.next_index
            while (block := reader.read_new(1000)).count:
                seen += range(block.first, block.first + block.count)
            assert len(seen) + reader.missed == writer.written
            assert seen[-slots:] == list(range(writer.written))[-slots:] or not writer.written
