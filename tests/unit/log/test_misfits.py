"""Rows of another run, and rows with a number of another time: named, never in a figure, and no verdict is given."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.log.columns import Table
from agent.log.misfits import config_id_of, misnumbered, number_of
from agent.log.read import read_log
from agent.report.bounds import BoundsMissed, require_bounds
from agent.report.compare import Change, compare
from agent.report.metrics import summarise
from agent.report.pace import Pace
from agent.report.results import Results
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from tests.support.command import coop
from tests.support.runner_rig import paper, run, wandering
from tests.support.telemetry.run_log import write_run
from tests.support.telemetry.synthetic_run import agent_rows, paper_rows, true_rows

TICKS = 400
SHORT = ("duration_s=2.0", "report.transient_s=1.0")
PAPER = load_cell(configs.CELLS_DIR / "paper.toml", SHORT)
COMMANDS = (
    "report --out out", "replay", "replay --set object.mass_kg=0.6", "replay --same-as LOG", "grasps", "events",
    "export --out out", "compare LOG", "compare --json LOG", "play --speed 1000 --listen tcp/127.0.0.1:0",
    "calibrate --out out", "view --film out.png",
)  # fmt: skip


@cache
def scene() -> Mapping[str, np.ndarray]:
    noise = np.random.default_rng(1)
    rows = {name: paper_rows(side, TICKS, noise) for name, side in (("left", -1.0), ("right", 1.0))}
    rows |= {"plant": true_rows(rows["left"])}
    for own in rows.values():
        own.flags.writeable = False
    return rows


def scene_with(member: str, part: slice, config_id: int) -> dict[str, np.ndarray]:
    rows = {name: own.copy() for name, own in scene().items()}
    rows[member]["config_id"][part] = config_id
    return rows


def results_of(path: Path) -> Results:
    return summarise(read_log(path))


# --------------------------------------------------------------------------------------------- of another configuration


@pytest.mark.parametrize("member", ["left", "right", "plant"])
@pytest.mark.parametrize("part", [slice(None), slice(200, None), slice(7, 8)], ids=["all", "half", "one"])
def test_rows_of_another_configuration_are_counted_and_no_verdict_is_given(
    tmp_path: Path, member: str, part: slice
) -> None:
    whole = results_of(write_run(tmp_path / "whole.mcap", PAPER, scene()))
    assert (whole.complete, whole.missing, whole.within_bounds) == (True, (), True)
    path = write_run(tmp_path / "mixed.mcap", PAPER, scene_with(member, part, 99))
    log, found = read_log(path), results_of(path)
    line = (
        f"rows of another configuration than {PAPER.config_id} (`config_id`): "
        f"{len(range(TICKS)[part])} of the {TICKS} of {member} (99)"
    )
    assert (log.complete, log.remarks, log.unjudged) == (False, [line], (line,))
    assert (found.complete, found.missing.count(line), found.within_bounds) == (False, 1, False)
    assert set(found.to_json()["verdicts"].values()) == {"not shown"}


def test_an_exceeded_bound_is_not_shown_either_where_the_figures_are_of_no_run(tmp_path: Path) -> None:
    strict = load_cell(configs.CELLS_DIR / "paper.toml", [*SHORT, "report.max_position_error_m=1e-6"])
    verdicts = [
        results_of(write_run(tmp_path / f"{k}.mcap", strict, rows)).to_json()["verdicts"]["max_position_error_m"]
        for k, rows in enumerate((scene(), scene_with("plant", slice(3, 9), 99)))
    ]
    assert verdicts == ["not met", "not shown"]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_says_in_one_line_that_rows_are_of_another_configuration(tmp_path: Path, command: str) -> None:
    log = write_run(tmp_path / "run.mcap", PAPER, scene_with("plant", slice(100, 300), 99))
    name, *words = command.replace("LOG", str(log)).split()
    done = coop(name, log, *words, cwd=tmp_path)
    said = [line for line in done.err.splitlines() if "rows of another configuration than" in line]
    assert len(set(said)) == 1
    assert said[0].endswith(f"200 of the {TICKS} of plant (99)")


def test_a_replay_finds_the_plants_rows_of_another_configuration(tmp_path: Path) -> None:
    rows = run(q=wandering, ticks=40).rows
    truth = np.zeros(len(rows), PLANT_STATE.dtype)
    for name in ("encapsulation", "sequence", "stamp_ns", "utc_ns", "t"):
        truth[name] = rows[name]
    path = write_run(tmp_path / "run.mcap", paper(), {"left": rows, "plant": truth})
    assert coop("replay", path).code == 0
    truth["config_id"][5:] = 99
    path = write_run(tmp_path / "mixed.mcap", paper(), {"left": rows, "plant": truth})
    done = coop("replay", path)
    assert done.code == 1
    assert f"plant        {len(rows)} rows looked at, {len(rows) - 5} are wrong" in done.out.splitlines()
    assert f"left         {len(rows)} rows replayed, all equal" in done.out.splitlines()
    found = json.loads(coop("replay", path, "--json").out)
    first = found["first_difference"]
    assert (found["equal"], first["arm"], first["row"], first["field"]) == (False, "plant", 5, "config_id")
    assert (first["recorded"], first["replayed"]) == (99, paper().config_id)
    assert coop("replay", path, "--arm", "left").code == 0, "of that arm alone"


@pytest.mark.parametrize(
    ("fingerprint", "recorder", "config_id"),
    [
        ("0000002a" + "f" * 56, {"config_id": "7"}, 42),
        (None, {"config_id": "7"}, 7),
        ("no number", {"config_id": "7"}, 7),
        (None, {}, None),
        (None, {"config_id": "9" * 5000}, None),
        (None, {"config_id": "²"}, None),
    ],
)
def test_which_configuration_a_log_is_of(fingerprint: object, recorder: dict[str, str], config_id: int | None) -> None:
    assert config_id_of(fingerprint, recorder) == config_id


def test_rows_of_two_configurations_are_found_where_nothing_tells_the_cells(tmp_path: Path) -> None:
    log = read_log(
        write_run(tmp_path / "run.mcap", PAPER, scene_with("right", slice(None), 99), left_out=("run.json",))
    )
    assert log.problems == (
        f"rows of another configuration than {PAPER.config_id} (`config_id`): {TICKS} of the {TICKS} of right (99)",
    )


# ---------------------------------------------------------------------------------------- with a number of another time


def numbered(rows: np.ndarray, **changes: int) -> np.ndarray:
    """By sequence, with other numbers: row_5=900 gives row 5 that one."""
    changed = rows.copy()
    for name, number in changes.items():
        changed["sequence"][int(name.removeprefix("row_"))] = number
    return changed[np.argsort(changed["sequence"])]


def late_rows(count: int = 60) -> np.ndarray:
    """As of a loop in real time, with late cycles, one stretch left out, and UTC of its own."""
    rows = agent_rows(count, first=100)
    late_ns = np.random.default_rng(3).integers(0, 7_000_000, count)
    late_ns[30:] += 400_000_000
    rows["stamp_ns"] = rows["sequence"].astype(np.int64) * 5_000_000 + late_ns
    rows["utc_ns"] = rows["stamp_ns"] + 1_800_000_000_123_456_789
    rows["t"] = rows["stamp_ns"] * 1e-9
    return rows


def steady_rows(count: int = 60) -> np.ndarray:
    """As of a loop in lockstep."""
    rows = late_rows(count)
    rows["stamp_ns"] = rows["sequence"].astype(np.int64) * 5_000_000
    rows["utc_ns"], rows["t"] = rows["stamp_ns"] + 1_800_000_000_000_000_000, rows["stamp_ns"] * 1e-9
    return rows


FAR = 1 << 32


@pytest.mark.parametrize("rows", [late_rows(), steady_rows()], ids=["real time", "lockstep"])
@pytest.mark.parametrize("row", [0, 1, 17, 58, 59])
@pytest.mark.parametrize("number", [FAR, 3000, 163])
def test_a_number_that_is_ahead_of_its_time_is_found_and_no_other(rows: np.ndarray, row: int, number: int) -> None:
    changed = numbered(rows, **{f"row_{row}": number})
    wrong, all_told = misnumbered(changed, AGENT_STATE, of_plant=False)
    assert (changed["sequence"][wrong].tolist(), all_told) == ([number], True)


def test_the_first_number_may_be_too_low() -> None:
    changed = numbered(steady_rows(), row_0=7)
    assert changed["sequence"][misnumbered(changed, AGENT_STATE, of_plant=False)[0]].tolist() == [7]


def test_numbers_in_a_gap_and_many_of_them_are_found() -> None:
    rows = np.delete(steady_rows(), range(20, 30))
    changed = numbered(rows, row_5=125, row_40=FAR, row_41=FAR + 1)
    wrong, all_told = misnumbered(changed, AGENT_STATE, of_plant=False)
    assert (changed["sequence"][wrong].tolist(), all_told) == ([125, FAR, FAR + 1], True)


def test_the_last_number_of_a_lockstep_run_is_found_one_too_high() -> None:
    changed = numbered(steady_rows(), row_59=160)
    assert changed["sequence"][misnumbered(changed, AGENT_STATE, of_plant=False)[0]].tolist() == [160]


@pytest.mark.parametrize("of_plant", [False, True])
def test_late_cycles_those_left_out_and_gaps_are_no_wrong_numbers(of_plant: bool) -> None:
    for rows in (late_rows(), np.delete(late_rows(), range(5, 25)), steady_rows(), late_rows(2), late_rows(0)):
        wrong, all_told = misnumbered(rows, AGENT_STATE, of_plant=of_plant)
        assert (len(wrong), all_told) == (0, True)


def test_a_plant_that_catches_up_with_real_time_has_no_wrong_numbers() -> None:
    truth = np.zeros(60, PLANT_STATE.dtype)
    truth["sequence"] = np.arange(60) * 4
    truth["stamp_ns"] = truth["sequence"].astype(np.int64) * 5_000_000
    truth["stamp_ns"][30:45] = truth["stamp_ns"][45]
    truth["stamp_ns"][45:] += 7
    truth["utc_ns"], truth["t"] = truth["stamp_ns"] + 123_456_789, truth["stamp_ns"] * 1e-9
    assert len(misnumbered(truth, PLANT_STATE, of_plant=True)[0]) == 0
    changed = numbered(truth, row_20=FAR)
    assert changed["sequence"][misnumbered(changed, PLANT_STATE, of_plant=True)[0]].tolist() == [FAR]


@pytest.mark.parametrize("names", [("stamp_ns",), ("t",), ("stamp_ns", "t")])
def test_a_time_that_is_wrong_makes_no_number_wrong(names: tuple[str, ...]) -> None:
    rows = steady_rows()
    for name in names:
        rows[name][20] = 0
    assert len(misnumbered(rows, AGENT_STATE, of_plant=False)[0]) == 0


def test_numbers_that_are_all_of_other_times_are_told_of_and_left(tmp_path: Path) -> None:
    rows = {name: own.copy() for name, own in scene().items()}
    rows["left"]["sequence"] = np.arange(TICKS)[::-1]
    log = read_log(write_run(tmp_path / "run.mcap", PAPER, rows))
    assert "the numbers of the rows of left do not go up with their times" in log.problems
    assert (len(log.agents["left"]), log.misnumbered, log.complete) == (TICKS, {}, False)


@pytest.mark.parametrize("rows", [late_rows(), steady_rows()], ids=["real time", "lockstep"])
def test_the_number_that_a_time_has(rows: np.ndarray) -> None:
    table = Table.of(np.delete(rows, 12))
    assert number_of(table, 112 * 5_000_000) == pytest.approx(112, abs=1)
    assert number_of(Table.of(rows[:1]), 0) == 100


def test_a_row_with_a_number_of_another_time_is_in_no_figure_and_makes_a_gap(tmp_path: Path) -> None:
    rows = {name: own.copy() for name, own in scene().items()}
    rows["left"]["sequence"][200] += FAR
    path = write_run(tmp_path / "run.mcap", PAPER, rows)
    log, found = read_log(path), results_of(path)
    line = "1 of the rows of left are left out: their numbers do not fit their times (the first: 4294967496 at 1.000 s)"
    assert (log.problems, log.gaps["left"], log.complete) == ((line,), ((200, 200),), False)
    assert log.misnumbered["left"]["sequence"].tolist() == [200 + FAR]
    assert (found.complete, found.missing.count(line), found.rows["left"].lost) == (False, 1, 1)
    assert (found.arms["left"].pace.due_cycles, found.arms["left"].pace.left_out_cycles) == (TICKS, 0)
    assert not any("no pose" in line for line in found.missing)


@pytest.mark.parametrize("byte", range(8))
def test_a_replay_finds_one_changed_byte_of_a_number(tmp_path: Path, byte: int) -> None:
    rows = run(q=wandering, ticks=40).rows.copy()
    rows["sequence"][20] ^= 64 << 8 * byte
    path = write_run(tmp_path / "run.mcap", paper(), {"left": rows})
    done = coop("replay", path, "--json")
    found = json.loads(done.out)
    first = found["first_difference"]
    assert (done.code, found["equal"], found["complete"], found["rows_compared"]) == (1, False, False, len(rows))
    assert (found["rows_different"], first["field"], first["replayed"]) == (1, "sequence", 20)
    assert first["recorded"] == 20 + (64 << 8 * byte)
    assert "do not fit their times" in found["notes"][0]
    assert json.loads(coop("replay", path, "--json", "--from", "0.15").out)["rows_different"] == 0


def test_a_stamp_that_is_wrong_between_two_gaps_makes_no_number_wrong() -> None:
    rows = np.delete(steady_rows(), [19, 21])
    rows["stamp_ns"][19] = 0
    assert len(misnumbered(rows, AGENT_STATE, of_plant=False)[0]) == 0


def test_no_number_of_a_damaged_row_becomes_a_count_of_cycles() -> None:
    rows = steady_rows()
    rows["sequence"][-1] = FAR
    assert Pace.of(Table.of(rows), 200.0) == Pace(60, 0)


def test_a_run_of_which_no_figure_is_its_own_is_no_better_and_no_worse(tmp_path: Path) -> None:
    rows = scene_with("plant", slice(None), 99)
    rows["plant"]["p_object"][:, 0] += 1e-4
    one = results_of(write_run(tmp_path / "a.mcap", PAPER, scene()))
    other = results_of(write_run(tmp_path / "b.mcap", PAPER, rows))
    changes = {d.name: d.change for d in compare(one, other)}
    assert changes["max_position_error_m"] is Change.DIFFERENT
    with pytest.raises(BoundsMissed, match="see the report"):
        require_bounds(other)
