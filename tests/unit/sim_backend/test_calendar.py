"""What befalls a plant at known times: exact to the substep, however the plant is advanced."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import ConfigError, load_cell
from agent.process.simulated import plant_spec
from drivers.interface import Vector
from sim_backend.physics.build import build_plant
from sim_backend.physics.calendar import WHOLE, Calendar, Limpness, Opening, Push, SEIZED_Nms_RAD, Seizure
from sim_backend.physics.spec import GraspSpec, PlantError, PlantSpec
from tests.support.plant.plant_cells import planar_cell
from tests.support.starts import start_joints

FORCE = (0.3, -0.2, 0.0, 0.0, 0.0, 1e-4)


def specs() -> list[PlantSpec]:
    spec = replace(planar_cell(), gravity=np.zeros(3))
    return [spec, replace(spec, grasp=GraspSpec(1e4, 50.0))]


class Told:
    """A plant that remembers what befell it."""

    def __init__(self) -> None:
        self.at = 0
        self.seen: list[tuple[int, object]] = []

    def push(self, wrench_world: Vector) -> None:
        self.seen.append((self.at, wrench_world.tolist()))

    def release(self, arm: str) -> None:
        self.seen.append((self.at, arm))

    def brake(self, arm: str, viscous_Nms_rad: float) -> None:
        self.seen.append((self.at, (arm, viscous_Nms_rad)))

    def advance(self, calendar: Calendar, substeps: int) -> list[int]:
        counts = []
        for count in calendar.stretches(self, self.at, substeps):
            counts.append(count)
            self.at += count
        return counts


def test_everything_happens_at_its_substep_and_pushes_add_up() -> None:
    one, two = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 2.0, 0.0, 0.0, 0.0, 0.0)
    calendar = Calendar([Push(0.003, 0.004, one), Push(0.005, 0.01, two), Opening(0.005, "left")], 1e-3)
    told = Told()
    assert told.advance(calendar, 3) == [3]
    assert told.seen == []
    assert told.advance(calendar, 10) == [2, 2, 6]
    assert told.advance(calendar, 10) == [2, 8]
    both = [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    assert told.seen == [(3, list(one)), (5, both), (5, "left"), (7, list(two)), (15, [0.0] * 6)]
    assert told.advance(calendar, 5) == [5]


def told_of(push: Push, substeps: int = 20) -> list[float]:
    """Force along x in each substep."""
    told, calendar, forces = Told(), Calendar([push], 1e-3), []
    for _ in range(substeps):
        told.advance(calendar, 1)
        forces.append(float(calendar.wrench[0]))
        assert not told.seen or told.seen[-1][1] == calendar.wrench.tolist()
    return forces


@pytest.mark.parametrize(
    ("at_s", "duration_s", "shares"),
    [
        (0.002, 0.0004, {2: 0.4}),
        (0.0022, 0.0006, {2: 0.6}),
        (0.0027, 0.0006, {2: 0.3, 3: 0.3}),
        (0.0027, 0.0003, {2: 0.3}),
        (0.002, 0.0015, {2: 1.0, 3: 0.5}),
        (0.0025, 0.003, {2: 0.5, 3: 1.0, 4: 1.0, 5: 0.5}),
        (0.002, 0.002, {2: 1.0, 3: 1.0}),
        (0.0, 0.001, {0: 1.0}),
    ],
)
def test_a_substep_that_a_push_does_not_fill_has_its_share(
    at_s: float, duration_s: float, shares: dict[int, float]
) -> None:
    forces = told_of(Push(at_s, duration_s, (10.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    assert forces == pytest.approx([10.0 * shares.get(k, 0.0) for k in range(20)])
    assert sum(forces) * 1e-3 == pytest.approx(10.0 * duration_s)
    assert [force for k, force in enumerate(forces) if k not in shares] == [0.0] * (20 - len(shares))


def test_instants_that_are_whole_substeps_but_for_rounding_are_that() -> None:
    for at_s in (0.003, 3e-3 + 1e-12, 3e-3 - 1e-12):
        told = Told()
        told.advance(Calendar([Push(at_s, 0.004, FORCE)], 1e-3), 20)
        assert told.seen == [(3, list(FORCE)), (7, [0.0] * 6)]


def test_a_push_tells_of_no_part_that_takes_no_time() -> None:
    told, calendar = Told(), Calendar([Push(0.0027, 0.0006, (10.0, 0.0, 0.0, 0.0, 0.0, 0.0))], 1e-3)
    assert calendar.wrench.tolist() == [0.0] * 6
    told.advance(calendar, 20)
    assert [at for at, _ in told.seen] == [2, 3, 3, 4]
    assert WHOLE == 1e-6


def test_of_pushes_that_overlap_nothing_is_left_over_when_the_last_has_ended() -> None:
    some = [Push(1e-3 * k, 3.3e-3 + 1e-3 * k, (0.1 * k, 0.7, 1.1, 0.3, 0.1, 0.0)) for k in range(4)]
    told, calendar = Told(), Calendar(some, 1e-3)
    told.advance(calendar, 20)
    assert told.seen[-1] == (10, [0.0] * 6)


def test_a_seized_joint_creeps_by_five_milliradians_a_second_for_a_newton_metre() -> None:
    told = Told()
    told.advance(Calendar([Seizure(0.001, "left")], 1e-3), 2)
    assert told.seen == [(1, ("left", pytest.approx(1.0 / 5e-3)))]


def test_what_waits_happens_later_by_as_much_as_it_is_then_told() -> None:
    one = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    calendar, told = Calendar([Push(0.003, 0.004, one), Opening(0.005, "left")], 1e-3), Told()
    calendar.wait()
    assert told.advance(calendar, 20) == [20]
    calendar.go(0.022)
    assert told.advance(calendar, 20) == [5, 2, 2, 11]
    assert told.seen == [(25, list(one)), (27, "left"), (29, [0.0] * 6)]
    early, told = Calendar([Push(0.003, 0.004, one)], 1e-3), Told()
    early.go(-0.002)
    told.advance(early, 10)
    assert [at for at, _ in told.seen] == [1, 5]


def test_joints_seize_at_their_substep_and_a_limp_arm_is_named_from_its_on() -> None:
    calendar, told = Calendar([Seizure(0.004, "left"), Limpness(0.006, "right")], 1e-3), Told()
    assert told.advance(calendar, 8) == [4, 4]
    assert told.seen == [(4, ("left", SEIZED_Nms_RAD))]
    assert [calendar.limp(now) for now in (0, 5, 6, 100)] == [[], [], ["right"], ["right"]]
    calendar.wait()
    assert calendar.limp(100) == []
    calendar.go(0.010)
    assert [calendar.limp(now) for now in (15, 16)] == [[], ["right"]]


@pytest.mark.parametrize("spec", specs(), ids=["welds", "pads"])
def test_a_seized_arm_creeps(spec: PlantSpec) -> None:
    struck, sound = (build_plant(replace(spec, happenings=some)) for some in ((Seizure(0.02, "left"),), ()))
    tau = np.full(6, 0.05)
    for plant in (struck, sound):
        plant.advance(tau, 20)
    assert np.array_equal(struck.q, sound.q)
    for plant in (struck, sound):
        plant.advance(tau, 60)
    assert np.abs(struck.dq[:3]).max() < 0.1 * np.abs(sound.dq[:3]).max()


@pytest.mark.parametrize("spec", specs(), ids=["welds", "pads"])
def test_a_push_gives_the_object_that_is_let_go_its_momentum(spec: PlantSpec) -> None:
    happenings = (Opening(0.0, "left"), Opening(0.0, "right"), Push(0.002, 0.1, FORCE))
    plant = build_plant(replace(spec, happenings=happenings))
    plant.advance(np.zeros(6), 2)
    assert not plant.observe(np.zeros(6)).v_object.any()
    for count in (1, 50, 49, 100):
        plant.advance(np.zeros(6), count)
    seen = plant.observe(np.zeros(6))
    np.testing.assert_allclose(seen.v_object[:3], np.array(FORCE[:3]) * 0.1 / spec.object.mass_kg, rtol=1e-5)
    assert seen.v_object[5] == pytest.approx(FORCE[5] * 0.1 / spec.object.inertia[2, 2], rel=1e-5)
    assert np.isnan(seen.contact_error_m).all()


@pytest.mark.parametrize("spec", specs(), ids=["welds", "pads"])
@pytest.mark.parametrize(("force_N", "duration_s"), [(3.0, 4e-4), (3.0, 6e-4), (1.0, 1.5e-3), (0.3, 0.0333)])
def test_a_push_of_any_length_gives_its_impulse(spec: PlantSpec, force_N: float, duration_s: float) -> None:
    push = Push(0.002, duration_s, (force_N, 0.0, 0.0, 0.0, 0.0, 0.0))
    plant = build_plant(replace(spec, happenings=(Opening(0.0, "left"), Opening(0.0, "right"), push)))
    plant.advance(np.zeros(6), 50)
    given = spec.object.mass_kg * float(plant.observe(np.zeros(6)).v_object[0])
    assert given == pytest.approx(force_N * duration_s, rel=1e-4)


@pytest.mark.parametrize("spec", specs(), ids=["welds", "pads"])
def test_how_a_motion_is_divided_changes_no_bit_of_it(spec: PlantSpec) -> None:
    befallen = replace(spec, happenings=(Push(0.0071, 0.013, FORCE), Opening(0.03, "left")))
    whole, parts = build_plant(befallen), build_plant(befallen)
    whole.advance(np.full(6, 0.02), 60)
    for count in (5, 2, 1, 12, 10, 7, 23):
        parts.advance(np.full(6, 0.02), count)
    assert np.array_equal(whole.q, parts.q)
    assert np.array_equal(whole.dq, parts.dq)
    assert np.isnan(whole.observe(np.zeros(6)).contact_error_m[0])


def paper(*overrides: str) -> PlantSpec:
    cell = load_cell(configs.CELLS_DIR / "paper.toml", list(overrides))
    return plant_spec(cell, start_joints(cell))


def test_times_of_a_cell_count_from_the_common_start() -> None:
    push = "simulation.push=[{at_s=2.0, duration_s=0.5, force_N=[0.0, 10.0, 0.0], moment_Nm=[0.0, 0.0, 0.2]}]"
    opening = "simulation.opening=[{at_s=3.0, arm='right'}]"
    spec = paper(push, opening, "simulation.ready_s=1.5")
    assert spec.happenings == (Push(3.5, 0.5, (0.0, 10.0, 0.0, 0.0, 0.0, 0.2)), Opening(4.5, "right"))
    assert paper().happenings == ()


def test_faults_of_a_cell_come_at_the_begin_of_a_cycle_and_a_hold_is_none_of_the_plants() -> None:
    given = ["kind='limp', arm='left', at_s=3.0", "kind='locked', arm='right', at_s=3.001"]
    given += ["kind='open', arm='left', at_s=4.0", "kind='hold', arm='right', at_s=1.0"]
    table = f"simulation.fault=[{', '.join(f'{{{one}}}' for one in given)}]"
    spec = paper(table, "simulation.ready_s=1.501")
    limp, locked, lost = Limpness(4.5, "left"), Seizure(4.505, "right"), Opening(5.5, "left")
    assert spec.happenings == (limp, locked, lost), "of a plant that begins a whole number of cycles before"
    cell = load_cell(configs.CELLS_DIR / "paper.toml", [table])
    again = plant_spec(cell, start_joints(cell), faults=cell.file.simulation.fault[:1])
    assert again.happenings[3:] == (Limpness(3.0, "left"),), "beside the cell's own"


def test_what_cannot_befall_the_cell_is_refused() -> None:
    with pytest.raises(ConfigError, match="left or right"):
        paper("simulation.opening=[{at_s=3.0, arm='middle'}]")
    with pytest.raises(ConfigError, match="duration_s"):
        paper("simulation.push=[{at_s=3.0, duration_s=0.0}]")
    with pytest.raises(PlantError, match="middle"):
        replace(planar_cell(), happenings=(Opening(1.0, "middle"),))
    for what in (Seizure, Limpness):
        with pytest.raises(PlantError, match=f"{what.__name__.lower()}: found arm middle"):
            replace(planar_cell(), happenings=(what(1.0, "middle"),))
