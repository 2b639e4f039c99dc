"""Two arms of one make at each other's port: refused where their servos have IDs of their own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.servo_map import arm_map
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.servo import table
from tests.support.servos.dxl_rig import START, build

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
