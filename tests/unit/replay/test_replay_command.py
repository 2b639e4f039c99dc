"""`coop replay`: its words, its JSON and its exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from tests.support.command import coop
from tests.support.plant.plant_arm import run_one
from tests.support.telemetry.run_log import write_run

CELL = load_cell(configs.CELLS_DIR / "identify_wx200.toml")
ARM = CELL.arms[0].name


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    found: np.ndarray = run_one(CELL, 0.3).rows
    return found


@pytest.fixture
def log(tmp_path: Path, rows: np.ndarray) -> Path:
    return write_run(tmp_path / "run.mcap", CELL, {ARM: rows})


def test_all_equal_is_said_and_is_exit_code_0(log: Path, rows: np.ndarray) -> None:
    for words in (("--verify",), (), ("--arm", ARM)):
        done = coop("replay", log, *words)
        assert (done.code, done.err) == (0, "")
        assert done.out == f"{ARM:<12} {len(rows)} rows replayed, all equal\n"


def test_the_document_counts_rows(log: Path) -> None:
    done = coop("replay", log, "--verify", "--row", "50", "--json")
    assert (done.code, done.err) == (0, "")
    document = json.loads(done.out)
    assert (document["schema"], document["equal"], document["log"]) == (1, True, str(log))
    assert (document["rows_compared"], document["rows_different"], document["first_difference"]) == (10, 0, None)
    assert document["arms"][ARM]["rows_compared"] == 10


def test_a_difference_is_named_and_is_exit_code_1(tmp_path: Path, rows: np.ndarray) -> None:
    changed = rows.copy()
    changed["q_measured"][20, 1] = np.nextafter(changed["q_measured"][20, 1] + 1e-9, 9.0)
    log = write_run(tmp_path / "changed.mcap", CELL, {ARM: changed})
    done = coop("replay", log, "--verify")
    assert done.code == 1
    assert f"first difference: row 20 of {ARM}, t = 0.100 s, q[1]: recorded " in done.out
    assert ", replayed " in done.out
    document = json.loads(coop("replay", log, "--json").out)
    assert not document["equal"]
    assert document["rows_different"] == 1
    first = document["first_difference"]
    assert (first["arm"], first["row"], first["field"], first["index"]) == (ARM, 20, "q", 1)
    assert first["recorded"] == rows["q"][20, 1]
    assert first["replayed"] != first["recorded"]
    assert 0.0 < document["arms"][ARM]["max_torque_difference_Nm"] < 1e-3


def test_a_difference_as_small_as_rounding_is_called_so(tmp_path: Path, rows: np.ndarray) -> None:
    changed = rows.copy()
    changed["tau_limited"][7, 0] = np.nextafter(changed["tau_limited"][7, 0], 9.0)
    done = coop("replay", write_run(tmp_path / "changed.mcap", CELL, {ARM: changed}))
    assert done.code == 1
    assert "differences of this size are rounding" in done.out


def test_a_cut_log_replays_and_says_that_it_is_cut(log: Path) -> None:
    log.write_bytes(log.read_bytes()[:-200])
    done = coop("replay", log)
    assert done.code == 0
    assert "all equal" in done.out
    assert f"{log}: the file ends without its index" in done.err
    assert not json.loads(coop("replay", log, "--json").out)["complete"]


def test_a_change_is_shown_with_figures(log: Path, tmp_path: Path) -> None:
    picture = tmp_path / "torque.png"
    done = coop("replay", log, "--set", "object.mass_kg=0.5", "--picture", picture)
    assert done.code == 0, done.err
    assert [line.split()[:2] for line in done.out.splitlines() if "N·m" in line] == [
        [ARM, joint] for joint in CELL.arms[0].entry.controlled
    ]
    assert done.err == f"picture  {picture}\n"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert coop("replay", log, "--set", "object.mass_kg=0.5", "--picture", picture).code == 2
    assert coop("replay", log, "--set", "object.mass_kg=0.5", "--picture", picture, "--force").code == 0


def test_the_document_of_a_change_has_a_figure_for_each_joint(log: Path) -> None:
    done = coop("replay", log, "--set", "object.mass_kg=0.5", "--json")
    document = json.loads(done.out)
    assert document["set"] == ["object.mass_kg=0.5"]
    joints = document["arms"][ARM]["joints"]
    assert list(joints) == CELL.arms[0].entry.controlled
    assert all(f["max_difference_Nm"] >= f["rms_difference_Nm"] > 0.0 for f in joints.values())


@pytest.mark.parametrize(
    "words",
    [
        ("--verify", "--set", "object.mass_kg=0.5"),
        ("--from", "1", "--row", "3"),
        ("--picture", "x.png"),
        ("--row", "-1"),
        ("--arm", "nobody"),
        ("--set", "object.mass_kg"),
    ],
    ids=" ".join,
)
def test_what_does_not_go_together_is_one_line(log: Path, words: tuple[str, ...]) -> None:
    done = coop("replay", log, *words)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
