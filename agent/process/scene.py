"""The scene of a cell, from its files."""

from __future__ import annotations

from agent.config.files import ArmFiles, CellFiles
from agent.log.scene import Pose, Scene, SceneArm


def scene_of(cell: CellFiles) -> Scene:
    """What viewers must know of the cell beside its rows; where arms float, of those that take part alone."""
    spec = cell.file.floating
    arms = [arm for arm in cell.arms if spec is None or spec.takes_part(arm.name)]
    return Scene(cell.file.name, tuple(_arm(arm) for arm in arms), cell.file.world.gravity_m_per_s2)


def _arm(arm: ArmFiles) -> SceneArm:
    entry = arm.entry
    return SceneArm(
        name=arm.name,
        joints=tuple(entry.controlled),
        locked=dict(entry.locked_rad),
        urdf_xml=arm.urdf_xml,
        ee_link=arm.file.ee_frame,
        T_world_base=Pose(entry.p_world_base_m, entry.quat_world_base),
        quat_object_ee=entry.quat_object_ee,
    )
