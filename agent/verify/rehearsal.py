"""What `coop check` says of arms in the loop ([hil]): the coupling, the arm on its own, and the clamp."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.schema.hil import Hil
from agent.control import known
from agent.control.inverse import SingularJacobian, pseudo_inverse
from agent.control.models import ArmModel
from agent.control.stability import coupled_inertia, spectral_radius
from agent.control.terms import INTERNAL, OBJECT
from agent.verify.finding import Finding, Verdict, judged
from agent.verify.margin import sampled_loop
from agent.verify.radius import told
from drivers.interface import Vector
from drivers.rehearsal import LEAST_TOUCH_N, STIFFEST

PLACES = 12  # along the trajectory
NO_OBJECT_KG = 1e-9
SHORTEST_M = 1e-3  # lever, of a joint that feels nothing


def examine_rehearsal(
    cell: Cell, models: Sequence[ArmModel], along: Sequence[Sequence[Vector]], instants: Sequence[float]
) -> list[Finding]:
    """Findings on every arm that [hil] names; along[i][k]: joint angles (n,) of arm i at instants[k].

    Nothing without the table.
    """
    hil = cell.file.hil
    if hil is None:
        return []
    findings = [_stiffness(cell, hil)]
    for arm, model, path in zip(cell.arms, models, along, strict=True):
        if arm.name in hil.arms:
            findings += [_port(arm), _alone(cell, arm, model, path), _clamp(cell, hil, arm, model, path, instants)]
            findings.append(_touch(cell, hil, arm, model, path))
    return findings


def _stiffness(cell: Cell, hil: Hil) -> Finding:
    rate_hz = cell.file.rate_hz
    w, delay_s = hil.frequency(rate_hz), hil.delay_s(rate_hz)
    found = f"{w * delay_s:.3f} ({w:.3g} rad/s, {delay_s * 1e3:.3g} ms)"
    return judged(
        "coupling to the twins, w times its delay", "cell", found,
        f"≤ {STIFFEST:g}", holds=w * delay_s <= STIFFEST, remedy="leave frequency_rad_per_s out",
    )  # fmt: skip


def _port(arm: Arm) -> Finding:
    port = arm.entry.dynamixel.port if arm.entry.dynamixel is not None else None
    return judged(
        "port of the arm in the loop", arm.name, port or "none", "a port, or emulated servos", holds=port is not None,
        otherwise=Verdict.WARNING, remedy="add dynamixel = { port = ... }; `coop run --hil` emulates the servos",
    )  # fmt: skip


def _alone(cell: Cell, arm: Arm, model: ArmModel, path: Sequence[Vector]) -> Finding:
    """Spectral radius of the arm that holds nothing and believes in its share of the object: before the coupling."""
    obj, share = cell.file.object, arm.entry.load_share
    inertia, P = np.array(obj.inertia_kg_m2.matrix()), model.task_basis
    loop, radius = sampled_loop(cell, [cell.offline(arm).gains]), 0.0
    for q in path[:: max(1, len(path) // PLACES)]:
        R = model.object_pose(q).rotation
        true = coupled_inertia([model], [q], NO_OBJECT_KG, NO_OBJECT_KG * np.eye(3))
        believed = coupled_inertia([model], [q], share * obj.mass_kg, share * (R @ inertia @ R.T))
        radius = max(radius, spectral_radius(true, believed, P, loop))
    limit = cell.file.radius_max
    return judged(
        "spectral radius of the arm on its own", arm.name, told(radius, limit), f"≤ {limit:g}", holds=radius <= limit,
        remedy="take the gains that `coop tune` proposes: the arm must be stable before it is coupled",
    )  # fmt: skip


def _clamp(
    cell: Cell, hil: Hil, arm: Arm, model: ArmModel, path: Sequence[Vector], instants: Sequence[float]
) -> Finding:
    """Largest torque that the object's part asks of a joint, of the largest addition."""
    trajectory, offline = cell.trajectory(), cell.offline(arm)
    clamp = hil.tau_share * cell.file.safety.tau_max_fraction_of_stall * arm.tau_stall_Nm
    most = 0.0
    for q, t in zip(path, instants, strict=True):
        desired = trajectory.at(t)
        dq = pseudo_inverse(model.jacobian(q)) @ (model.task_basis @ np.array(desired.v))
        try:
            joints = known.torque(model, offline, q, dq, desired).joints
        except SingularJacobian:
            continue  # a finding of its own
        most = max(most, float((np.abs(joints[OBJECT] + joints[INTERNAL]) / clamp).max()))
    return judged(
        "object's part, of the largest addition", arm.name, f"{most:.0%}", "≤ 100%", holds=most <= 1.0,
        remedy="raise tau_share of [hil], or rehearse with a lighter object",
    )  # fmt: skip


def _touch(cell: Cell, hil: Hil, arm: Arm, model: ArmModel, path: Sequence[Vector]) -> Finding:
    """Force where the object is that the joints stand against to any side, beside weight and share of the object."""
    bound = cell.file.safety.tau_max_fraction_of_stall * arm.tau_stall_Nm
    carried_N, least_N = arm.entry.load_share * cell.file.object.mass_kg * -cell.gravity, np.inf
    for q in path[:: max(1, len(path) // PLACES)]:
        J = (model.task_basis.T @ model.jacobian(q))[:3]
        held = model.evaluate(q, np.zeros(arm.n)).g + J.T @ carried_N
        levers = np.maximum(np.linalg.norm(J, axis=0), SHORTEST_M)
        least_N = min(least_N, float(((bound - np.abs(held)) / levers).min()))
    found = f"{least_N:.2g} N to its weakest side"
    return Finding("touch that the arm stands against", arm.name, found, _goes_on(hil))


def _goes_on(hil: Hil) -> str:
    if hil.touch_max_N < LEAST_TOUCH_N:
        return "none: the cell holds"
    return f"the cell goes on with up to {hil.touch_max_N:g} N for {hil.touch_max_s:g} s, else holds"
