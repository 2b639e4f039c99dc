"""`coop faults`: the list, and a rehearsal in words, as JSON and as a log that other commands read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from agent.cli.faults import _faults, _length
from agent.config.cell import load_cell
from agent.faults.catalogue import rows
from agent.faults.plan import NAMES
from agent.log.read import read_log
from agent.log.when import in_lockstep
from agent.modes import Mode
from agent.verify.check import examine
from tests.support.command import coop
from tests.support.pages import told

SHORT = ("--at", "0.1", "--duration", "0.5")


def test_the_list_has_every_row_and_every_fault() -> None:
    document = json.loads(coop("faults", "list", "--json").out)
    assert document["schema"] == 1
    assert [row["id"] for row in document["rows"]] == [row.id for row in rows()]
    assert [kind["name"] for kind in document["kinds"]] == list(NAMES)
    assert all(row["bound"] for row in document["rows"])
    keys = {"bound", "fails", "faults", "group", "id", "must", "never", "runs", "tests", "untested"}
    assert keys == set(document["rows"][0])
    faults = {row["id"]: row["faults"] for row in document["rows"] if row["faults"]}
    assert faults == {"P10": ["telemetry-off"], "N1": ["recorder-off"], "N2": ["recorder-stuck"]}
    table = coop("faults", "list").out
    assert all(f" {row.id} " in table for row in rows())
    kinds = coop("faults", "list", "--kinds").out
    assert all(f" {name} " in kinds for name in NAMES)


def test_a_rehearsal_says_who_noticed_who_stopped_and_what_it_cost(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    done = coop("faults", "inject", "paper_real", "bus-off", "--arm", "right", *SHORT, "--out", log, "--json")
    assert done.code == 0
    document = json.loads(done.out)
    assert set(document) <= told("commands.md")
    assert document["cell"] == "paper_real"
    assert document["faults"] == [{"fault": "bus-off", "arm": "right", "at_s": 0.1, "for_s": None}]
    assert document["noticed"].startswith("right: ")
    assert 0.0 <= document["noticed_s"] <= document["stopped_s"]["right"] <= 0.05
    assert document["internal_force_N"] > 0.0
    read = read_log(log)
    assert set(read.agents) == {"left", "right"}
    assert read.complete
    assert len(read.plant) > 50  # type: ignore[arg-type]
    assert not in_lockstep([read.plant, *read.agents.values()]), "each arm counts cycles of its own"
    assert Mode.HOLD in np.asarray(read.agents["right"]["mode"])
    events = [event.text for event in read.events]
    assert any(text.startswith("fault: bus-off") for text in events)
    assert any(text.startswith("holds: ") for text in events)
    again = coop("faults", "inject", "paper_real", "bus-off", "--out", log)
    assert again.code == 2
    assert "name another with --out" in again.err


def test_a_row_that_processes_alone_can_show_names_its_tests() -> None:
    done = coop("faults", "inject", "paper_real", "p9")
    assert done.code == 2
    assert coop("faults", "inject", "paper_real", "p9", "--at", "1").err == done.err
    found = next(row for row in rows() if row.id == "P9")
    assert done.err.startswith(f"coop: row P9, {found.fails}: found nothing of it in virtual time")
    assert done.err.rstrip().endswith(f"its tests show it, such as `pytest {found.tests[0]}`")
    assert all(row.runs or row.tests or row.untested for row in rows())


def test_a_row_of_the_list_can_be_let_happen_by_its_id() -> None:
    done = coop("faults", "inject", "paper_real", "m1", "--duration", "3.2")
    assert done.code == 0
    lines = done.out.splitlines()
    assert lines[0] == "fault             agent-garbage, arm left, at 3 s: what it computes with is no number"
    assert lines[1].startswith("noticed           after 0 ms (left: ")
    assert any(line.startswith("arm left          stopped after ") for line in lines)
    assert any(line.startswith("sag  ") and line.endswith(" mm") for line in lines)


@pytest.mark.parametrize(
    ("row", "words", "found", "named"),
    [
        ("B2", ("--arm", "left", "--at", "3", "--for", "1"), "--arm, --at, --for", "bus-off"),
        ("P10", ("--at", "0"), "--at", "telemetry-off"),
        ("M1", ("--servo", "4", "--size", "2"), "--servo, --size", "agent-garbage"),
    ],
)
def test_a_row_that_says_itself_when_and_whom_takes_no_other_word_of_it(
    row: str, words: tuple[str, ...], found: str, named: str
) -> None:
    done = coop("faults", "inject", "paper_real", row, *words)
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        f"coop: row {row}: found {found}, expected none of these: a row says when and whom itself; "
        f"name the fault in its place: {named}\n"
    )


@pytest.mark.long  # the row above is let happen by its id, too
def test_a_row_of_a_rehearsal_brings_its_arm_in_the_loop_along(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    done = coop("faults", "inject", "paper_real", "h5", "--duration", "2.13", "--out", log)
    assert done.code == 0, done.err
    assert "twin of arm left: found a plant that is gone" in done.out
    assert "arm from twin     0.00" in done.out
    rows = read_log(log).agents["left"]
    assert np.abs(rows["tau_bridge"]).max() > 0.01
    assert not rows["tau_bridge"][-1].any()


def test_a_motion_that_leaves_the_arms_reach_is_refused_before_anything_runs() -> None:
    far = ("--set", "trajectory.p_amplitude_m=[0.9, 0.0, 0.0]", "--set", "trajectory.ramp_s=0.1")
    done = coop("faults", "inject", "paper_real", "bus-off", "--at", "1", "--duration", "4", *far)
    assert done.code == 2
    assert "unreachable by" in done.err


def test_a_cell_that_check_refuses_is_not_rehearsed() -> None:
    heavy = ("two_wx200", "--set", "object.mass_kg=5")
    done = coop("faults", "inject", *heavy[:1], "servo-off", *heavy[1:])
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("coop: torque along the trajectory")
    assert coop("check", *heavy).code == 2


def test_check_refuses_no_cell_that_a_row_of_the_list_changes() -> None:
    """Else a person could not let the row happen by its id."""
    changed = {(run.cell, run.set) for row in rows() for run in row.runs if run.set}
    assert len(changed) > 5
    for cell, changes in sorted(changed):
        assert examine(load_cell(Path(cell), changes)).ok, changes


@pytest.mark.parametrize(("said_s", "at_s"), [(None, 3.0), (0.0, 0.0), (1.5, 1.5)])
def test_a_fault_of_which_no_instant_is_said_happens_at_three_seconds(said_s: float | None, at_s: float) -> None:
    (fault,), _ = _faults("bus-off", arm="left", servo=None, at_s=said_s, for_s=None, size=None)
    assert fault.at_s == at_s


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("--set", "duration_s=2"), "fault bus-off at 3 s: found a run of 2 s, expected an instant before its end"),
        (("--at", "101"), "fault bus-off at 101 s: found a run of 100 s, expected an instant before its end"),
        (
            ("--set", "duration_s=5", "--duration", "6"),
            "--duration: found --set duration_s=5 beside it, expected one of the two; leave one out",
        ),
    ],
)
def test_a_run_is_as_long_as_was_asked_and_never_longer_than_the_cell_s_for_an_instant_behind_it(
    asked: tuple[str, ...], said: str
) -> None:
    done = coop("faults", "inject", "paper_real", "bus-off", *asked)
    assert (done.code, done.out) == (2, "")
    assert said in done.err


def test_the_length_of_a_run_is_what_was_set_else_ends_behind_the_last_fault() -> None:
    cell, faults = Path("paper_real"), _faults("bus-off", at_s=3.0, for_s=0.5, arm=None, servo=None, size=None)[0]
    assert _length(cell, ["duration_s = 4"], faults, None) == [], "the cell has it already"
    assert _length(cell, [], faults, 120.0) == ["duration_s=120.0"]
    assert _length(cell, ["rate_hz=100"], faults, None) == ["duration_s=5.5"]
    reality, changes = _faults("S8", at_s=None, for_s=None, arm=None, servo=None, size=None)
    assert (reality, bool(changes)) == ((), True), "nothing befalls anybody: it is the arms that are otherwise"
    assert _length(cell, [], reality, None) == ["duration_s=5.0"]
