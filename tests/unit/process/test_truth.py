"""A row of the plant's truth says what was observed, arm by arm."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.process import plant
from agent.process.plant import Truth
from agent.process.simulated import plant_spec
from agent.telemetry.ring.writer import RingWriter, RowsUntaken
from agent.telemetry.row.sample import MAX_JOINTS, PLANT_STATE
from sim_backend.physics.build import build_plant
from sim_backend.physics.snapshot import Observation
from sim_backend.served.options import LostArm, Summary
from tests.support.starts import start_joints

UTC_NS = 10**18
SHAPES = {
    "p_object": 3,
    "quat_object": 4,
    "v_object": 6,
    "grasp_wrench": (2, 6),
    "contact_error_m": 2,
    "contact_error_rad": 2,
    "slip_m": 2,
    "slip_rad": 2,
}
JOINTS = ("q", "dq", "tau_applied", "tau_friction")


class Kept:
    """A ring that keeps copies of its rows; says: the calls that it got."""

    def __init__(self) -> None:
        self.row: Any = np.zeros((), PLANT_STATE.dtype)
        self.rows: list[Any] = []
        self.says: list[str] = []

    def commit(self) -> None:
        self.rows.append(self.row.copy())
        self.says.append("row")

    def wait_for_space(self) -> None:
        self.says.append("waits")


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_row_has_every_value_of_its_observation_and_nothing_of_the_one_before(lockstep: bool) -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    plant = build_plant(plant_spec(cell, start_joints(cell)))
    ring, rng = Kept(), np.random.default_rng(1)
    truth = Truth(ring, plant, cell, UTC_NS, lockstep=lockstep)
    for sequence in (4, 8):
        values = {name: rng.normal(size=shape) for name, shape in SHAPES.items()}
        values |= {name: rng.normal(size=6) for name in JOINTS}
        truth.write(sequence, 5 * sequence, Observation(t=0.1 * sequence, energy=float(sequence), **values))
        row = ring.rows[-1]
        expected = {"sequence": sequence, "stamp_ns": 5 * sequence, "utc_ns": UTC_NS + 5 * sequence}
        expected |= {"t": 0.1 * sequence, "energy": sequence, "arm_count": 2, "config_id": cell.config_id}
        assert {name: row[name] for name in expected} == expected
        for name, value in values.items():
            field = row[name].reshape(-1, MAX_JOINTS)[:2, :3].ravel() if name in JOINTS else row[name][: value.size]
            assert field.tolist() == value.ravel().tolist(), name
            assert np.count_nonzero(row[name]) == value.size, name
    assert ring.says == (["waits", "row"] if lockstep else ["row"]) * 2


def test_a_plant_that_waits_for_its_rows_to_be_taken_hears_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[RingWriter] = []

    class Small(RingWriter):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given, slots=64)
            made.append(self)

    def serve(*_: object, **__: object) -> Summary:
        for _ in range(32):
            made[0].commit()
        made[0].wait_for_space(0.1)
        return Summary(0, 0.0, 1.0, 0, 0, ())

    monkeypatch.setattr(plant, "RingWriter", Small)
    monkeypatch.setattr(plant, "serve", serve)
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    where, stop = (tmp_path / "plant.sock", tmp_path / "plant.ring"), [False]

    def asked() -> bool:
        return stop[0]

    run = partial(plant.run_plant, cell, *where, lockstep=True, lost_arm=LostArm.END_RUN, ready=print, stop=asked)
    with pytest.raises(RowsUntaken):
        run()
    made.clear()
    stop[0] = True
    assert run().startswith("plant: 0 ticks")
