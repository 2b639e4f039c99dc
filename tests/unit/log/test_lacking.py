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
from agent.report.metrics import summarise
from tests.support.command import coop
from tests.support.telemetry import run_log
from tests.support.telemetry.log_maker import LogMaker
from tests.support.telemetry.run_log import write_run
from tests.support.telemetry.synthetic_run import paper_rows, true_rows
from tests.support.telemetry.telemetry_cell import ARMS, make_rows

PAPER = load_cell(configs.CELLS_DIR / "paper.toml")
COUNTS = {"complete": "true", "left.rows_expected": "60", "left.rows_recorded": "60", "left.end": "finished"}
COMMANDS = (
    "replay", "replay --set object.mass_kg=0.6", "replay --same-as LOG", "grasps", "events", "export",
    "compare LOG", "compare --json LOG", "play --speed 1000 --listen tcp/127.0.0.1:0", "calibrate",
    "view --film out.png",
)  # fmt: skip
RIGHT = {key.replace("left", "right"): value for key, value in COUNTS.items()}


def log_of(path: Path, told: dict[str, str], **rows: np.ndarray) -> Path:
    maker = LogMaker(path, has_plant="plant" in rows, arms={arm: ARMS[arm] for arm in rows if arm in ARMS})
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
    untold = read_log(log_of(tmp_path / "untold.mcap", COUNTS, left=left, right=make_rows("right", 0)))
    assert (untold.complete, untold.lacks) == (False, ("no row of right is in it",))
    assert (told.unjudged, untold.unjudged) == (told.lacks, untold.lacks)


@pytest.mark.parametrize("member", ["left", "right", "plant"])
def test_a_log_from_which_a_whole_member_is_gone_with_its_channel_is_named_and_no_verdict_is_given(
    tmp_path: Path, member: str
) -> None:
    told = COUNTS | RIGHT | {key.replace("left", "plant"): value for key, value in COUNTS.items()}
    rows = {name: make_rows(name, 60) for name in ("left", "right", "plant")}
    whole = read_log(log_of(tmp_path / "whole.mcap", told, **rows))
    assert (whole.complete, whole.lacks, whole.unjudged) == (True, (), ())
    few = log_of(tmp_path / "few.mcap", told, **(rows | {member: rows[member][:59]}))
    assert (read_log(few).complete, read_log(few).unjudged) == (False, ()), "which a verdict may still be given of"
    del rows[member]
    path = log_of(tmp_path / "gone.mcap", told, **rows)
    log, line = read_log(path), f"60 of the 60 rows of {member} that were recorded are not in it"
    assert member not in log.gaps, "the file names it nowhere"
    assert (log.complete, log.lacks, log.unjudged) == (False, (line,), (line,))
    with load(path) as run:
        assert (run.complete, run.lacks) == (False, (line,))


def test_a_plant_that_only_the_recorder_was_to_record_is_missed(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False, about={"plant": "true"})
    for arm in ARMS:
        maker.write(arm, make_rows(arm, 60))
    maker.finish()
    log = read_log(tmp_path / "run.mcap")
    assert (log.complete, log.unjudged) == (False, ("no row of plant is in it",))


@pytest.mark.parametrize("member", ["right", "plant"])
def test_a_report_without_a_member_gives_no_verdict_and_says_why(tmp_path: Path, member: str) -> None:
    noise = np.random.default_rng(1)
    cell = load_cell(configs.CELLS_DIR / "paper.toml", ["duration_s=2.0", "report.transient_s=1.0"])
    rows = {name: paper_rows(side, 400, noise) for name, side in (("left", -1.0), ("right", 1.0))}
    rows |= {"plant": true_rows(rows["left"])}
    told = {f"{name}.rows_recorded": "400" for name in rows}
    whole = summarise(read_log(write_run(tmp_path / "whole.mcap", cell, rows, told=told)))
    assert (whole.complete, whole.within_bounds) == (True, True)
    gone = {name: own for name, own in rows.items() if name != member}
    path, line = tmp_path / "gone.mcap", f"400 of the 400 rows of {member} that were recorded are not in it"
    found = summarise(read_log(write_run(path, cell, gone, told=told)))
    assert (found.complete, found.missing.count(line)) == (False, 1)
    assert set(found.to_json()["verdicts"].values()) == {"not shown"}
    for command in COMMANDS:
        name, *words = command.replace("LOG", str(path)).split()
        done = coop(name, path, *words, cwd=tmp_path)
        refused = member != "plant" and done.code == 2
        assert f"{path}: not all of the run is in it: {line}" in done.err.splitlines() or refused, command
    assert line in coop("report", path, "--out", tmp_path / "out").err


def test_an_arm_that_only_the_description_of_the_run_names_is_missed(tmp_path: Path) -> None:
    told = {"left.rows_recorded": "5"}
    assert lacking(told, {"left": 5}, {}, ["left", "right"]) == {"right": "no row of right is in it"}
    assert lacking(told, {"left": 5}, {}, ["left"]) == {}


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


@pytest.mark.parametrize(("count", "lost"), [("0", 0), ("²", 0), ("9" * 19, int("9" * 19)), ("9" * 20, 0)])
def test_of_an_arm_that_was_told_of_only_the_rows_that_were_recorded_are_missed(count: str, lost: int) -> None:
    """A count that is none, or longer than a sequence can be, says nothing."""
    said = f"{lost} of the {lost} rows of left that were recorded are not in it"
    assert lacking({"left.rows_recorded": count}, {"left": 0}, {}, []) == ({"left": said} if lost else {})


def test_numbers_that_are_left_out_are_missed_where_nobody_counted(tmp_path: Path) -> None:
    assert lacking({"complete": "true"}, {"left": 50}, {"left": 10}, []) == {"left": "10 rows of left are not in it"}


def test_a_row_that_came_late_makes_no_gap_in_the_log_it_is_in(tmp_path: Path) -> None:
    """It is of the stretch of an earlier log."""
    told = COUNTS | {"left.rows_expected": "59", "left.rows_recorded": "59", "left.late_rows": "1"}
    rows = make_rows("left", 160)[np.r_[50, 101:160]]
    log = read_log(log_of(tmp_path / "run.mcap", told | RIGHT, left=rows, right=make_rows("right", 60)))
    assert log.gaps["left"] == ((51, 100),)
    assert (log.complete, log.lacks) == (True, ())


@pytest.mark.parametrize("count", ["", "-5", "a few", "²", "9" * 5000])
def test_a_count_that_is_none_is_no_reason_to_miss_anything(count: str) -> None:
    assert lacking({"left.rows_recorded": count}, {"left": 1}, {}, []) == {}


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


@pytest.mark.parametrize("command", COMMANDS)
def test_whoever_works_with_a_log_that_lacks_rows_says_so_in_one_line(tmp_path: Path, command: str) -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    rows = {name: paper_rows(side, 40, np.random.default_rng(1)) for name, side in (("left", 1.0), ("right", -1.0))}
    log = write_run(tmp_path / "run.mcap", cell, rows | {"left": rows["left"][np.r_[0:20, 30:40]]})
    name, *words = command.replace("LOG", str(log)).split()
    done = coop(name, log, *words, cwd=tmp_path)
    line = f"{log}: not all of the run is in it: 10 rows of left are not in it"
    assert line in done.err.splitlines()
