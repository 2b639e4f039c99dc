"""Dry friction inside both plants, and the arm-file keys that ask for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.config.schema.arm import Figure, PositiveFigure, Provenance, ServoJoint
from agent.process.simulated import plant_spec
from drivers.dynamixel.servo.counts import VELOCITY_UNIT_RAD_PER_S
from sim_backend.physics.build import build_plant
from sim_backend.physics.friction import PRESLIDING_RAD, FrictionSpec
from sim_backend.physics.spec import GraspSpec, PlantError, PlantSpec
from tests.support.plant.plant_cells import planar_cell
from tests.support.starts import start_joints
from tests.unit.sim_backend.test_plant import holding_torque

ONE = np.ones(3)
STICKY = FrictionSpec(0.06 * ONE, 0.03 * ONE, ONE, ONE, 0 * ONE, 0 * ONE, 0.02 * ONE)


def sticky(grasp: GraspSpec | None) -> PlantSpec:
    spec = planar_cell()
    return replace(spec, arms=tuple(replace(a, friction=STICKY) for a in spec.arms), grasp=grasp)


@pytest.mark.parametrize("grasp", [None, GraspSpec(1e4, 50.0)], ids=["welds", "pads"])
def test_joints_stand_under_jitter_below_breakaway_and_move_above(grasp: GraspSpec | None) -> None:
    spec = sticky(grasp)
    plant, rng = build_plant(spec), np.random.default_rng(2)
    tau, _ = holding_torque(spec)
    start = plant.q
    for _ in range(100):
        plant.advance(tau + rng.uniform(-0.04, 0.04, 6), 5)
    assert float(np.abs(plant.q - start).max()) < 3 * PRESLIDING_RAD
    assert float(np.abs(plant.dq).max()) < VELOCITY_UNIT_RAD_PER_S
    plant.advance(tau + 0.05, 200)
    seen = plant.observe(tau + 0.05)
    assert float(np.abs(seen.tau_friction).max()) < 0.12
    plant.advance(tau + np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]), 200)
    moved = plant.observe(tau)
    assert float(np.abs(moved.q - start).max()) > 20 * PRESLIDING_RAD
    assert float(np.max(moved.tau_friction * moved.dq)) <= 1e-6


@pytest.mark.parametrize("grasp", [None, GraspSpec(1e4, 50.0)], ids=["welds", "pads"])
@pytest.mark.parametrize(("load", "moves"), [(0.5, False), (0.0, True)])
def test_a_joint_rubs_the_more_the_more_its_motor_gives(grasp: GraspSpec | None, load: float, moves: bool) -> None:
    rubs = replace(STICKY, breakaway_Nm=0 * ONE, load=load * ONE)
    spec = replace(planar_cell(names=("left",)), gravity=np.zeros(3), grasp=grasp)
    plant = build_plant(replace(spec, arms=(replace(spec.arms[0], friction=rubs),)))
    start = plant.q
    plant.advance(np.array([0.0, 0.0, 0.1]), 400)  # 0.06 N·m, and half of 0.1
    assert bool(np.abs(plant.q - start).max() > 20 * PRESLIDING_RAD) is moves


@pytest.mark.parametrize("grasp", [None, GraspSpec(1e4, 50.0)], ids=["welds", "pads"])
def test_braked_joints_creep_only(grasp: GraspSpec | None) -> None:
    plant = build_plant(sticky(grasp))
    for arm in plant.spec.names:
        plant.brake(arm, 1e4)
    start = plant.q
    plant.advance(np.full(6, 2.0), 200)
    assert float(np.abs(plant.q - start).max()) < 1e-3


def test_friction_of_another_number_of_joints_is_refused() -> None:
    arm = planar_cell().arms[0]
    two = FrictionSpec(*(getattr(STICKY, k)[:2] for k in STICKY.__dataclass_fields__))
    with pytest.raises(PlantError, match="friction"):
        replace(arm, friction=two)


def keyed(cell: Cell) -> Cell:
    def figure(value: float) -> PositiveFigure:
        return PositiveFigure(value=value, status=Provenance.PUBLISHED, source="Duclusaud et al. 2024, MX-64, M4")

    more = {"breakaway_Nm": figure(0.0239), "stribeck_rad_per_s": figure(1.52), "stribeck_exponent": figure(1.33)}
    more |= {"load_friction": figure(0.01), "breakaway_load_friction": figure(0.4)}
    arm = cell.arms[0]
    servos = (arm.servos[0].model_copy(update=more), *arm.servos[1:])
    return replace(cell, arms=(replace(arm, servos=servos), *cell.arms[1:]))


def test_keys_of_the_arm_file_reach_the_plant() -> None:
    shipped = load_cell(configs.CELLS_DIR / "paper.toml")
    q_start = start_joints(shipped)
    assert all(arm.friction is None for arm in plant_spec(shipped, q_start).arms)
    left, right = plant_spec(keyed(shipped), q_start).arms
    assert right.friction is None
    made = left.friction
    assert made is not None
    first = [getattr(made, k)[0] for k in made.__dataclass_fields__]
    joint = shipped.arms[0].servos[0]
    assert first == [joint.coulomb_Nm.value, 0.0239, 1.52, 1.33, 0.01, 0.4, joint.viscous_Nm_s_per_rad.value]
    assert [getattr(made, k)[1] for k in ("breakaway_Nm", "load", "breakaway_load")] == [0.0, 0.0, 0.0]
    frictionless = load_cell(configs.CELLS_DIR / "paper.toml", ["simulation.effects.friction=false"])
    assert all(arm.friction is None for arm in plant_spec(keyed(frictionless), q_start).arms)


def test_breakaway_needs_the_speed_it_falls_off_over() -> None:
    joint = load_cell(configs.CELLS_DIR / "paper.toml").arms[0].servos[0]
    extra = Figure(value=0.02, status=Provenance.ESTIMATED, source="a test")
    with pytest.raises(ValueError, match="breakaway falls off"):
        ServoJoint(**{**dict(joint), "breakaway_Nm": extra})
