"""A recorder killed at any moment: what is older than a second is there, and every reader reads it.

Twice, and twenty in `make long`.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from agent.log.read import read_log
from agent.log.recover import recover
from tests.support.telemetry.log_maker import LogMaker
from tests.support.telemetry.telemetry_cell import ARMS, Process, make_rows

BATCH = 10  # rows of each arm; 20 batches a second at 200 Hz
SECOND = 20
KILLS, QUICK = 20, 1
ROWS = 20_000


def write_for_ever(path: Path, stop: Callable[[], bool], ready: Callable[[Any], None]) -> None:
    """Rows by the clock that the rows have; ready is told after each batch and its look at the clock."""
    maker = LogMaker(path, has_plant=False)
    rows = {arm: make_rows(arm, ROWS) for arm in ARMS}
    begin_s = time.monotonic()
    for i in range(ROWS // BATCH):
        for arm, own in rows.items():
            maker.write(arm, own[i * BATCH : (i + 1) * BATCH])
        maker.file.tick(begin_s + (i + 1) / SECOND)
        ready(i + 1)


def killed_at_random(path: Path, chance: random.Random) -> int:
    """A log whose writer was killed; how many batches its writer had written."""
    with Process(write_for_ever, path) as recorder:
        told = recorder.ready()
        until = time.monotonic() + chance.uniform(0.02, 0.15)
        while time.monotonic() < until:
            told = recorder.ready()
        recorder.kill()
        while recorder._ready.poll():
            try:
                told = recorder._ready.recv()
            except EOFError:
                break
    return int(told)


@pytest.mark.parametrize(
    "seed", [*range(QUICK), *(pytest.param(k, marks=pytest.mark.long) for k in range(QUICK, KILLS))]
)
@pytest.mark.fault("D4")
def test_a_second_is_lost_at_most_and_every_reader_reads_the_rest(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "run.mcap"
    batches = killed_at_random(path, random.Random(seed))
    assert recover(path).repaired
    log = read_log(path)
    for arm in ARMS:
        kept = log.agents[arm]
        assert batches * BATCH - len(kept) <= SECOND * BATCH
        assert kept.tobytes() == make_rows(arm, ROWS)[: len(kept)].tobytes()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        by_mcap = sum(1 for _ in reader.iter_messages())
        state = reader.iter_decoded_messages(topics=["/coop/paper/left/state"])
        sequences = [decoded.sequence for _, _, _, decoded in state]
    assert np.array_equal(sequences, log.agents["left"]["sequence"])
    with AnyReader([path]) as reader:
        assert sum(1 for _ in reader.messages()) == by_mcap
