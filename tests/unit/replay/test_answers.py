"""`coop events`, `coop grasps` and `replay --same-as` on logs whose answers are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.log.read import open_log
from agent.replay.grasps import grasps
from agent.replay.same import same
from agent.replay.source import ReplayError
from agent.telemetry.row.event import Event, Level
from tests.support.command import coop
from tests.support.telemetry.log_maker import LogMaker, make_log
from tests.support.telemetry.run_log import flipped, write_other_release, write_run
from tests.support.telemetry.small_run import small_run
from tests.support.telemetry.synthetic_run import paper_rows, turn
from tests.support.telemetry.telemetry_cell import UTC_0_NS, make_rows

PAPER = load_cell(configs.CELLS_DIR / "paper.toml", ["arms.left.grip_force_max_N=5.0"])


def rows_of(side: float) -> np.ndarray:
    rows: np.ndarray = paper_rows(side, 400, np.random.default_rng(1))
    rows["utc_ns"] = 1_800_000_000_000_000_000 + rows["stamp_ns"]
    return rows


# events


def events_log(path: Path) -> Path:
    t = {"t": 31.005, "flag": "OFF_TRACK"}
    make_log(
        path,
        plant=False,
        events=[
            Event(7, "left", Level.WARN, "safety: off track", t),
            Event(8, "left", Level.WARN, "mode TRACK → HOLD", {"t": 31.01}),
            Event(9, "right", Level.INFO, "run ended"),
        ],
    )
    return path


def test_events_have_the_time_of_the_trajectory_or_of_the_day(tmp_path: Path) -> None:
    done = coop("events", events_log(tmp_path / "run.mcap"))
    assert (done.code, done.err) == (0, "")
    assert [line.split() for line in done.out.splitlines()] == [
        ["31.005", "s", "left", "WARN", "safety:", "off", "track"],
        ["31.010", "s", "left", "WARN", "mode", "TRACK", "→", "HOLD"],
        ["00:00:00Z", "right", "INFO", "run", "ended"],
    ]


def test_what_an_agent_tells_itself_stands_at_the_time_of_its_rows(tmp_path: Path) -> None:
    begun, waiting = make_rows("left", 100), make_rows("right", 100)
    begun["t"] -= 0.2  # the trajectory's zero is at 0.2 s of the clock
    waiting["t"] -= 86_400.0
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", begun)
    maker.write("right", waiting)
    for source in ("left", "right"):
        maker.event(Event(UTC_0_NS, source, Level.INFO, "torque on", {"stamp_ns": 50_000_000}))
    maker.event(Event(UTC_0_NS + 1, "left", Level.INFO, "run ended", {"stamp_ns": 1_200_000_000, "ticks": 7}))
    maker.event(Event(UTC_0_NS + 2, "right", Level.WARN, "safety: stale", {"sequence": 0, "t": -86_400.0}))
    maker.finish()
    document = json.loads(coop("events", tmp_path / "run.mcap", "--json").out)
    assert [e["t_s"] for e in document["events"]] == [pytest.approx(-0.15), None, pytest.approx(1.0), None]


def test_events_are_chosen_by_arm_and_time(tmp_path: Path) -> None:
    log = events_log(tmp_path / "run.mcap")
    assert coop("events", log, "--arm", "right").out.count("\n") == 1
    assert "HOLD" not in coop("events", log, "--to", "31.01").out
    later = coop("events", log, "--from", "31.01").out
    assert "HOLD" in later
    assert "off track" not in later
    document = json.loads(coop("events", log, "--json").out)
    assert [e["t_s"] for e in document["events"]] == [31.005, 31.01, None]
    assert document["events"][0]["data"]["flag"] == "OFF_TRACK"
    for silent in (("--arm", "plant"), ("--arm", "recorder"), ("--arm", "left", "--from", "99")):
        done = coop("events", log, *silent)
        assert (done.code, done.out, done.err) == (0, "", f"{log}: no event of these\n")
    done = coop("events", log, "--from", "9", "--to", "3")
    assert (done.code, done.err) == (
        2,
        "coop: Invalid value: no time between --from 9 and --to 3 (see `coop events -h`)\n",
    )


def test_a_log_without_events_says_so_whoever_is_asked_for(tmp_path: Path) -> None:
    make_log(log := tmp_path / "run.mcap", plant=False)
    for arm in ((), ("--arm", "left")):
        assert coop("events", log, *arm).err == f"{log}: no event at all\n"


@pytest.mark.parametrize(("name", "remedy"), [("lefft", "did you mean left?"), ("qqq", "name one of them")])
@pytest.mark.parametrize("form", [(), ("--json",)])
def test_a_name_that_nobody_in_the_log_has_is_refused(
    tmp_path: Path, name: str, remedy: str, form: tuple[str, ...]
) -> None:
    make_log(log := tmp_path / "run.mcap", events=[Event(7, "elsewhere", Level.INFO, "by another release")])
    known = "left, right, plant, recorder, elsewhere"
    done = coop("events", log, "--arm", "right", "--arm", name, *form)
    assert (done.code, done.out) == (2, "")
    assert done.err == f"coop: log {log}: found '{name}', expected one of {known}; {remedy}\n"
    assert coop("events", log, "--arm", "elsewhere").out.endswith("by another release\n")


def test_an_arm_of_the_cell_that_a_log_has_nothing_of_is_no_stranger(tmp_path: Path) -> None:
    log = write_run(tmp_path / "run.mcap", PAPER, {"left": rows_of(-1.0)})
    assert coop("events", log, "--arm", "right").code == 0


def test_the_loss_of_the_object_is_an_event_at_its_time_though_nobody_told_it(tmp_path: Path) -> None:
    run = small_run()
    run.plant["contact_error_m"][220:, 1] = np.nan
    run.plant["p_object"][240:, 2] -= 0.5
    maker = LogMaker(tmp_path / "run.mcap")
    for member, rows in {**run.agents, "plant": run.plant}.items():
        maker.write(member, rows)
    maker.event(Event(int(run.plant["utc_ns"][300]), "left", Level.INFO, "run ended", {"t": 1.5}))
    maker.finish()
    assert coop("events", tmp_path / "run.mcap").out.splitlines() == [
        "     1.100 s  plant      ERROR  the grasp of right is open",
        "     1.200 s  plant      ERROR  the object is lost",
        "     1.500 s  left       INFO   run ended",
    ]
    told = json.loads(coop("events", tmp_path / "run.mcap", "--arm", "plant", "--from", "1.15", "--json").out)
    assert [(e["t_s"], e["source"], e["text"]) for e in told["events"]] == [(1.2, "plant", "the object is lost")]


# grasps


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_arm_that_sees_the_object_elsewhere_is_found_by_three(tmp_path: Path, axis: int) -> None:
    """Two arms only disagree: each is half of it off their mean."""
    left, right = rows_of(-1.0), rows_of(1.0)
    left["p_object"], left["quat_object"] = right["p_object"], right["quat_object"]
    left["p_object"][:, axis] += 4e-3
    with open_log(write_run(tmp_path / "run.mcap", PAPER, {"left": left, "right": right})) as log:
        found = grasps(log, PAPER)
    assert not found.truth
    assert [g.offset_m for g in found.arms] == pytest.approx([2e-3, 2e-3])
    assert [g.offset_rad for g in found.arms] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_turned_picture_is_an_angle(tmp_path: Path) -> None:
    left, right = rows_of(-1.0), rows_of(1.0)
    left["p_object"] = right["p_object"]
    right["quat_object"] = turn(2, np.zeros(400))
    left["quat_object"] = turn(2, np.full(400, 8e-3))
    left["quat_object"][::2] *= -1.0  # the same rotation by its other name
    right["quat_object"][1::3] *= -1.0
    with open_log(write_run(tmp_path / "run.mcap", PAPER, {"left": left, "right": right})) as log:
        found = grasps(log, PAPER)
    assert [g.offset_rad for g in found.arms] == pytest.approx([4e-3, 4e-3], rel=1e-3)


def test_the_margin_is_the_grip_less_the_largest_force(tmp_path: Path) -> None:
    left, right = rows_of(-1.0), rows_of(1.0)
    left["wrench_cmd"][:, :3] = 0.0
    left["wrench_cmd"][200, :3] = [0.0, 3.0, -4.5]
    log = write_run(tmp_path / "run.mcap", PAPER, {"left": left, "right": right})
    document = json.loads(coop("grasps", log, "--json").out)
    force = np.hypot(3.0, 4.5)
    assert document["arms"]["left"]["force_max_N"] == pytest.approx(force)
    assert document["arms"]["left"]["margin_N"] == pytest.approx(5.0 - force)
    assert document["arms"]["right"]["margin_N"] is None
    done = coop("grasps", log)
    assert "against the mean of the arms" in " ".join(done.out.split())  # a long path wraps the line
    assert "two arms that disagree do not tell which one is off" in done.out


def test_a_log_may_be_called_what_a_table_would_take_for_a_style(tmp_path: Path) -> None:
    folder = tmp_path / "a [" / "] [bold]"
    folder.mkdir(parents=True)
    done = coop("grasps", write_run(folder / "r.mcap", PAPER, {"left": rows_of(-1.0), "right": rows_of(1.0)}))
    assert done.code == 0, done.err
    assert "a[/][bold]/r.mcap:against" in "".join(done.out.split()), "where it is folded is the terminal's width"


def test_a_run_without_a_common_tick_is_refused(tmp_path: Path) -> None:
    left, right = rows_of(-1.0), rows_of(1.0)
    right["mode"] = 3
    done = coop("grasps", write_run(tmp_path / "run.mcap", PAPER, {"left": left, "right": right}))
    assert (done.code, done.out) == (2, "")
    assert "no tick in which every arm follows the trajectory, expected some; take a run that got as far" in done.err


# the same


def two(folder: Path, a: np.ndarray, b: np.ndarray) -> tuple[Path, Path]:
    paths = (folder / "a.mcap", folder / "b.mcap")
    for path, rows in zip(paths, (a, b), strict=True):
        write_run(path, PAPER, {"left": rows})
    return paths


def test_runs_that_differ_in_timing_alone_are_the_same(tmp_path: Path) -> None:
    a = rows_of(-1.0)
    b = a.copy()
    b["step_s"] += 1e-4
    b["utc_ns"] += 5
    done = coop("replay", *two(tmp_path, a, b)[:1], "--same-as", tmp_path / "b.mcap")
    assert (done.code, done.err.count("no row of right is in it"), len(done.err.splitlines())) == (0, 2, 2)
    assert "left         400 rows in both, all equal but for timing\n" in done.out


def test_one_bit_makes_them_differ(tmp_path: Path) -> None:
    a = rows_of(-1.0)
    paths = two(tmp_path, a, flipped(a, 321, "memory", 8 * 50))
    done = coop("replay", paths[0], "--same-as", paths[1], "--json")
    document = json.loads(done.out)
    assert (done.code, document["equal"], document["rows_different"]) == (1, False, 1)
    first = document["first_difference"]
    assert (first["arm"], first["row"], first["field"], first["index"]) == ("left", 321, "memory", 50)
    said = coop("replay", paths[0], "--same-as", paths[1]).out
    assert "first difference: row 321 of left, t = 1.605 s, memory[50]: here " in said


def test_rows_that_only_one_has_make_them_differ(tmp_path: Path) -> None:
    a = rows_of(-1.0)
    paths = two(tmp_path, a, a[:390])
    for one, other in (paths, paths[::-1]):
        done = coop("replay", one, "--same-as", other)
        assert done.code == 1
        assert "left         390 rows in both, all equal but for timing; 10 only in one of the logs" in done.out


def test_of_an_arm_without_a_row_nothing_is_said_to_be_equal(tmp_path: Path) -> None:
    rows = rows_of(-1.0)
    log, other = write_run(tmp_path / "a.mcap", PAPER, {"left": rows, "right": rows[:0]}), tmp_path / "b.mcap"
    write_run(other, PAPER, {"left": rows, "right": rows})
    done = coop("replay", log, "--same-as", other)
    assert done.code == 1
    assert "right        no row in both; 400 only in one of the logs\n" in done.out
    assert "right        no row replayed\n" in coop("replay", log).out


def test_logs_without_anything_in_common_are_refused(tmp_path: Path) -> None:
    a = rows_of(-1.0)
    paths = two(tmp_path, a[:100], a[200:])
    old = write_other_release(tmp_path / "old.mcap", PAPER, {"left": a}, without=("shift",))
    with open_log(paths[0]) as one, open_log(paths[1]) as other, open_log(old, any_layout=True) as older:
        with pytest.raises(ReplayError, match="no row of the same arm and number"):
            same(one, other)
        with pytest.raises(ReplayError, match="other fields in"):
            same(one, older)


def test_a_member_that_only_one_has_makes_them_differ(tmp_path: Path) -> None:
    for name, has_plant in (("a", True), ("b", False)):
        maker = LogMaker(tmp_path / f"{name}.mcap", has_plant=has_plant)
        maker.write("left", make_rows("left", 20))
        if has_plant:
            maker.write("plant", make_rows("plant", 20))
        maker.finish()
    done = coop("replay", tmp_path / "a.mcap", "--same-as", tmp_path / "b.mcap")
    assert done.code == 1
    assert f"plant: only in {tmp_path / 'a.mcap'}" in done.err
