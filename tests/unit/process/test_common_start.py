"""Pushes of a run at the wall clock's pace count from the common start, which is known long after the plant's begin."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agent.config.cell import Cell, load_cell
from agent.operator.table import Verb
from agent.process import children, emulate, person, plant, whole
from agent.process.children import Children
from agent.process.common_start import CommonStart, say
from agent.process.person import Person
from agent.process.run_kind import RunKind
from agent.process.simulated import plant_spec
from sim_backend.physics.build import AnyPlant, build_plant
from sim_backend.served.options import LostArm
from sim_backend.wire.serve import ServeOptions
from tests.support.coop import PAPER
from tests.support.starts import start_joints

PUSHED = load_cell(
    Path("paper"),
    [
        "simulation.push=[{at_s=0.5, duration_s=0.1, force_N=[0.0, 1.0, 0.0]}]",
        "simulation.ready_s=4.0",
        "world.gravity_m_per_s2=[0.0, 0.0, 0.0]",
    ],
)
UTC_NS, NOW_NS = 10**18, 7 * 10**9  # UTC minus the clock, and the clock


def at_rest(cell: Cell = PUSHED) -> AnyPlant:
    return build_plant(plant_spec(cell, start_joints(cell)))


def pushed_s(made: AnyPlant, most_s: float) -> float:
    """On the plant's clock, when the object is pushed first."""
    while made.t < most_s:
        made.advance(np.zeros(made.joint_count), 1)
        if made.calendar.wrench.any():
            return made.t - made.spec.substep_s
    return np.inf


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_a_push_falls_where_the_run_says_that_the_start_is(tmp_path: Path, late_s: float) -> None:
    made, path = at_rest(), tmp_path / "start"
    start = CommonStart(path, made, PUSHED, UTC_NS)
    start.look(NOW_NS)
    made.advance(np.zeros(made.joint_count), 100)
    say(path, UTC_NS + NOW_NS + round((0.25 - late_s) * 1e9))
    start.look(NOW_NS)
    start.look(NOW_NS + 10**9)  # known, and told no second time
    assert pushed_s(made, 2.0) == pytest.approx(0.1 + 0.25 - late_s + 0.5)


def test_nothing_befalls_the_cell_before_the_start_is_known(tmp_path: Path) -> None:
    made = at_rest()
    CommonStart(tmp_path / "start", made, PUSHED, UTC_NS).look(NOW_NS)
    assert pushed_s(made, 4.7) == np.inf


def test_without_a_run_it_counts_from_where_a_lockstep_run_starts() -> None:
    made = at_rest()
    CommonStart(None, made, PUSHED, UTC_NS).look(NOW_NS)
    assert pushed_s(made, 4.7) == pytest.approx(4.5)


def test_a_cell_that_nothing_befalls_looks_for_nothing(tmp_path: Path) -> None:
    path, cell = tmp_path / "start", load_cell(Path("paper"))
    path.write_text("no instant")
    CommonStart(path, at_rest(cell), cell, UTC_NS).look(NOW_NS)


class Told(CommonStart):
    """Remembers what it is made with and when it is asked."""

    made: list[Told] = []  # noqa: RUF012 - of one test

    def __init__(self, path: Path | None, made: AnyPlant, cell: Cell, utc_offset_ns: int) -> None:
        super().__init__(path, made, cell, utc_offset_ns)
        self.given, self.looks = (path, cell, utc_offset_ns), list[int]()
        Told.made.append(self)

    def look(self, now_ns: int) -> None:
        self.looks.append(now_ns)


def a_few() -> Callable[[], bool]:
    left = itertools.chain([False] * 3, itertools.repeat(True))
    return lambda: next(left)


def test_emulated_servos_look_for_it_before_every_lap_and_a_plant_before_every_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, ring = tmp_path / "start", tmp_path / "ring"
    for module in (emulate, plant):
        monkeypatch.setattr(module, "CommonStart", Told)
    ports = ServeOptions({arm.name: tmp_path / arm.name for arm in PUSHED.arms})
    emulate.run_emulate(
        PUSHED, ports, ring, timing=False, stop=a_few(), ready=lambda _: None,  # type: ignore[arg-type]
        common_start=path, utc_offset_ns=UTC_NS,
    )  # fmt: skip
    plant.run_plant(
        PUSHED, tmp_path / "socket", tmp_path / "other", lockstep=False, lost_arm=LostArm.END_RUN, stop=a_few(),  # type: ignore[arg-type]
        ready=lambda _: None, common_start=path, utc_offset_ns=UTC_NS,
    )  # fmt: skip
    servos, served = Told.made
    Told.made.clear()
    assert servos.given == served.given == (path, PUSHED, UTC_NS)
    assert len(servos.looks) == len(served.looks) == 4
    assert all(0 < one.looks[0] <= one.looks[-1] <= time.monotonic_ns() for one in (servos, served))


@pytest.mark.parametrize("kind", RunKind)
def test_a_run_writes_it_where_its_plant_looks_and_lockstep_knows_it(
    tmp_path: Path, kind: RunKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Children(load_cell(Path(PAPER)), kind, 0, None, tmp_path / "run.mcap", tmp_path)
    where = made._plant_command().common_start
    if kind is RunKind.LOCKSTEP:
        assert where is None
        return
    monkeypatch.setattr(children, "start_patiently", lambda *_: 1234)
    made._start_together(SimpleNamespace(phase=lambda _: None))  # type: ignore[arg-type]
    assert where is not None
    assert int(where.read_text()) == 1234


def test_so_does_who_stands_beside_a_whole_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard = list[int]()
    monkeypatch.setattr(person, "start_together", lambda _, request, __: heard.append(request.start_utc_ns))
    beside = Person({"left": []}, "", common_start=tmp_path / "start")
    beside._say(Verb.LOWER, ["left"])
    assert not (tmp_path / "start").exists()
    beside._say(Verb.START, ["left"])
    assert int((tmp_path / "start").read_text()) == heard[-1]


@pytest.mark.parametrize("force_N", [0.0, 20.0])
def test_a_session_s_object_on_its_table_is_pushed_as_well(force_N: float) -> None:
    push = f"simulation.push=[{{at_s=0.01, duration_s=1.0, force_N=[0.0, 0.0, {force_N}]}}]"
    cell = load_cell(Path("two_wx200"), ["session.lift_m=0.02", push, "simulation.ready_s=0.0"])
    _, world = whole.at_rest(cell, start_joints(cell), None)
    stood = float(world.plant.T_world_object.translation[2])
    for _ in range(60):
        world.advance()
    risen = float(world.plant.T_world_object.translation[2]) - stood
    assert risen > 5e-3 if force_N else abs(risen) < 1e-3
