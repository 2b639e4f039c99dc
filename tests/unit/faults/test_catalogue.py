"""The list of faults, the tests that are marked with its rows, and the file that says which they are, agree."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.config.servo_map import resting_joints
from agent.faults import catalogue
from agent.faults.catalogue import NODES, Row, rows
from agent.faults.plan import placed
from drivers.interface import Refusal
from tests.faults.nodes import marked, written

MATRIX = (
    *(f"P{i}" for i in range(1, 15)), *(f"B{i}" for i in range(1, 12)), *(f"S{i}" for i in range(1, 9)),
    *(f"C{i}" for i in range(1, 6)), *(f"N{i}" for i in range(1, 7)), *(f"D{i}" for i in range(1, 7)),
    *(f"G{i}" for i in range(1, 7)), *(f"M{i}" for i in range(1, 7)), *(f"F{i}" for i in range(1, 10)),
    *(f"H{i}" for i in range(1, 8)), "X1",
)  # fmt: skip


def test_every_row_of_the_matrix_is_in_the_list_once_and_in_order() -> None:
    assert tuple(row.id for row in rows()) == MATRIX


def test_every_mark_is_a_row_and_every_marked_test_is_written_down() -> None:
    found = marked()
    assert set(found) <= set(MATRIX)
    assert NODES.read_text() == written(found), "python -m tests.faults.nodes writes it"
    assert catalogue.nodes() == {key: tuple(nodes) for key, nodes in found.items()}


def test_what_nothing_shows_says_why_and_nothing_else_does() -> None:
    for row in rows():
        assert row.is_tested != bool(row.untested), f"{row.id}: a run, a marked test, or the reason why neither"


def test_the_runs_of_every_row_are_of_cells_arms_and_servos_that_are_there() -> None:
    for row in rows():
        for shown in row.runs:
            cell = load_cell(Path(shown.cell), [f"duration_s={shown.duration_s}", *shown.set])
            names = [arm.name for arm in cell.arms]
            assert set(shown.within.who) <= set(names), row.id
            for fault in placed(shown.faults, names):
                ids = {i for joint in resting_joints(cell.arm(str(fault.arm)).file) for i in joint.ids}
                assert fault.servo is None or fault.servo in ids, row.id
                assert fault.possible.always or fault.at_s < shown.duration_s, row.id
            assert shown.within.described(), f"{row.id}: a run without a bound shows nothing"


def test_a_row_is_found_by_its_id_in_any_case() -> None:
    found = catalogue.row("b11")
    assert found is not None
    assert found.id == "B11"
    assert catalogue.row("B12") is None
    assert "joints ≤ 0.1 rad until the watchdog" in found.bounds


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[row]]\nid = "P1"\ngroup = "process"\nfails = "x"\nmust = "y"\n', "row.*bound"),
        ('[[row]]\nid = "P1"\ngroup = "process"\nfails = "x"\nmust = "y"\nbound = "z"\n' * 2, "twice"),
        ('[[row]]\nid = "Q"\ngroup = "process"\nfails = "x"\nmust = "y"\nbound = "z"\n', "id"),
        ('[[row]]\nid = "P1"\ngroup = "other"\nfails = "x"\nmust = "y"\nbound = "z"\n', "group"),
    ],
    ids=["without a bound", "twice", "no id", "no group"],
)
def test_a_list_that_cannot_be_is_refused(text: str, message: str) -> None:
    with pytest.raises(Refusal, match=message):
        catalogue.validate(catalogue._File, tomllib.loads(text), "list")


def test_bounds_are_said_with_their_units() -> None:
    within = catalogue.Within(
        noticed_s=0.1, reacted_s=0.2, who=("left",), goes_on=True, internal_N=3.0, sag_m=0.02, moved_rad=0.1,
        speed_rad_per_s=1.5, apart_rad=0.1, grown_N=3.5, strayed_m=0.005, misled_rad=0.03,
    )  # fmt: skip
    assert within.described() == (
        "motion goes on, noticed ≤ 0.1 s, left stopped ≤ 0.2 s, internal force ≤ 3 N, internal force rises by ≤ 3.5 N, "
        "sag ≤ 0.02 m, joints ≤ 0.1 rad until the watchdog, joints ≤ 1.5 rad/s, arm and twin ≤ 0.1 rad apart, "
        "the object moves by ≤ 0.005 m, no command from a value that is off by > 0.03 rad"
    )
    row = Row.model_validate({"id": "P1", "group": "process", "fails": "x", "must": "y", "bound": "z"})
    assert row.bounds == "z"
