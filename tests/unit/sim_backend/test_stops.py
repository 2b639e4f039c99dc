"""End stops of an arm on its own: hard enough, they give no energy, and before them an arm feels nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config import floating
from agent.config.cell import load_cell
from agent.process.simulated import lone_spec
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.interface import END_STOP_RAD, Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.lone import LoneArm
from sim_backend.physics.spec import PlantSpec
from sim_backend.physics.stops import BEFORE_RAD, EndStops
from tests.support.few import long
from tests.support.plant.plant_cells import planar_cell, spatial_cell
from tests.support.starts import start_joints

H = 1e-3
STOP, INERTIA = 1.0, 0.05


def bounce(speed: float, torque: float, steps: int, inertia: float = INERTIA) -> tuple[Vector, Vector, Vector]:
    """Angle, speed and energy, that in the stop too, of a joint that begins half a step's way before its stop."""
    stops = EndStops(np.array([-STOP - BEFORE_RAD]), np.array([STOP + BEFORE_RAD]), np.array([INERTIA]), H)
    q, dq, rows = np.array([STOP - 0.5 * H * speed]), np.array([speed]), []
    for _ in range(steps):
        D, f = stops.torque(q) or (np.zeros(1), np.zeros(1))
        a = (torque + f - D * dq) / (inertia + 0.5 * H * D)
        q, dq = q + H * (dq + 0.5 * H * a), dq + H * a
        stored = 0.5 * stops._stiffness * np.maximum(q - STOP, 0.0) ** 2
        rows.append((q[0], dq[0], (0.5 * inertia * dq**2 + stored - torque * q)[0]))
    return tuple(np.array(rows).T)  # type: ignore[return-value]


@pytest.mark.parametrize("inertia", [0.25 * INERTIA, INERTIA, 4.0 * INERTIA], ids=["a quarter", "as told", "fourfold"])
@pytest.mark.parametrize("torque", [0.0, 2.0])
def test_a_joint_that_hits_its_stop_loses_energy_and_stays(inertia: float, torque: float) -> None:
    q, dq, energy = bounce(7.0, torque, 1000, inertia)
    moving = 0.5 * inertia * 7.0**2
    assert energy[-1] <= energy[0] - 0.9 * moving
    rises, beyond = np.diff(energy), q[:-1] > STOP
    assert rises[beyond].max() <= 1e-12, "none comes back from the stop"
    assert rises.max() <= 0.04 * moving, "a step into it stores this much at most"
    assert STOP + 5e-3 < q.max() < STOP + (0.02 if inertia <= INERTIA else 0.045)
    assert dq.min() > -0.35 * 7.0
    if torque:
        assert q[-1] == pytest.approx(STOP + torque / (INERTIA * 200.0**2), abs=1e-6), "leaning on its spring"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_stop_pushes_back_on_either_side_and_on_its_joint_alone(side: float) -> None:
    limits = np.array([STOP, 3.0]) + 0.01
    stops = EndStops(-limits, limits, np.array([INERTIA, INERTIA]), H)
    acting = stops.torque(np.array([side * (STOP + 0.01), 2.99]))
    assert acting is not None
    D, f = acting
    np.testing.assert_allclose(f, [-side * 0.01 * INERTIA * 200.0**2, 0.0])
    np.testing.assert_allclose(D, [INERTIA * (H * 200.0**2 + 2.0 * 200.0), 0.0])
    assert stops.torque(np.array([side * STOP, -3.0])) is None


@pytest.mark.parametrize("spec", [planar_cell(ActuatorSpec.of(3)), spatial_cell(2, ActuatorSpec.of(6))])
@pytest.mark.parametrize("seed", range(3))
def test_an_arm_that_swings_into_its_stops_gains_nothing(spec: PlantSpec, seed: int) -> None:
    arm = LoneArm(spec, 0)
    low, high = arm._free.model.lowerPositionLimit, arm._free.model.upperPositionLimit
    arm.dq[:] = np.random.default_rng(seed).uniform(-5.0, 5.0, len(arm.q))
    before, most, hits = energy(arm), 0.0, 0
    for _ in range(1500):
        arm.advance(np.zeros_like(arm.q))
        beyond = float((arm.q - np.clip(arm.q, low, high)).__abs__().max())
        most, hits = max(most, beyond), hits + (beyond > 0.0)
    assert hits > 0
    assert most < END_STOP_RAD
    assert energy(arm) < before - 0.1


def energy(arm: LoneArm) -> float:
    M = np.triu(arm._touched.terms(arm.q, arm.dq)[0])
    M += np.triu(M, 1).T
    return 0.5 * float(arm.dq @ M @ arm.dq) + arm._touched.potential(arm.q)


def test_before_its_stops_an_arm_moves_as_one_without_stops_bit_for_bit() -> None:
    spec = spatial_cell(2, ActuatorSpec.of(6, coulomb_Nm=0.05, viscous_Nms_rad=0.03))
    one, other = LoneArm(spec, 0), LoneArm(spec, 0)
    other._stops = EndStops(np.full(6, -np.inf), np.full(6, np.inf), np.ones(6), spec.substep_s)
    for k in range(200):
        for arm in (one, other):
            arm.advance(0.5 * np.sin(0.05 * k + np.arange(6.0)))
    assert np.abs(one.q - spec.arms[0].q_start).max() > 0.05
    np.testing.assert_array_equal(one.q, other.q)
    np.testing.assert_array_equal(one.dq, other.dq)


@pytest.mark.parametrize("name", ["two_wx200", long("three_wx250s")])
def test_an_arm_that_fell_without_torque_can_be_started_again(name: str) -> None:
    cell = load_cell(Path(name))
    for start in ([0.0, 0.0, 0.0], [0.3, -0.4, 0.2]):
        spec = lone_spec(cell, start_joints(cell))
        bent = replace(spec.arms[0], q_start=spec.arms[0].q_start + np.resize(start, len(spec.arms[0].q_start)))
        arm = LoneArm(replace(spec, arms=(bent, *spec.arms[1:])), 0)
        for _ in range(4000):
            arm.advance(np.zeros_like(arm.q))
        assert not floating.outside(cell, cell.arms[0], arm.q)
        for q, servo in zip(arm.q, cell.arms[0].servos, strict=True):
            low, high = (TICK_RAD * (tick - servo.zero_tick) for tick in servo.position_limit_ticks)
            assert low < q < high, "as the driver wants it, too"
