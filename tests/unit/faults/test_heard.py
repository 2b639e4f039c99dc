"""Torques are held against each other bit by bit, and rows of a log against those that the arms wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.config.cell import load_cell
from agent.faults import heard as module
from agent.faults.heard import Heard, Kept, Torque, compared, heard, kept, left_out, undisturbed
from agent.faults.judge import RowResult
from agent.faults.listeners import Rehearsed
from agent.log.read import LogError, RunLog
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE

N = 3
TAU = np.random.default_rng(7).normal(size=(20, N))


def rows(tau: NDArray[np.float64]) -> NDArray[np.void]:
    found = np.zeros(len(tau), AGENT_STATE.dtype)
    found["tau_limited"][:, : tau.shape[1]] = tau
    found["sequence"], found["t"] = np.arange(len(tau)), 0.005 * np.arange(len(tau))
    return found


def log(complete: bool = True, agents: Any = (), plant: Any = None, **rejected: int) -> RunLog:
    told = {f"rejected.{why}": str(count) for why, count in rejected.items()}
    metadata = {"completeness": {"complete": "true", "left.refused": "3"} | told}
    return RunLog(Path("run.mcap"), "paper", dict(agents), plant, [], {}, metadata, complete, {})


def test_the_same_torque_is_the_same() -> None:
    assert compared(TAU, rows(TAU)) == Torque(20, None)
    assert compared(TAU, rows(TAU)).same


@pytest.mark.parametrize("row", [0, 11, 19])
@pytest.mark.parametrize("joint", [0, N - 1])
def test_one_bit_of_one_joint_is_found(row: int, joint: int) -> None:
    altered = TAU.copy()
    altered[row, joint] = np.nextafter(altered[row, joint], np.inf)
    found = compared(TAU, rows(altered))
    assert found == Torque(20, row, pytest.approx(0.005 * row))
    assert not found.same


def test_a_nan_is_no_torque_and_a_sign_of_zero_is_a_bit() -> None:
    for before, after in ((1.0, np.nan), (np.nan, 1.0), (0.0, -0.0)):
        expected, altered = TAU.copy(), TAU.copy()
        expected[4, 1], altered[4, 1] = before, after
        assert compared(expected, rows(altered)).differs_at == 4
    expected = TAU.copy()
    expected[4, 1] = np.nan
    assert compared(expected, rows(expected)).same


def test_rows_that_are_not_there_or_too_many_are_a_difference() -> None:
    assert compared(TAU, rows(TAU[:15])) == Torque(20, 15)
    assert compared(TAU[:15], rows(TAU)) == Torque(15, 15)
    assert compared(TAU, None) == Torque(20, 0)
    assert compared(TAU, rows(TAU[:0])) == Torque(20, 0)


def test_rows_of_a_log_are_counted_once_and_foreign_ones_told() -> None:
    own = rows(TAU)
    forged = own[3:5].copy()
    forged["tau_limited"] += 1.0
    unknown = rows(np.zeros((25, N)))[20:]
    first, second = log(agents={"left": own[:10]}), log(agents={"left": np.concatenate([own[5:12], forged, unknown])})
    assert kept(own, "left", [first]) == Kept(20, 10, 0)
    assert kept(own, "left", [first, second]) == Kept(20, 12, 7)
    assert kept(own, "left", [first]).missing == 10
    assert kept(own, "left", [log(agents={"right": own})]) == Kept(20, 0, 0)
    assert kept(own, "left", []) == Kept(20, 0, 0)
    truth = np.zeros(4, PLANT_STATE.dtype)
    truth["sequence"] = range(4)
    assert kept(truth, "plant", [log(plant=truth[:3]), log()]) == Kept(4, 3, 0)


def test_what_was_left_out_is_summed_over_the_logs() -> None:
    assert left_out([log(no_batch_header=3, unknown_key=1), log(no_batch_header=2)]) == {
        "no batch header": 5, "unknown key": 1,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("torque", "one", "complete", "verdict"),
    [
        (Torque(20, None), Kept(20, 20, 0), True, RowResult.MET),
        (Torque(20, None), Kept(20, 5, 0), False, RowResult.MET),
        (Torque(20, 3), Kept(20, 20, 0), True, RowResult.MISSED),
        (Torque(20, None), Kept(20, 20, 1), True, RowResult.MISSED),
        (Torque(20, None), Kept(20, 19, 0), True, RowResult.MISSED),
    ],
    ids=["undisturbed", "lacking and saying so", "a torque", "a foreign row", "lacking and called complete"],
)
def test_a_torque_a_foreign_row_and_a_log_that_is_not_true_are_a_miss(
    torque: Torque, one: Kept, complete: bool, verdict: RowResult
) -> None:
    fine = Torque(20, None), Kept(20, 20, 0)
    found = Heard({"left": fine[0], "right": torque}, {"left": fine[1], "right": one}, complete, (), {}, 0)
    assert found.verdict is verdict
    assert found.document()["verdict"] == verdict.value


def test_a_run_is_held_against_the_same_cell_which_nobody_disturbs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The undisturbed run is the cell's own; that it is a lockstep run's to the bit needs processes."""
    cell = load_cell(Path("paper"), ["duration_s=0.1", "simulation.ready_s=0.05", "controller.alignment.ready_per_s=0"])
    expected = undisturbed(cell)
    assert {arm: tau.shape for arm, tau in expected.items()} == {"left": (30, 3), "right": (30, 3)}
    assert not (expected["left"][0] == expected["left"][-1]).all()
    own = {arm: rows(tau) for arm, tau in expected.items()}
    logs = {"a": log(agents=own, unknown_key=2), "b": log(complete=False)}

    def read(path: Path) -> RunLog:
        if path.name not in logs:
            raise LogError(f"{path} holds no rows", found="nothing", expected="rows", remedy="take another")
        return logs[path.name]

    monkeypatch.setattr(module, "read_log", read)
    found = heard(Rehearsed(cell, (), own, (Path("a"),), 2))
    assert (found.verdict, found.complete, found.left_out, found.sent) == (RowResult.MET, True, {"unknown key": 2}, 2)
    assert not heard(Rehearsed(cell, (), own, (Path("a"), Path("b")), 0)).complete
    found = heard(Rehearsed(cell, (), own, (Path("a"), Path("c")), 0))
    assert not found.complete
    assert found.problems == ("c holds no rows: found nothing, expected rows; take another",)
    last = own["right"]["tau_limited"][21]
    last[2] = np.nextafter(last[2], np.inf)
    found = heard(Rehearsed(cell, (), own, (Path("a"),), 0))
    assert (found.verdict, found.torque["right"].differs_at) == (RowResult.MISSED, 21)
    assert found.torque["left"].same
    del own["right"]
    assert heard(Rehearsed(cell, (), own, (Path("a"),), 0)).torque["right"] == Torque(30, 0)
