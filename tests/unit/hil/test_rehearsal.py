"""Rehearsals as a whole: the real driver on emulated servos of lone arms, the bridge, loops, and a plant; virtual time.

`make hil` has the long ones: every cell, all arms in the loop, arms that are otherwise than their files say.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.identify.recording import IdentifyError, from_rows
from agent.log.read import open_log
from agent.modes import Mode
from agent.process.build import passed_on
from agent.process.simulated import actuator_spec
from agent.replay.rows import Window
from agent.replay.source import recorded_cell
from agent.replay.verify import verify
from agent.report.metrics import summarise
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.hil.rehearsal import Rehearsal
from tests.support.telemetry.run_log import write_run
from tests.support.telemetry.synthetic_run import as_log, run_file

FROM_S = 0.5
FAULT_S = 0.4
READY_S = 0.5  # in which the coupling begins: hil.ramp_s is 0.2
OFF = "simulation.reality.arms.left={friction=1.5,masses=1.1,torque_constant=[0.9,0.9,0.9]}"


def cell(*changes: str, real: bool = True) -> Cell:
    loop = ('hil.arms=["left"]',) if real else ()
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", ["duration_s=1.4", *loop, *changes])


@cache
def plain() -> Rehearsal:
    return Rehearsal(cell(), ready_s=READY_S)


def test_an_arm_in_the_loop_carries_as_the_simulated_cell_does() -> None:
    error_mm, force_N = Rehearsal(cell("duration_s=1.0", real=False), ready_s=READY_S).figures(FROM_S)
    error, force = plain().figures(FROM_S)
    assert error <= 1.5 * error_mm
    assert force <= 1.5 * max(force_N, 0.1)
    assert {run.summary.mode for run in plain().arms.values() if run.summary} == {Mode.TRACK}


@pytest.mark.long  # `make hil` has more of them
def test_an_arm_that_is_otherwise_than_its_file_shows_as_in_the_simulated_cell() -> None:
    error_mm, force_N = Rehearsal(cell(OFF, real=False)).figures(FROM_S)
    error, force = Rehearsal(cell(OFF)).figures(FROM_S)
    assert error_mm > 0.4, "it shows at all"
    assert error == pytest.approx(error_mm, rel=0.15)
    assert force == pytest.approx(force_N, rel=0.15)


def test_every_row_says_what_was_added_and_the_sum_is_what_was_sent_to_one_count() -> None:
    made = plain()
    arm, rows = made.cell.arms[0], made.arms["left"].rows
    spec, n = actuator_spec(made.cell, arm), arm.n
    added, limited, sent = (rows[name][:, :n] for name in ("tau_bridge", "tau_limited", "tau_sent"))
    lsb = spec.torque_lsb_Nm
    assert np.all(np.abs(sent - np.clip(limited + added, -spec.tau_max_Nm, spec.tau_max_Nm)) <= lsb)
    assert np.abs(added).max() > 0.02
    hil = made.cell.file.hil
    assert hil is not None
    assert np.all(np.abs(added) <= hil.tau_share * spec.tau_max_Nm + 1e-12)
    assert np.all(np.abs(sent) <= spec.tau_max_Nm + lsb)
    coupled = rows["twin_age_s"] < 1.0
    assert coupled.sum() > 300
    assert np.abs(rows["q_twin"] - rows["q_measured"])[coupled].max() < 0.02
    simulated = made.arms["right"].rows
    for name in ("tau_bridge", "q_twin", "twin_age_s"):
        assert not simulated[name].any(), "an arm that is not in the loop has none"


def test_a_guard_is_handed_the_real_arm_and_nothing_of_its_twin() -> None:
    driver = plain().arms["left"].bridge
    assert driver is not None
    fds, told = passed_on(driver)
    assert fds == ()
    assert told == passed_on(driver.real)[1]
    assert len(told["servos"]) == 7


@pytest.mark.long  # tests/unit/hil/test_bridge.py says what is added
def test_cycles_without_a_state_also_say_what_was_sent() -> None:
    faults = [Fault(kind=FaultKind.DROP, arm="left", probability=0.02, start_s=0.1)]
    made = Rehearsal(cell("duration_s=0.6"), faults=faults)
    rows, arm = made.arms["left"].rows, made.cell.arms[0]
    spec = actuator_spec(made.cell, arm)
    stale = np.isnan(rows["q_measured"][:, 0])
    assert stale.any()
    wanted = rows["tau_limited"][:, : arm.n] + rows["tau_bridge"][:, : arm.n]
    assert np.all(np.abs(rows["tau_sent"][:, : arm.n] - wanted) <= spec.torque_lsb_Nm)


@pytest.mark.fault("H5")
def test_a_plant_that_is_killed_holds_the_real_arm_within_25_ms_where_it_is() -> None:
    motion: list[tuple[float, Any, float]] = []

    def kill(run: Rehearsal) -> None:
        run.plant.killed = True
        run.watch(lambda t, lone: motion.append((t, lone.end_effector().translation.copy(), np.abs(lone.dq).max())))

    run = Rehearsal(cell("duration_s=0.6"), happenings={FAULT_S: kill}, ready_s=READY_S).arms["left"]
    assert run.summary is not None
    assert run.summary.mode is Mode.HOLD
    assert "twin of arm left" in run.summary.reason
    held = run.rows[run.rows["mode"] == Mode.HOLD]
    assert held["t"][0] - FAULT_S <= 0.025 + 1e-9
    places = np.array([place for _, place, _ in motion])
    assert np.linalg.norm(places - places[0], axis=1).max() <= 5e-3
    assert max(speed for *_, speed in motion) <= 0.5
    assert not held["tau_bridge"][-1].any()


@pytest.mark.fault("H2", "H3")
def test_the_port_of_the_real_arm_lost_lets_the_twin_go_limp_with_its_servos() -> None:
    lost = {FAULT_S: lambda run: setattr(run.ports["left"], "lost", True)}
    made = Rehearsal(cell("duration_s=0.9"), happenings=lost, ready_s=READY_S)
    limp_ns = made.plant.seats["left"].limp_ns
    assert limp_ns is not None
    assert made.zero_ns is not None
    assert (limp_ns - made.zero_ns) * 1e-9 == pytest.approx(FAULT_S + 0.2, abs=0.012)
    summary = made.arms["right"].summary
    assert summary is not None
    assert summary.mode is Mode.HOLD
    assert "neighbour is limp" in summary.reason


@cache
def touched() -> tuple[Rehearsal, list[tuple[float, float]]]:
    """5 N for 0.3 s, upwards; and how far arm and twin were apart."""
    apart: list[tuple[float, float]] = []

    def begin(run: Rehearsal) -> None:
        run.lone("left").touch(np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0]))
        run.watch(lambda t, _: apart.append((t, run.apart_m("left"))) if round(t * 1e3) % 5 == 0 else None)

    def end(run: Rehearsal) -> None:
        run.lone("left").touch(np.zeros(6))

    return Rehearsal(cell("duration_s=1.8"), happenings={FAULT_S: begin, FAULT_S + 0.3: end}, ready_s=READY_S), apart


@pytest.mark.fault("H4")
def test_a_touch_parts_arm_and_twin_by_less_than_30_mm_and_nobody_holds() -> None:
    made, apart = touched()
    assert 2e-3 < max(gap for _, gap in apart) <= 30e-3
    assert max(gap for t, gap in apart if t > FAULT_S + 1.3) < 1e-3
    bridge = made.arms["left"].bridge
    assert bridge is not None
    assert (bridge.touches, bridge.coupling.touch.share, bridge.coupling.alive) == (1, 0.0, 1.0)
    assert {run.summary.mode for run in made.arms.values() if run.summary} == {Mode.TRACK}
    t, felt = (made.arms["right"].rows[name] for name in ("t", "unexpected"))
    assert np.nanmax(np.abs(felt[(t > FAULT_S) & (t < 1.8), 0])) < 0.6, "its partner feels next to nothing"


@pytest.mark.fault("H4")
def test_rows_of_a_touched_arm_say_how_far_it_was_from_its_twin_and_replay_bit_for_bit(tmp_path: Path) -> None:
    made, apart = touched()
    rows, arm = made.arms["left"].rows, made.cell.arms[0]
    model = made.cell.model(arm)
    places = [[model.object_pose(q).translation for q in rows[name][:, : arm.n]] for name in ("q_twin", "q_measured")]
    at, truly_m = np.array(apart).T
    said_m = np.interp(at, rows["t"], np.linalg.norm(np.subtract(*places), axis=1))
    assert np.abs(said_m - truly_m).max() < min(1.2e-3, truly_m.max() / 2.0), "but for counts, which are 0.6 mm each"
    path = write_run(tmp_path / "run.mcap", made.cell, {"left": rows})
    with open_log(path) as log:
        assert verify(log, recorded_cell(log), Window(), "left").equal


@pytest.mark.fault("H7")
def test_an_arm_with_the_object_in_its_gripper_is_held_before_anything_is_coupled() -> None:
    heavy = cell("duration_s=0.1", "object.mass_kg=0.25")
    weight = np.array([0.0, 0.0, -0.25 * 9.81, 0.0, 0.0, 0.0])
    made = Rehearsal(heavy, begin=lambda run: run.lone("left").touch(weight), give_up_s=1.0)
    assert made.plant.tick < 0, "the plant has not started"
    run = made.arms["left"]
    assert run.summary is not None
    assert "gripper of arm left" in run.summary.reason
    assert "of the object's weight in it" in run.summary.reason
    assert not run.rows["tau_bridge"].any()


def test_figures_of_the_law_are_without_the_addition() -> None:
    """The report of the arm in the loop beside that of the simulated cell."""
    made = plain()
    rows = made.arms["left"].rows
    content = run_file(1.4, 200.0, transient_s=0.5)
    log = as_log(Path("run.mcap"), {"left": rows}, None, content)
    found = summarise(log).arms["left"]
    law = (rows["tau_sent"] - rows["tau_bridge"])[rows["t"] >= 0.0, :3]  # the report is of the motion
    for joint, r in enumerate(found.joints.values()):
        assert r.peak_torque_Nm == pytest.approx(np.nanmax(np.abs(law[:, joint])))
    assert found.hil is not None
    assert 0.005 < found.hil.added_max < 0.5
    assert found.hil.apart_max_rad < 0.02


def test_the_log_of_a_rehearsal_is_replayed_bit_for_bit_and_cannot_be_identified_from(tmp_path: Path) -> None:
    made = plain()
    path = write_run(tmp_path / "run.mcap", made.cell, {"left": made.arms["left"].rows})
    with open_log(path) as log:
        verdict = verify(log, recorded_cell(log), Window(), "left")
        rows = log.agents["left"]
        with pytest.raises(IdentifyError, match="an arm in the loop"):
            from_rows(made.cell, made.cell.arms[0], rows)
    assert (verdict.rows, verdict.different) == (len(made.arms["left"].rows), 0)
    assert verdict.equal
