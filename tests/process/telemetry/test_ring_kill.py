"""SIGKILL at any instant leaves no torn row, and everything that was committed."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.forked import FORKED
from tests.support.telemetry.one_arm import wait_for

FLOATS = [f.name for f in AGENT_STATE.fields if f.ros_type == "float64"]


def write_for_ever(path: Path, slots: int, ready) -> None:
    ring = RingWriter(path, AGENT_STATE, "left", slots=slots)
    payload = ring._staged[4:].cast("d")
    ready.set()
    while True:
        n = ring.written
        for i in range(len(payload)):
            payload[i] = n
        ring.commit()


def values(payload: bytes) -> np.ndarray:
    rows = np.frombuffer(payload, np.uint8).reshape(-1, AGENT_STATE.dtype.itemsize)[:, 4:]
    return np.ascontiguousarray(rows).view(np.float64)


@pytest.mark.parametrize(
    ("slots", "kills"),
    [(4, 2), (4096, 1), *(pytest.param(slots, 10, marks=pytest.mark.long) for slots in (4, 4096))],
)
def test_no_reader_ever_sees_a_torn_row_and_a_killed_writer_leaves_none(tmp_path: Path, slots: int, kills: int) -> None:
    seed = random.randrange(1 << 30)
    chance = random.Random(seed)
    for turn in range(kills):
        path, ready = tmp_path / f"{turn}.ring", FORKED.Event()
        child = FORKED.Process(target=write_for_ever, args=(path, slots, ready))
        child.start()
        try:
            assert ready.wait(60)
            with RingReader(path, AGENT_STATE) as reader:
                wait_for(lambda reader=reader: reader.written > 0)
                end = time.monotonic() + chance.uniform(0.05, 0.4)
                got = 0
                while time.monotonic() < end:
                    got += check(reader, seed)
                os.kill(child.pid, signal.SIGKILL)
                child.join()
                assert not reader.writer_alive
                assert not reader.finished
                while reader.next_index < reader.written:
                    got += check(reader, seed)
                assert got + reader.missed == reader.written, seed
                assert reader.damaged == 0, seed
                assert got > 0, seed
        finally:
            child.kill()
            child.join()
            child.close()


def check(reader: RingReader, seed: int) -> int:
    block = reader.read_new(64)
    if block.count:
        rows = values(block.payload)
        assert np.array_equal(rows, np.arange(block.first, block.first + block.count)[:, None] + 0 * rows), seed
    return block.count
