"""Two arms of one make at each other's port: refused where their servos have IDs or marks of their own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.servo_map import arm_map
from agent.process.emulate import wiring
from drivers.dynamixel.arm_map import ArmMap, Mark
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.servo import table
from tests.support.servos.dxl_rig import START, WX200, Rig, at, build, enabled
from tests.support.servos.tool_rig import LOOKING, codes

SHIFT = 10


def maps(folder: Path) -> tuple[ArmMap, ArmMap]:
    """Left and right of two WidowX-200, the right one's servos with IDs of its own by an arm file beside the cell."""
    shipped = (configs.ARMS_DIR / "wx200.toml").read_text()
    own = re.sub(r"^ids = \[(.*)\]", lambda m: f"ids = [{', '.join(str(int(i) + SHIFT) for i in m[1].split(','))}]",
                 shipped, flags=re.MULTILINE)  # fmt: skip
    (folder / "right_wx200.toml").write_text(own)
    cell = (configs.CELLS_DIR / "two_wx200.toml").read_text()
    head, right = cell.split('name = "right"')
    right = right.replace('model = "wx200"', 'model = "wx200"\narm_file = "right_wx200.toml"', 1)
    (folder / "cell.toml").write_text(f'{head}name = "right"{right}')
    loaded = load_cell(folder / "cell.toml")
    q = np.array([START[name] for name in loaded.arms[0].entry.controlled])
    left, right_map = (arm_map(loaded, arm, "virtual", q) for arm in loaded.arms)
    return left, right_map


@pytest.mark.fault("G3")
@pytest.mark.parametrize("swapped", [False, True])
def test_arms_of_one_make_with_ids_of_their_own_are_refused_at_each_others_port(tmp_path: Path, swapped: bool) -> None:
    left, right = maps(tmp_path)
    assert min(servo_id for joint in right.joints for servo_id in joint.ids) == 1 + SHIFT
    rig = build(left, emulated=right if swapped else left)
    if not swapped:
        rig.driver.connect()
        return
    with pytest.raises(IdentityError, match=r"found IDs 11, .* expected IDs 1, .* another arm"):
        rig.driver.connect()
    assert all(rig.get(id_, table.TORQUE_ENABLE) == 0 for joint in right.joints for id_ in joint.ids)


FACTORY = 10
IDS = [slot.servo_id for slot in WX200.slots]


def marked_rig(own: int | None, other: int | None, found: dict[int, int]) -> Rig:
    """The arm left of two, with what its servos have, by ID."""
    rig = build(at(WX200, mark=Mark("left", own, () if other is None else ((other, "right"),))))
    for servo_id, mark in found.items():
        rig.put(servo_id, table.MOVING_THRESHOLD, mark)
    return rig


@pytest.mark.fault("G3")
@pytest.mark.parametrize(
    ("own", "other", "found", "said"),
    [
        (1, 2, dict.fromkeys(IDS, 1), None),
        (1, 2, dict.fromkeys(IDS, 2), r"^mark on virtual: found 2, arm right's, expected 1, arm left's; .* swapped$"),
        (None, 2, dict.fromkeys(IDS, 2), r"^mark on virtual: found 2, arm right's, expected that of no other arm; "),
        (None, 2, dict.fromkeys(IDS, FACTORY), None),
        (1, None, dict.fromkeys(IDS, FACTORY), r"^mark on virtual: found 10, as it leaves the factory, expected 1, "),
        (
            1,
            2,
            dict.fromkeys(IDS, 3),
            r"^mark on virtual: found 3, expected 1, arm left's; check that this is arm left",
        ),
        (1, 2, {**dict.fromkeys(IDS, 1), 4: 2}, r"^servo 4 \(elbow\): mark: found 2, arm right's, .* this servo alone"),
        (1, 2, {**dict.fromkeys(IDS, 2), 4: 3}, r"^servo 1 \(waist\): mark: found 2, arm right's, expected 1, "),
        (None, None, dict.fromkeys(IDS, 77), None),
    ],
)
def test_an_arm_with_another_mark_than_its_own_is_refused_before_anything_is_written(
    own: int | None, other: int | None, found: dict[int, int], said: str | None
) -> None:
    rig = marked_rig(own, other, found)
    if said is None:
        rig.driver.connect()
    else:
        with pytest.raises(IdentityError, match=said):
            rig.driver.connect()
        assert not rig.port.is_open
    assert codes(rig) <= LOOKING


@pytest.mark.fault("G3")
@pytest.mark.parametrize("level", [0, 1])
def test_another_arm_keeps_even_the_level_of_its_answers(level: int) -> None:
    rig = marked_rig(1, 2, dict.fromkeys(IDS, 2))
    rig.put(4, table.STATUS_RETURN_LEVEL, level)
    with pytest.raises(IdentityError, match="found 2, arm right's"):
        rig.driver.connect()
    assert codes(rig) <= LOOKING
    assert rig.get(4, table.STATUS_RETURN_LEVEL) == level
    rig = marked_rig(1, 2, dict.fromkeys(IDS, 1))
    rig.put(4, table.STATUS_RETURN_LEVEL, level)
    rig.driver.connect()
    assert rig.get(4, table.STATUS_RETURN_LEVEL) == 2


@pytest.mark.fault("G3")
def test_an_arm_exchanged_while_its_port_was_away_is_not_taken_for_the_one_before() -> None:
    rig = enabled(at(WX200, mark=Mark("left", 1, ((2, "right"),))))
    rig.driver.reopen()
    for servo_id in IDS:
        rig.put(servo_id, table.MOVING_THRESHOLD, 2)
    rig.port.writes.clear()
    with pytest.raises(IdentityError, match="mark: found 2, arm right's, expected 1"):
        rig.driver.reopen()
    assert codes(rig) <= LOOKING
    assert not rig.port.is_open


def test_the_emulated_servos_of_a_cell_have_the_marks_that_it_gives_its_arms() -> None:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["arms.right.dynamixel.mark=2"])
    left, right = (arm_map(cell, arm, "virtual", np.zeros(3)).mark for arm in cell.arms)
    assert (left, right) == (Mark("left", None, ((2, "right"),)), Mark("right", 2, ()))
    born = [
        {dict(servo.eeprom).get("Moving Threshold") for joint in emulated.joints for servo in joint.servos}
        for emulated in (wiring(arm, i, arm.baud) for i, arm in enumerate(cell.arms))
    ]
    assert born == [{None}, {2}]
