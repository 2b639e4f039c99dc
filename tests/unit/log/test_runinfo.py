"""What run.json says befell a simulated cell, and where a report says it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.log.columns import Table
from agent.log.runinfo import read_info
from agent.modes import Mode
from agent.process.describe import run_info
from agent.report.metrics import summarise
from agent.report.page import render
from agent.report.results_file import write_results
from agent.report.series import going_on
from tests.support.telemetry.synthetic_run import paper_run, run_file

TABLES = (
    "simulation.push=[{at_s=2.0, duration_s=0.5, force_N=[0.0, 1.0, 0.0]}]",
    "simulation.opening=[{at_s=3.0, arm='right'}]",
    "simulation.fault=[{kind='limp', arm='left', at_s=4.0}, {kind='hold', arm='right', at_s=4.5}]",
)
BEFELL = {
    "push 1": "at_s 2.0, duration_s 0.5, force_N [0.0, 1.0, 0.0], moment_Nm [0.0, 0.0, 0.0]",
    "opening 1": "at_s 3.0, arm right",
    "fault 1": "kind limp, arm left, at_s 4.0",
    "fault 2": "kind hold, arm right, at_s 4.5",
}


def test_a_report_lists_pushes_openings_and_faults_of_the_simulated_cell(tmp_path: Path) -> None:
    described = json.loads(run_info(load_cell(Path("paper"), TABLES), DriverKind.SIM, 0))
    log = paper_run(Path("run.mcap"), duration_s=21.0)
    assert read_info(log).befell == {}
    log.attachments["run.json"] = json.dumps(run_file(21.0, simulation=described["simulation"])).encode()
    assert read_info(log).befell == BEFELL
    page = render(write_results(log, tmp_path), (), ())
    for what, text in BEFELL.items():
        assert f"<tr><td>simulated {what}</td><td><code>{text}</code></td></tr>" in page


def test_an_arm_that_a_fault_lets_go_limp_or_stops_ends_no_count_while_there_is_another() -> None:
    log = paper_run(Path("run.mcap"), duration_s=21.0)
    faults = [("limp", "left", 20.5), ("hold", "left", 20.6), ("locked", "right", 20.2), ("open", "right", 20.3)]
    table = [{"kind": kind, "arm": arm, "at_s": at_s} for kind, arm, at_s in faults]
    log.attachments["run.json"] = json.dumps(run_file(21.0, simulation={"fault": table})).encode()
    info = read_info(log)
    assert info.struck_s == {"left": 20.5}
    arms = {name: Table.of(rows) for name, rows in log.agents.items()}
    left = log.agents["left"]
    left["mode"][left["t"] >= 20.4] = Mode.HOLD  # before it, by itself
    assert going_on(arms, info)["left"]["t"][-1] < 20.5 <= left["t"][-1]
    assert going_on(arms, info)["right"]["t"][-1] == left["t"][-1]
    assert summarise(log).by_plant.not_tracking_rows == 20  # type: ignore[union-attr]
    left["mode"][left["t"] < 20.5 - 1e-9] = Mode.TRACK
    assert summarise(log).by_plant.not_tracking_rows == 0  # type: ignore[union-attr]
    both = replace(info, struck_s={"left": 20.5, "right": 20.6})
    assert going_on(arms, both) is arms, "or nobody would see it fall"


@pytest.mark.parametrize("simulation", [[1], {"fault": 3}, {"fault": ["limp"]}])
def test_one_that_no_run_wrote_is_noted_and_fails_nothing(simulation: object) -> None:
    log = paper_run(Path("run.mcap"), duration_s=21.0)
    log.attachments["run.json"] = json.dumps(run_file(21.0, simulation=simulation)).encode()
    info = read_info(log)
    assert info.befell == {}
    assert "does not say what it should" in info.notes[0]
