"""`make kills`: a recorder that records two arms in real time is killed at random, again and again.

KILLS: how often (default 20).  KILLS_SEED: of the instants (0).
After each kill at most a second of rows may be missing; recovered, the log is read whole by `mcap`,
`mcap-ros2-support`, `rosbags` and `@mcap/core`, all with the same messages.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from agent.log.read import read_log
from agent.log.recover import recover
from agent.telemetry.link.publication import Pace
from tests.soak.watch import say
from tests.support.mcap_core import install, read_by_node, read_by_python
from tests.support.telemetry.one_arm import written
from tests.support.telemetry.telemetry_cell import ARMS, make_rows, recording, writer

RATE_HZ: Final = 200.0
ROWS: Final = 4000
AT_S: Final = (0.3, 4.0)  # after the first row
LOST_MAX: Final = round(RATE_HZ)  # a second


def main() -> int:
    """Kill and look; 0 when every log kept its promise."""
    kills, chance = int(os.environ.get("KILLS", "20")), random.Random(int(os.environ.get("KILLS_SEED", "0")))
    complaints: list[str] = []
    worst = 0
    with tempfile.TemporaryDirectory() as name:
        library = Path(name) / "library"
        library.mkdir()
        if missing := install(library):
            say(f"not read by @mcap/core: {missing}")
        for number in range(kills):
            folder = Path(name) / str(number)
            folder.mkdir()
            after_s = chance.uniform(*AT_S)
            lost, found = judged(folder, library if not missing else None, after_s)
            worst = max(worst, lost)
            say(f"killed after {after_s:.2f} s: {lost} rows of one arm lost{''.join(f'; {text}' for text in found)}")
            complaints += found
    say(f"{kills} kills, at most {worst} rows of one arm lost ({worst / RATE_HZ:.2f} s), {len(complaints)} complaints")
    return 1 if complaints or missing else 0


def judged(folder: Path, library: Path | None, after_s: float) -> tuple[int, list[str]]:
    """Rows that one arm lost at most, and what was wrong."""
    before, path = killed(folder, after_s), folder / "run.mcap"
    repaired = recover(path).repaired
    log = read_log(path)
    lost = max(count - len(log.agents[arm]) for arm, count in before.items())
    wrong = [] if repaired else ["nothing to recover"]
    if lost > LOST_MAX:
        wrong.append(f"{lost} rows lost, at most {LOST_MAX}")
    for arm in ARMS:
        rows = log.agents[arm]
        if rows.tobytes() != make_rows(arm, ROWS)[: len(rows)].tobytes():
            wrong.append(f"rows of {arm} are not those that were written")
    counts = {"mcap": sum(each["count"] for each in read_by_python(path).values())}
    with path.open("rb") as file:
        decoded = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        counts["mcap-ros2-support"] = sum(1 for _ in decoded)
    with AnyReader([path]) as reader:
        counts["rosbags"] = sum(1 for c, _, raw in reader.messages() if reader.deserialize(raw, c.msgtype))
    if library is not None:
        found = read_by_node(library, path)
        counts["@mcap/core"] = found["told"]
        if found["topics"] != read_by_python(path):
            wrong.append("@mcap/core reads other bytes")
    if len(set(counts.values())) != 1 or not counts["mcap"]:
        wrong.append(f"messages by reader: {counts}")
    return lost, wrong


def killed(folder: Path, after_s: float) -> dict[str, int]:
    """How many rows each arm had written when the recorder was killed."""
    with ExitStack() as stack:
        cell = recording(stack, folder, Pace.REAL_TIME)
        rings = cell.rings
        writers = [stack.enter_context(writer(ring, arm, ROWS, RATE_HZ, texts=True)) for arm, ring in rings.items()]
        for process in writers:
            process.ready()
        time.sleep(after_s)
        before = {arm: written(ring) for arm, ring in rings.items()}
        cell.recorder.kill()
        return before


if __name__ == "__main__":
    sys.exit(main())
