"""Monitors on real drivers and emulated servos that carry one object, in virtual time."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.modes import Mode
from agent.process.build import build_agent
from agent.replay.chain import Chain
from drivers.interface import JointState
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.servos.coupled_rig import ArmRun, CoupledRun


def cell(*overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", ["duration_s=0.8", *overrides])


READY_S = 0.05
LOW_SUPPLY = Fault(kind=FaultKind.VOLTAGE, arm="left", start_s=0.05, voltage_V=9.6)


@cache
def left_arm(fault: Fault) -> ArmRun:
    """What the left arm left of a run with this fault."""
    return CoupledRun(cell(), [fault], ready_s=READY_S).arms["left"]


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        pytest.param(
            Fault(kind=FaultKind.OVERHEAT, arm="left", servo=3, start_s=0.05, temperature_C=79.0),
            "monitor temperature: temperature of servo 3 (shoulder): found 79 °C, expected below 78 °C",
            id="S3 shadow servo hot",
            marks=pytest.mark.long,
        ),
        pytest.param(
            LOW_SUPPLY,
            "monitor voltage: supply of servo 1 (waist): found 9.6 V, expected 9.7 to 15.8 V",
            id="S3 supply low",
        ),
    ],
)
@pytest.mark.fault("S3")
def test_an_arm_holds_before_its_servo_switches_itself_off(fault: Fault, named: str) -> None:
    left = left_arm(fault)
    assert left.summary is not None
    assert left.summary.mode is Mode.HOLD
    assert named in left.summary.reason
    held = left.rows[left.rows["mode"] == Mode.HOLD]
    assert held["t"][0] < 0.8, "two readings, after every servo has been asked once"
    assert np.isfinite(held["tau_sent"][:, :3]).all(), "all servos still have torque"


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        pytest.param(
            Fault(kind=FaultKind.OVERLOAD, arm="left", servo=3, start_s=0.1),
            "servo 3 (shoulder)",
            id="S2 shadow",
        ),
        pytest.param(
            Fault(kind=FaultKind.ENCODER_OFFSET, arm="left", servo=4, start_s=0.1),
            "servo 4 (elbow)",
            id="S5 wrong by 5°",
        ),
    ],
)
@pytest.mark.fault("S5", "S2")
def test_what_the_driver_finds_holds_within_100_ms(fault: Fault, named: str) -> None:
    left = CoupledRun(cell("duration_s=0.3"), [fault], ready_s=READY_S).arms["left"]
    assert left.summary is not None
    assert left.summary.mode is Mode.HOLD
    assert named in left.summary.reason
    assert 0.1 < left.rows[left.rows["mode"] == Mode.HOLD]["t"][0] <= 0.2


def test_a_hold_of_a_monitor_is_replayed_from_the_rows_alone() -> None:
    run = left_arm(LOW_SUPPLY)
    assert {Mode.READY, Mode.TRACK, Mode.HOLD} <= set(run.rows["mode"].tolist())
    agent = build_agent(cell(), cell().arm("left"))
    chain = Chain(agent)
    chain.start()
    for row in run.rows:
        read = (row[name][:3].copy() for name in ("q_measured", "dq_measured", "tau_measured"))
        state = JointState(int(row["stamp_ns"]), *read)
        _, outcome = chain.pass_row(state, float(row["t"]), Mode(int(row["mode"])), int(row["flags"]))
        assert outcome.tau.tobytes() == row["tau_limited"][:3].tobytes()


def test_a_dead_encoder_is_found_while_the_motion_asks_for_a_turn() -> None:
    quick = cell("duration_s=0.6", "trajectory.period_s=2.5", "trajectory.ramp_s=0.2", "safety.noticing.enabled=false")
    fault = Fault(kind=FaultKind.ENCODER_STUCK, arm="left", servo=2, start_s=0.3)
    left = CoupledRun(quick, [fault], ready_s=READY_S).arms["left"]
    assert left.summary is not None
    assert "monitor frozen: reading of shoulder" in left.summary.reason


@pytest.mark.long  # without servos: test_cells_watched.py
@pytest.mark.parametrize(
    ("gravity", "held"),
    [pytest.param("[0.0, 0.0, -9.81]", False, marks=pytest.mark.long), ("[0.0, 0.0, 9.81]", True)],
)
@pytest.mark.fault("G6")
def test_measured_currents_contradict_a_wrong_gravity_before_the_start(gravity: str, held: bool) -> None:
    true, believed = cell("duration_s=0.1"), cell("duration_s=0.1", f"world.gravity_m_per_s2={gravity}")
    arms = CoupledRun(true, believed=believed, ready_s=1.7).arms
    anchor = arms["left"]
    assert anchor.summary is not None
    assert ("monitor gravity: torque at rest" in anchor.summary.reason) == held
    assert (Mode.TRACK in anchor.rows["mode"]) != held, "an arm that contradicts its files does not start"
