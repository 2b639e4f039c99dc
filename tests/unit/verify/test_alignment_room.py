"""What the limits of the alignment let arms touch is told by name, refused on servos, and asked of followers only."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from agent.config.cell import Cell, load_cell
from agent.verify.alignment_room import alignment_room
from agent.verify.check import examine, start_configurations
from agent.verify.finding import Finding, Verdict
from tests.support.control.level_wx200 import LEVEL

WHAT = "distances up to the limits of the alignment"
SERVOS = ('driver="dynamixel"', 'arms.left.dynamixel={port="/dev/a"}', 'arms.right.dynamixel={port="/dev/b"}')
LONG = "object.size_m=[0.255, 0.044, 0.044]"  # its end is near the wrists
STRAIGHT = "controller.alignment.max_rad=0.001"


def room(*overrides: str, name: str = "two_wx200") -> list[Finding]:
    """At the start alone."""
    cell: Cell = load_cell(Path(name), overrides)
    models = [cell.model(arm) for arm in cell.arms]
    return alignment_room(cell, models, [start_configurations(cell, models)], [0.0])


def test_followers_have_room_in_shipped_cells_and_the_anchor_is_not_asked() -> None:
    assert [(f.where, f.verdict) for f in room()] == [("right", Verdict.OK)]
    assert [f.where for f in room('controller.alignment.anchor="right"')] == ["left"]
    assert [f.where for f in room(name="three_wx250s")] == ["back", "front"]
    assert room("controller.alignment.enabled=false") == []


def test_the_distance_is_that_of_the_shifted_arm() -> None:
    (near,), (far,) = (room(*LEVEL, LONG, STRAIGHT, f"controller.alignment.max_m={x}") for x in (0.002, 0.007))
    assert "right" in near.found
    assert "object" in near.found
    assert float(near.found.split(" ")[0]) - float(far.found.split(" ")[0]) == pytest.approx(5.0, abs=0.3)


def test_a_turn_counts_too() -> None:
    narrow = (*LEVEL, "controller.alignment.max_m=1e-4", LONG)
    (straight,), (turned,) = (room(*narrow, f"controller.alignment.max_rad={a}") for a in (0.001, 0.1))
    assert float(turned.found.split(" ")[0]) < float(straight.found.split(" ")[0]) - 1.0


def test_limits_that_touch_are_a_warning_in_simulation_and_refused_on_servos() -> None:
    wide = (*LEVEL, LONG, STRAIGHT, "controller.alignment.max_m=0.02")
    (found,) = room(*wide)
    assert found.verdict is Verdict.WARNING
    assert "overlap by" in found.found
    said = re.fullmatch(r"set max_m = (\S+) and max_rad = (\S+), or make room", found.remedy)
    assert said is not None
    (followed,) = room(*wide, *(f"controller.alignment.{k}={said[i]}" for i, k in ((1, "max_m"), (2, "max_rad"))))
    assert followed.verdict is Verdict.OK
    wider = f"controller.alignment.max_m={1.2 * float(said[1])}"
    assert room(*wide, wider)[0].verdict is Verdict.WARNING, "no less than there is room for"
    (touching,) = room(*LEVEL, "object.size_m=[0.4, 0.044, 0.044]", STRAIGHT)
    assert touching.remedy.startswith("take the arm away from what it touches without any shift")
    assert room(*wide, *SERVOS)[0].verdict is Verdict.REFUSED
    assert WHAT in [f.what for f in examine(load_cell(Path("two_wx200")), thorough=True).findings]
    refused = examine(load_cell(Path("two_wx200"), [*SERVOS, *wide, "safety.collision_margin_m=0.0"]))
    line = next(f for f in refused.findings if f.what == WHAT)
    assert (line.verdict, line.where) == (Verdict.REFUSED, "right")
    assert "\n" not in line.found + line.remedy
