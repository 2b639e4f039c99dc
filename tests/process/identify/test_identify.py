"""From a simulated run to a new arm file by the commands a person types; and the logs the command refuses.

The run is by the loop, the plant and the log's writer in this process, and so are the commands.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import configs
from agent.config.cell import cell_from_toml, load_cell
from tests.support.command import Done, coop
from tests.support.coop import PAPER
from tests.support.once import once
from tests.support.plant.plant_arm import run_one
from tests.support.telemetry.run_log import write_run

CELL = load_cell(  # half of its motion, which tells all apart; its period is 20 s
    configs.CELLS_DIR / "identify_wx200.toml", ("duration_s=28.0", "trajectory.motion_s=28.0")
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a whole run of the cell."""

    def make(folder: Path) -> None:
        rows = run_one(CELL, CELL.file.duration_s).rows
        write_run(folder / "run.mcap", CELL, {CELL.arms[0].name: rows})

    return once(tmp_path_factory, "identify-run", make)


@pytest.fixture(scope="module")
def found(run: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Done, Path]:
    """What `coop identify` says of it, and the folder that it has made."""
    new = tmp_path_factory.mktemp("identified") / "new"
    return coop("identify", run / "run.mcap", "--out", new, cwd=new.parent), new


def test_a_log_becomes_a_table_a_figure_and_an_arm_file_that_a_cell_can_use(found: tuple[Done, Path]) -> None:
    done, new = found
    assert done.code == 0, done.err
    assert "coulomb_Nm" in done.out
    assert done.out.count("replaced") == 9
    assert {path.name for path in new.iterdir()} == {"wx200.toml", "identify_wx200.png", "identify_wx200.json"}
    assert (new / "identify_wx200.png").read_bytes().startswith(b"\x89PNG")
    (new / "wx200.urdf").write_bytes((configs.ARMS_DIR / "wx200.urdf").read_bytes())
    after = cell_from_toml(CELL.toml, "the cell", new)
    assert after.fingerprint != CELL.fingerprint
    for old, found in zip(CELL.arms[0].servos, after.arms[0].servos, strict=True):
        assert found.coulomb_Nm.status == "measured"
        assert found.coulomb_Nm.value == pytest.approx(old.coulomb_Nm.value, rel=0.02)
        assert found.viscous_Nm_s_per_rad.value == pytest.approx(old.viscous_Nm_s_per_rad.value, rel=0.05)


def test_the_summary_is_complete(found: tuple[Done, Path]) -> None:
    summary = json.loads((found[1] / "identify_wx200.json").read_text())
    assert summary["fingerprint"] == CELL.fingerprint
    assert len(summary["base_parameters"]) == 17
    assert len(summary["figures"]) == 9
    for joint in summary["joints"]:
        assert joint["rms_residual_Nm"] < 0.02 * joint["rms_torque_Nm"] + 2e-3


def test_a_log_of_several_arms_is_refused_in_one_line_and_nothing_is_written(
    paper_runs: tuple[Path, Path], tmp_path: Path
) -> None:
    done = coop("identify", paper_runs[0] / "run.mcap", "--out", "new", cwd=tmp_path)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "found 2 arms on one object" in done.err
    assert not (tmp_path / "new").exists()


def test_a_log_that_was_cut_is_refused_in_one_line(run: Path, tmp_path: Path) -> None:
    whole = (run / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    done = coop("identify", "cut.mcap", cwd=tmp_path)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "expected a complete log" in done.err


@pytest.mark.long  # `coop tune` is in tests/unit/cli and tests/unit/verify
def test_gains_are_proposed_and_written_and_pass_the_check(tmp_path: Path) -> None:
    slow = ("--set", "rate_hz=120.0")
    assert coop("check", PAPER, *slow, cwd=tmp_path).code == 2
    done = coop("tune", PAPER, *slow, "--write", "slow.toml", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "k_p_per_s = " in done.out
    checked = coop("check", "slow.toml", cwd=tmp_path)
    assert checked.code == 0, checked.err
    warned = [line for line in checked.out.splitlines() if line.startswith("warning: ")]
    other = ("warning: this arm ", "warning: what tells arms apart")  # no gains lift what motors cannot
    assert all(line.startswith(other) for line in warned)
