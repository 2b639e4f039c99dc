"""A log of any length by the recorder's own file classes: the paper's two arms and a plant, made block by block.

`python -m tests.support.telemetry.long_log SECONDS FILE` makes one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from agent.log.channels import LogChannels
from agent.log.file import Attachment, LogFile
from agent.log.misfits import config_id_of
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import PLANT, Address, Kind
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.synthetic_run import paper_rows, run_file, true_rows

CELL = "paper"
ARMS = {"left": ("shoulder", "elbow", "wrist_angle"), "right": ("shoulder", "elbow", "wrist_angle")}
RATE_HZ = 200
TRUE_EVERY = 4  # the plant's rows come at 50 Hz
BLOCK_TICKS = 2000
BATCH = 20
# what a law without adaptation, posture and internal force leaves at zero, and what shall stay exact
EXACT = {"theta_arm", "theta_object", "memory", "tau_posture", "tau_adaptive", "t", "quat_object", "quat_object_des"}


def make_long_log(path: Path, duration_s: float) -> None:
    """Write a complete log with the figures of `paper_run`, as large as one of a real run: about 34 MB in 100 s."""
    ticks = round(duration_s * RATE_HZ)
    described = run_file(duration_s, float(RATE_HZ))
    run, config_id = json.dumps(described).encode(), config_id_of(described["fingerprint"], {})
    file = LogFile(path, [Attachment("run.json", "application/json", run)], {}, created_ns=1, min_free_bytes=0)
    channels = LogChannels(file, scene(CELL, ARMS), has_plant=True)
    random, torque_noise = np.random.default_rng(1), np.random.default_rng(7)
    for first in range(0, ticks, BLOCK_TICKS):
        count = min(BLOCK_TICKS, ticks - first)
        rows = {
            arm: paper_rows(side, count, torque_noise, first=first) for arm, side in (("left", -1.0), ("right", 1.0))
        }
        rows[PLANT] = true_rows(rows["left"])[::TRUE_EVERY]
        for own in rows.values():
            own["config_id"] = config_id
        for arm in ARMS:
            _add_noise(rows[arm], random)
        for begin in range(0, count, BATCH):
            for member, own in rows.items():
                step = TRUE_EVERY if member == PLANT else 1
                some = own[begin // step : (begin + BATCH) // step]
                channels.write_rows(Rows(Address(CELL, member, Kind.STATE), some))
        file.tick(1e9 + first)
    for arm in ARMS:
        event = Event(
            2_000_000_000_000_000_000, arm, Level.INFO, "run ended", {"ticks": ticks, "wall_s": duration_s / 2}
        )
        channels.write_text(Text(Address(CELL, arm, Kind.EVENT), event.to_json(), event.utc_ns, event))
    if not file.finish({"completeness": {"complete": "true"}}):
        raise RuntimeError(file.failure)


def _add_noise(rows: np.ndarray, random: np.random.Generator) -> None:
    """Noise far below every figure of the report, so that compression has the work it has with a real run."""
    for f in AGENT_STATE.fields:
        if f.ros_type == "float64" and f.name not in EXACT and not f.timing:
            used = 3 if f.length == 7 else max(f.length, 1)
            rows[f.name].reshape(len(rows), -1)[:, :used] += 1e-9 * random.standard_normal((len(rows), used))


if __name__ == "__main__":
    make_long_log(Path(sys.argv[2]), float(sys.argv[1]))
