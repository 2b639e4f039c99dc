"""docs/first-carry.md, executed: its words in its order on emulated servos, and what it says is seen after each."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from agent.cli.main import whole
from agent.config.cell import load_cell
from agent.config.servo_map import arm_map
from agent.config.session import rest_joints
from agent.modes import FLOATING, Mode
from agent.operator.guide import STEPS
from agent.operator.table import Verb
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.servo.judge import REST, broken
from drivers.dynamixel.servo.table import PRESENT_POSITION
from tests.support.servos.phase_rig import At, PhaseRun, Step
from tests.unit.test_phases import CELL as QUICK

PAGE = (Path(__file__).parents[3] / "docs/first-carry.md").read_text()
INLINE = re.findall(r"`coop ([^`]+)`", PAGE)
COMMANDS = re.findall(r"^    coop (.+)$", PAGE, re.MULTILINE)
WORDS = [Verb(c.split()[0]) for c in COMMANDS if c.split()[0] in set(Verb)]
SEEN = [
    [Mode[name] for name in re.findall(r"\b[A-Z]{3,}\b", told) if name in Mode.__members__]
    for told in re.findall(r"\(((?:[A-Z]+(?:, then )?)+)\)", PAGE)
]


@pytest.mark.parametrize("command", sorted({*COMMANDS, *(text for text in INLINE if re.search("CELL|LOG", text))}))
def test_every_command_of_the_page_is_one(command: str) -> None:
    words = command.replace("CELL", "two_wx200").split()
    found = whole().commands[words[0]]  # type: ignore[attr-defined]
    found.make_context(words[0], words[1:])


def test_the_page_says_every_word_of_a_session_in_its_order() -> None:
    assert [verb.value for verb in WORDS] == [
        "approach", "grasp", "start", "lower", "release", "park", "release"
    ]  # fmt: skip


def test_the_guide_has_a_line_for_every_mode_and_names_the_word_that_comes_next() -> None:
    assert set(STEPS) == set(Mode) - FLOATING
    for before, verb in zip(
        (Mode.REST, Mode.APPROACH, Mode.READY, Mode.HOLD, Mode.LOWER, Mode.RELEASE), WORDS, strict=False
    ):
        assert f"coop {verb.value} CELL" in STEPS[before].do


def test_the_page_quotes_what_an_arm_that_is_not_at_its_rest_is_refused_with() -> None:
    cell = load_cell(Path("two_wx200"))
    slot = arm_map(cell, cell.arms[0], "virtual", rest_joints(cell.arms[0])).slots[1]
    found = {PRESENT_POSITION.name: slot.joint.zero_tick + round(2.953 / TICK_RAD)}
    misfit = broken(REST, ServoFound(slot, slot.model.model_number, 46, found))
    assert misfit is not None
    assert f"`{misfit.what}: found {misfit.said.found}, expected {misfit.said.expected}; {misfit.said.remedy}`" in PAGE


@pytest.mark.long  # the same words, said to both arms together, are in tests/unit/test_whole.py and test_phases.py
def test_two_hosts_say_the_same_words_by_themselves_and_share_but_two_instants() -> None:
    """Left and right are told apart from each other, as the page has it; start and lower come at one instant."""
    left, right, both = ("left",), ("right",), ("left", "right")
    rig = PhaseRun(
        QUICK,
        At.GRASP,
        [
            Step(Mode.APPROACH, Verb.GRASP, Mode.READY, arms=left),
            Step(Mode.APPROACH, Verb.GRASP, Mode.READY, arms=right),  # once the first one is READY
            Step(Mode.READY, Verb.START, Mode.TRACK, 0.35, arms=both),
            Step(Mode.TRACK, Verb.STOP, Mode.HOLD, 0.7, arms=right),
            Step(Mode.TRACK, Verb.STOP, Mode.HOLD, 0.05, arms=left),
            Step(Mode.HOLD, Verb.LOWER, Mode.LOWER, 0.1, arms=both),
            Step(Mode.LOWER, Verb.RELEASE, Mode.RELEASE, 0.6, arms=right),
            Step(Mode.RELEASE, Verb.PARK, Mode.PARK, 0.1, arms=right),  # while the other one still holds
            Step(Mode.LOWER, Verb.RELEASE, Mode.RELEASE, arms=left),
            Step(Mode.RELEASE, Verb.PARK, Mode.PARK, arms=left),
        ],
        limit_s=12.0,
    )
    assert rig.finished
    assert {name: arm.reasons for name, arm in rig.arms.items()} == {"left": [], "right": []}
    assert rig.world.set_down_error()[0] < 3e-3
    assert rig.world.holding == [False, False]
