"""A poor log gives a poor report: nothing that an arm may lack of its motion ends a command in a traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.safety import Flag
from tests.support.command import coop
from tests.support.telemetry.run_log import write_run
from tests.unit.log.test_misfits import PAPER, TICKS, scene

LEFT, RIGHT, BOTH = ("left",), ("right",), ("left", "right")
COMMANDS = ("report --out out", "compare GOOD", "grasps", "events", "export --out out")


def lacking(rows: np.ndarray, what: str) -> np.ndarray:
    if what == "one row":
        return rows[:1]
    rows, part = rows.copy(), slice(TICKS // 2 if what.endswith("in the end") else 0, None)
    rows["flags"][part] |= Flag.STALE.value
    for name in ("q_measured", "dq_measured", "tau_measured"):
        rows[name][part] = np.nan
    return rows


@pytest.mark.parametrize(
    ("what", "arms", "plant"),
    [
        ("no fresh state", LEFT, False), ("no fresh state", RIGHT, False), ("no fresh state", BOTH, False),
        ("no fresh state", BOTH, True), ("no fresh state in the end", BOTH, False), ("one row", RIGHT, True),
        ("one row", BOTH, False),
    ],
)  # fmt: skip
def test_a_log_that_lacks_what_an_arm_was_to_show_is_reported_and_compared(
    tmp_path: Path, what: str, arms: tuple[str, ...], plant: bool
) -> None:
    rows = {name: own for name, own in scene().items() if plant or name != "plant"}
    poor = rows | {arm: lacking(rows[arm], what) for arm in arms}
    logs = {"POOR": tmp_path / "poor.mcap", "GOOD": tmp_path / "good.mcap"}
    for path, members in zip(logs.values(), (poor, rows), strict=True):
        write_run(path, PAPER, members)
    for command in COMMANDS:
        name, *words = (str(logs.get(word, word)) for word in command.split())
        done = coop(name, logs["POOR"], *words, cwd=tmp_path)
        assert done.code in (0, 2), done.err
        assert name != "report" or (done.code == 0 and (tmp_path / "out/report.html").exists())
