"""What was true at an instant, worked out once time has gone on."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from drivers.interface import DriverError, Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.build import build_plant, snapshot
from sim_backend.physics.calendar import Happening, Opening, Push, Seizure
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.snapshot import Observation
from sim_backend.physics.spec import GraspSpec, PlantSpec
from tests.support.plant.plant_cells import planar_cell
from tests.support.plant.served_plant import TAU, ServedPlant, cycle

MX = ActuatorSpec.of(3, coulomb_Nm=[0.0843, 0.0843, 0.0078], viscous_Nms_rad=[0.0347, 0.0347, 0.0362])
PUSHED = Push(0.0, 0.012, (0.0, 0.0, -8.0, 0.0, 0.2, 0.0))
BEFALL: dict[str, Happening] = {
    "a push that begins": Push(0.012, 1.0, (3.0, 0.0, -5.0, 0.0, 0.1, 0.0)),
    "a gripper that opens": Opening(0.012, "left"),
    "joints that seize": Seizure(0.012, "right"),
}


def same(a: Observation, b: Observation) -> bool:
    return all(
        np.array_equal(x, y, equal_nan=True) for x, y in zip(asdict(a).values(), asdict(b).values(), strict=True)
    )


def dry(spec: PlantSpec) -> PlantSpec:
    return replace(spec, arms=tuple(replace(arm, friction=FrictionSpec.smooth(arm.actuator)) for arm in spec.arms))


def soft(spec: PlantSpec) -> PlantSpec:
    return replace(spec, grasp=GraspSpec(1e4, 50.0))


@pytest.mark.parametrize("kind", [lambda spec: spec, dry, soft], ids=["welded", "with dry friction", "on pads"])
@pytest.mark.parametrize("happening", BEFALL.values(), ids=BEFALL.keys())
def test_later_it_says_what_was_seen_then(happening: Happening, kind: Callable[[PlantSpec], PlantSpec]) -> None:
    plant = build_plant(kind(replace(planar_cell(MX), happenings=(PUSHED, happening))))
    before, after = np.array([0.3, -0.2, 0.1, -0.3, 0.2, -0.1]), np.full(6, -0.4)
    plant.advance(before, 11)
    tau: Vector = before.copy()
    then, kept = plant.observe(tau), snapshot(plant, tau)
    tau[:] = after
    plant.advance(tau, 30)
    assert same(kept.observation(), then)
    assert not same(plant.observe(before), then)


def test_asking_later_changes_no_bit_of_the_motion() -> None:
    spec = replace(planar_cell(MX), happenings=(PUSHED, *BEFALL.values()))
    silent, asked = build_plant(spec), build_plant(spec)
    for tau in np.random.default_rng(3).normal(scale=0.5, size=(12, 6)):
        kept = snapshot(asked, tau)
        for plant in (silent, asked):
            plant.advance(tau, 3)
        kept.observation()
    assert silent.q.tobytes() == asked.q.tobytes()
    assert silent.dq.tobytes() == asked.dq.tobytes()
    assert silent.reported().tobytes() == asked.reported().tobytes()


def test_arms_have_the_next_state_before_the_truth_is_worked_out(tmp_path: Path) -> None:
    """In lockstep with a delay of a whole period: nobody waits for what only the log wants."""
    told, in_time = threading.Event(), []

    def look(tick: int, _stamp_ns: int, _seen: Observation) -> None:
        if tick == 2:
            in_time.append(told.wait(10.0))

    with ServedPlant(tmp_path, servos=ActuatorSpec.of(3, delay_s=5e-3), on_tick=look) as served:
        arms = served.enabled()
        cycle(arms, 2)
        for arm in arms:
            arm.read()
            arm.write(TAU)  # the answer to 2, while the plant still has its truth to tell
        for arm in arms:
            arm.read()  # 3
        told.set()
        for arm in arms:
            arm.write(TAU)
        cycle(arms, 1)
    assert in_time == [True]


def test_a_pause_comes_before_the_time_of_its_tick_passes(tmp_path: Path) -> None:
    paused: list[tuple[int, float]] = []
    with ServedPlant(
        tmp_path, names=("left",), observe_every=2, on_tick=lambda *_: None,
        pause=lambda stamp_ns: paused.append((stamp_ns, served.plant.t)),
    ) as served:  # fmt: skip
        cycle(served.enabled(), 7)
    assert [(stamp, round(t, 9)) for stamp, t in paused[:3]] == [(0, 0.0), (10_000_000, 0.01), (20_000_000, 0.02)]


def test_the_last_instant_before_a_motion_that_diverges_is_told(tmp_path: Path) -> None:
    seen: list[float] = []
    spec = planar_cell(ActuatorSpec.of(3, delay_s=5e-3), names=("left",))
    with ServedPlant(tmp_path, names=("left",), spec=spec, on_tick=lambda _k, _t, o: seen.append(o.t)) as served:
        (left,) = served.enabled()
        with contextlib.suppress(DriverError):  # once the plant has refused to go on
            while True:
                left.read()
                left.write(np.full(3, 1e200))
        served.join()
        assert served.error is not None
    assert seen[-1] == pytest.approx(served.plant.t, abs=5.1e-3)
    assert len(seen) == round(seen[-1] / 5e-3) + 1
