"""Backlash: what a motor does in its gap, that no momentum is lost, and that plants and emulated servos have it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.reality import draw
from agent.config.schema.reality import ArmReality as Entry
from agent.config.schema.reality import Reality as Given
from agent.study.lab import Laboratory, Run
from agent.study.measure import measure
from sim_backend.physics.actuator import ActuatorError, ActuatorSpec
from sim_backend.physics.build import build_plant
from sim_backend.physics.gears import LEAST_INERTIA, Gears, gears
from sim_backend.physics.reality import ArmReality, Reality, realised
from sim_backend.physics.spec import GraspSpec, PlantError, PlantSpec
from sim_backend.wire.plant_world import PlantWorld, without_servo_electronics
from tests.support.plant.plant_cells import planar_cell
from tests.support.plant.served_plant import SERVOS

H = 1e-3
GAP = 1e-3
STILL = np.zeros(1)


def gear(gap: float = GAP, inertia: float = 0.01) -> Gears:
    return Gears(np.array([gap]), np.array([inertia]), H)


def across(g: Gears, torque: float) -> list[float]:
    """Torques that reach a joint at rest in 100 substeps."""
    return [float(g.passed(np.array([torque]), STILL)[0]) for _ in range(100)]


def test_a_motor_crosses_its_gap_as_a_free_rotor_and_hands_over_its_momentum() -> None:
    g = gear()
    across(g, 0.1)
    assert g.x[0] == 0.5 * GAP
    passed = across(g, -0.1)
    arrives = next(k for k, torque in enumerate(passed) if torque)
    assert passed[:arrives] == [0.0] * arrives
    assert arrives * H == pytest.approx(np.sqrt(2.0 * GAP * 0.01 / 0.1), abs=2.0 * H)
    assert sum(passed[: arrives + 1]) == pytest.approx(-0.1 * (arrives + 1)), "no impulse is lost"
    assert passed[arrives + 1 :] == [-0.1] * (99 - arrives)
    assert g.x[0] == -0.5 * GAP


def test_a_joint_without_backlash_gets_its_torque_to_the_bit() -> None:
    g = Gears(np.array([0.0, GAP]), np.array([0.01, 0.01]), H)
    rng = np.random.default_rng(1)
    for _ in range(50):
        motor = rng.normal(size=2)
        assert g.passed(motor, rng.normal(size=2))[0] == motor[0]


def test_a_joint_that_runs_away_from_its_motor_takes_the_teeth_apart() -> None:
    g, speed = gear(), np.zeros(1)
    across(g, 0.1)
    speed[0] += 20.0 * H  # faster than the motor, which would reach 10 rad/s² alone
    assert g.passed(np.array([0.1]), speed)[0] == 0.0
    assert g.x[0] < 0.5 * GAP


def test_a_motor_without_inertia_crosses_in_a_substep() -> None:
    g = gear(inertia=0.0)
    across(g, 0.1)
    assert across(g, -0.1) == [-0.1] * 100
    assert LEAST_INERTIA > 0.0


@pytest.mark.parametrize("pads", [None, GraspSpec(1e5, 100.0)])
def test_both_plants_have_it_and_emulated_servos_keep_it(pads: GraspSpec | None) -> None:
    believed = replace(planar_cell(SERVOS), grasp=pads)
    assert gears(believed) is None
    real = realised(believed, Reality(arms={"left": ArmReality(backlash_rad=(0.0, 0.01, 0.0))}))
    np.testing.assert_array_equal(real.arms[0].actuator.backlash_rad, [0.0, 0.01, 0.0])
    assert not real.arms[1].actuator.backlash_rad.any()

    def moved(spec: PlantSpec) -> float:
        """By what a torque moves the joint beyond what the rest of the cell does to it."""
        q = []
        for torque in (0.0, 0.2):
            world = PlantWorld(build_plant(without_servo_electronics(spec)), supported=False)
            world.tau_Nm[1] = torque
            for _ in range(10):
                world.advance()
            q.append(float(world.plant.q[1]))
        return abs(q[1] - q[0])

    assert moved(real) == 0.0
    assert moved(believed) > 1e-4


def test_backlash_that_cannot_be_is_refused() -> None:
    with pytest.raises(ActuatorError, match="backlash_rad"):
        ActuatorSpec.of(1, backlash_rad=-1e-3)
    with pytest.raises(ActuatorError, match="backlash_rad"):
        ActuatorSpec.of(1, backlash_rad=np.inf)
    with pytest.raises(PlantError, match=r"backlash_rad.*one per controlled joint"):
        realised(planar_cell(SERVOS), Reality(arms={"left": ArmReality(backlash_rad=(0.01,))}))


@pytest.mark.parametrize(
    ("name", "seed"), [("paper_real", None), pytest.param("three_wx250s", 3, marks=pytest.mark.long)]
)
def test_a_cell_lives_with_a_tenth_of_a_degree_in_every_joint(name: str, seed: int | None) -> None:
    cell = load_cell(Path(name), ["duration_s=1.0", "simulation.ready_s=0.2", "report.transient_s=0.4"])
    drawn = Given() if seed is None else draw(cell.file.tolerance, seed, cell)
    entry = {arm.name: drawn.arms.get(arm.name, Entry()) for arm in cell.arms}
    gap = (float(np.radians(0.1)),)
    arms = {arm.name: entry[arm.name].model_copy(update={"backlash_rad": gap * arm.n}) for arm in cell.arms}
    lab = Laboratory(cell)
    assert Run(lab, drawn.model_copy(update={"arms": arms})).plant._gears is not None
    result = measure(lab, drawn.model_copy(update={"arms": arms}))
    assert result.within_bounds
    assert result != measure(lab, drawn)
