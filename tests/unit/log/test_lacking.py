"""What a log lacks is found by its recorder's word and by its rows, and everybody who works with it says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.log.lacking import lacking
from agent.log.read import read_log
from agent.log.run import load
from agent.process.describe import run_info
from tests.support.command import coop
from tests.support.telemetry import run_log
from tests.support.telemetry.log_maker import LogMaker
from tests.support.telemetry.run_log import write_run
from tests.support.telemetry.synthetic_run import paper_rows
from tests.support.telemetry.telemetry_cell import make_rows

PAPER = load_cell(configs.CELLS_DIR / "paper.toml")
COUNTS = {"complete": "true", "left.rows_expected": "60", "left.rows_recorded": "60", "left.end": "finished"}
RIGHT = {key.replace("left", "right"): value for key, value in COUNTS.items()}


def log_of(path: Path, told: dict[str, str], **rows: np.ndarray) -> Path:
    maker = LogMaker(path, has_plant="plant" in rows)
    for member, own in rows.items():
        maker.write(member, own)
    maker.file.finish({"completeness": told})
    return path


def test_a_log_whose_rows_became_fewer_is_not_complete_though_its_recorder_said_so(tmp_path: Path) -> None:
    left, right = make_rows("left", 60), make_rows("right", 60)
    whole = read_log(log_of(tmp_path / "whole.mcap", COUNTS | RIGHT, left=left, right=right))
    assert (whole.complete, whole.lacks, whole.remarks) == (True, (), [])
    for k, kept in enumerate((left[:50], left[10:], left[np.r_[0:20, 30:60]])):
        log = read_log(log_of(tmp_path / f"{k}.mcap", COUNTS | RIGHT, left=kept, right=right))
        assert not log.complete
        assert log.problems == (), "the file is as it was written"
        assert log.remarks == [
            "not all of the run is in it: 10 of the 60 rows of left that were recorded are not in it"
        ]
    with load(log.path) as run:
        assert (run.complete, run.lacks) == (False, log.lacks)


def test_a_log_without_a_row_of_an_arm_is_not_complete(tmp_path: Path) -> None:
    left = make_rows("left", 60)
    told = read_log(log_of(tmp_path / "told.mcap", COUNTS | RIGHT, left=left))
    assert (told.complete, told.lacks) == (False, ("60 of the 60 rows of right that were recorded are not in it",))
    untold = read_log(log_of(tmp_path / "untold.mcap", COUNTS, left=left))
    assert (untold.complete, untold.lacks) == (False, ("no row of right is in it",))


def test_an_arm_that_only_the_description_of_the_run_names_is_missed(tmp_path: Path) -> None:
    told = {"left.rows_recorded": "5"}
    assert lacking(told, {"left": 5}, {}, ["left", "right"]) == ["no row of right is in it"]
    assert lacking(told, {"left": 5}, {}, ["left"]) == []


@pytest.mark.parametrize(
    ("more", "lacks"),
    [
        (['floating.arms=["left"]'], ()),
        ([], ("no row of right is in it",)),
        (['floating.arms=["left", "right"]'], ("no row of right is in it",)),
        (
            ['floating.arms=["left"]', "floating.holding=true", "floating.others_move=true"],
            ("no row of right is in it",),
        ),
    ],
)
def test_an_arm_that_takes_no_part_where_others_float_is_not_missed(
    tmp_path: Path, more: list[str], lacks: tuple[str, ...]
) -> None:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", more)
    log = read_log(write_run(tmp_path / "run.mcap", cell, {"left": make_rows("left", 60)}))
    assert (log.lacks, log.complete) == (lacks, not lacks)


def test_an_older_log_that_does_not_say_who_took_part_is_to_have_all_arms_of_its_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    older = {key: told for key, told in json.loads(run_info(PAPER, DriverKind.SIM, 0)).items() if key != "taking_part"}
    monkeypatch.setattr(run_log, "run_info", lambda *_: json.dumps(older).encode())
    log = read_log(write_run(tmp_path / "run.mcap", PAPER, {"left": make_rows("left", 60)}))
    assert log.lacks == ("no row of right is in it",)
    alone = json.loads(run_info(PAPER, DriverKind.SIM, 0, alone="left"))
    assert alone["taking_part"] == ["left"], "a post-mortem"


def test_numbers_that_are_left_out_are_missed_where_nobody_counted(tmp_path: Path) -> None:
    assert lacking({"complete": "true"}, {"left": 50}, {"left": 10}, []) == ["10 rows of left are not in it"]


def test_a_row_that_came_late_makes_no_gap_in_the_log_it_is_in(tmp_path: Path) -> None:
    """It is of the stretch of an earlier log."""
    told = COUNTS | {"left.rows_expected": "59", "left.rows_recorded": "59", "left.late_rows": "1"}
    rows = make_rows("left", 160)[np.r_[50, 101:160]]
    log = read_log(log_of(tmp_path / "run.mcap", told | RIGHT, left=rows, right=make_rows("right", 60)))
    assert log.gaps["left"] == ((51, 100),)
    assert (log.complete, log.lacks) == (True, ())


@pytest.mark.parametrize("count", ["", "-5", "a few", "²", "9" * 5000])
def test_a_count_that_is_none_is_no_reason_to_miss_anything(count: str) -> None:
    assert lacking({"left.rows_recorded": count}, {"left": 1}, {}, []) == []


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({}, "its recorder did not finish it, and nothing says what was to come"),
        ({"complete": "false"}, "its recorder says so"),
        ({"complete": "false"} | COUNTS | {"complete": "false", "left.end": "open"}, "left had not ended"),
        (
            COUNTS | {"complete": "false", "left.rows_expected": "99", "left.lost_on_disk": "39"},
            "60 of 99 rows of left, 39 lost on the disk",
        ),
    ],
)
def test_what_the_recorder_said_is_told(tmp_path: Path, told: dict[str, str], said: str) -> None:
    log = read_log(log_of(tmp_path / "run.mcap", told, left=make_rows("left", 60), right=make_rows("right", 60)))
    assert (log.complete, log.remarks) == (False, [f"not all of the run is in it: {said}"])


def test_a_truth_that_is_told_less_often_than_the_plant_ticks_has_no_gaps_but_where_one_is_missing(
    tmp_path: Path,
) -> None:
    plant = make_rows("plant", 200)[::4]
    rows = {"left": make_rows("left", 60), "right": make_rows("right", 60)}
    log = read_log(log_of(tmp_path / "run.mcap", COUNTS | RIGHT, **rows, plant=plant))
    assert (log.gaps["plant"], log.complete) == ((), True)
    log = read_log(log_of(tmp_path / "gap.mcap", COUNTS | RIGHT, **rows, plant=np.delete(plant, [3, 10, 11])))
    assert log.gaps["plant"] == ((12, 12), (40, 44))


COMMANDS = (
    "replay", "replay --set object.mass_kg=0.6", "replay --same-as LOG", "grasps", "events", "export",
    "compare LOG", "compare --json LOG",
)  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_whoever_works_with_a_log_that_lacks_rows_says_so_in_one_line(tmp_path: Path, command: str) -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    rows = {name: paper_rows(side, 40, np.random.default_rng(1)) for name, side in (("left", 1.0), ("right", -1.0))}
    log = write_run(tmp_path / "run.mcap", cell, rows | {"left": rows["left"][np.r_[0:20, 30:40]]})
    name, *words = command.replace("LOG", str(log)).split()
    done = coop(name, log, *words)
    line = f"{log}: not all of the run is in it: 10 rows of left are not in it"
    assert line in done.err.splitlines()
