"""Scenes of cells that have no cell file: WidowX-200s side by side, y up as in the paper."""

from __future__ import annotations

from collections.abc import Mapping

import configs
from agent.log.scene import Pose, Scene, SceneArm

HALF = 0.5**0.5
LOCKED_RAD = {"wrist_angle": 0.3, "wrist_rotate": -0.2}


def scene(cell: str, arms: Mapping[str, tuple[str, ...]]) -> Scene:
    """`arms`: controlled joints by arm."""
    urdf = (configs.ARMS_DIR / "wx200.urdf").read_text(encoding="utf-8")
    return Scene(
        cell,
        tuple(
            SceneArm(
                name, joints, {j: q for j, q in LOCKED_RAD.items() if j not in joints}, urdf, "ee",
                Pose((0.6 * i, -0.125, 0.01), (HALF, -HALF, 0.0, 0.0)), (HALF, 0.0, HALF, 0.0),
            )
            for i, (name, joints) in enumerate(arms.items())
        ),
        (0.0, -9.81, 0.0),
    )  # fmt: skip
