"""What must not matter: where the cell stands, and what the arms are called (identity 8)."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

import configs
from agent.config.cell import cell_from_toml
from agent.control import internal_force, known
from agent.control.memory import initial
from agent.control.quaternion import multiply
from agent.control.trajectory import Desired
from agent.loop import step
from agent.modes import Mode
from agent.process.build import build_agent
from drivers.interface import JointState
from tests.support.control.strategies import (
    RandomCell,
    arm_model,
    cells,
    examples,
    quaternion_of,
    random_pose,
    with_internal_wrenches,
)

SEEDS = st.integers(0, 2**32 - 1)


def moved(cell: RandomCell, T: pin.SE3) -> RandomCell:
    """The same cell elsewhere: bases, object, gravity and desired motion, all moved by T."""
    R, d = T.rotation, cell.desired
    arms = []
    for a in cell.arms:
        gravity = R @ np.array(a.offline.gravity)
        planar = a.model.plane_normal is not None
        model = arm_model(a.name, planar, T * a.T_world_base, a.T_object_ee, a.model.model.armature, gravity)
        offline = replace(a.offline, gravity=tuple(gravity.tolist()))
        arms.append(replace(a, model=model, offline=offline, T_world_base=T * a.T_world_base))
    turn = np.kron(np.eye(2), R)
    desired = Desired(
        tuple((R @ np.array(d.p) + T.translation).tolist()),
        multiply(quaternion_of(T), d.quat),
        tuple((turn @ np.array(d.v)).tolist()),
        tuple((turn @ np.array(d.a)).tolist()),
    )
    return replace(
        cell,
        arms=tuple(arms),
        P=arms[0].model.task_basis,
        T_world_object=T * cell.T_world_object,
        v_object=turn @ cell.v_object,
        desired=desired,
    )


@given(cells(scalar_gains=True), SEEDS)
@examples(60)
def test_moving_the_whole_cell_leaves_the_torques_unchanged(cell: RandomCell, seed: int) -> None:
    cell = with_internal_wrenches(cell, seed)
    other = moved(cell, random_pose(np.random.default_rng(seed), 2.0))
    for here, there in zip(cell.arms, other.arms, strict=True):
        one = known.torque(here.model, here.offline, here.q, here.dq, cell.desired)
        two = known.torque(there.model, there.offline, here.q, here.dq, other.desired)
        scale = max(1.0, np.abs(one.tau_cmd).max())
        assert np.abs(two.tau_cmd - one.tau_cmd).max() < 1e-9 * scale
        assert abs(two.lyapunov - one.lyapunov) < 1e-9 * max(1.0, one.lyapunov)


@given(cells(), SEEDS)
@examples(40)
def test_another_order_of_the_arms_gives_every_arm_its_own_internal_force(cell: RandomCell, seed: int) -> None:
    desired = np.random.default_rng(seed).normal(size=(len(cell.arms), 6)).tolist()
    rows = internal_force.internal_wrenches(cell.grasps, desired)
    order = np.random.default_rng(seed).permutation(len(cell.arms))
    other = internal_force.internal_wrenches([cell.grasps[i] for i in order], [desired[i] for i in order])
    assert np.abs(np.array(other) - np.array(rows)[order]).max() < 1e-14


def paper_document() -> dict[str, Any]:
    return tomllib.loads((configs.CELLS_DIR / "paper.toml").read_text())


def test_renaming_and_reordering_the_arms_of_a_cell_permutes_the_torques() -> None:
    document = paper_document()
    renamed = paper_document()
    renamed["arms"] = renamed["arms"][::-1]
    for arm, name in zip(renamed["arms"], ("left", "upper"), strict=True):
        arm["name"] = name
    before = cell_from_toml(tomli_w.dumps(document).encode(), "before")
    after = cell_from_toml(tomli_w.dumps(renamed).encode(), "after")
    for old, new in (("left", "upper"), ("right", "left")):
        torques = []
        for cell, name in ((before, old), (after, new)):
            agent = build_agent(cell, cell.arm(name))
            q = np.array(cell.arm(name).entry.q_near_rad)
            state = JointState(0, q, 0.1 * q, np.zeros(3))
            outcome = step(agent, state, 1.0, Mode.TRACK, initial(3))
            torques.append(outcome.terms.tau_cmd.tobytes() + outcome.tau.tobytes())
        assert torques[0] == torques[1]
