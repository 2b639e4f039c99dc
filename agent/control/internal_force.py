"""Internal forces (remark on internal forces of the paper): what every agent adds without moving the object; pure.

The paper takes f_int = (I − G* Gᵀ) f̂ with G* = (1/N) [J_O₁⁻¹ … J_O_N⁻¹]ᵀ and a constant f̂ sent off-line.
G turns with the object, so in world axes the projection changes all the time.  In object axes it does not:
with R = blockdiag(R_O, R_O), S(R_O p) = R_O S(p) R_Oᵀ gives J_O(t) = R J_O Rᵀ with the constant offsets
p^O_{E/O} on the right, hence

    (I − G*(t) Gᵀ(t)) blockdiag(R, …, R) f̂ = blockdiag(R, …, R) (I − G* Gᵀ) f̂ .

So every agent computes its own six rows once, before the start, from the offsets of all grasps, and the
running law only turns them by R_O, which it has from its own kinematics (agent.control.law.rotate_wrench).
A desired wrench f̂ᵢ is meant in object axes: a squeeze stays a squeeze when the object turns.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.control.quaternion import Vec3, cross
from agent.control.trajectory import Vec6


def internal_wrenches(p_object_ee: Sequence[Vec3], desired: Sequence[Vec6]) -> list[Vec6]:
    """f_int,i of every agent at its end effector, object axes (N, N·m): the rows of (I − G* Gᵀ) f̂.

    p_object_ee: p^O_{E_i/O}, grasp points from the object's centre, object axes, m; desired: f̂_i at the end
    effectors, object axes; both one per agent.  The sum of their effects on the object is zero.
    """
    centred = [about_object_centre(p, f) for p, f in zip(p_object_ee, desired, strict=True)]
    share = _mean(centred)  # (1/N) Gᵀ f̂, eq:grasp matrix
    return [_minus(f, _at_end_effector(p, share)) for p, f in zip(p_object_ee, desired, strict=True)]


def agent_wrench(agent: int, p_object_ee: Sequence[Vec3], desired: Sequence[Vec6]) -> Vec6:
    """`agent.control.law.Offline.internal_wrench` of agent number `agent`: J_Oᵀ f_int,i, constant in object axes.

    Arguments as of `internal_wrenches`.  With moments about the object's centre the projection is the wrench
    less the mean of all agents' wrenches.
    """
    centred = [about_object_centre(p, f) for p, f in zip(p_object_ee, desired, strict=True)]
    return _minus(centred[agent], _mean(centred))


def beside_equal_shares(load_shares: Sequence[float]) -> list[float]:
    """c_i − 1/N of every agent: what the paper's G* takes for internal of a load that is meant to be shared unequally.

    Zeros, to the bit, where all shares are the same.
    """
    equal = 1.0 / len(load_shares)
    return [0.0 if len(set(load_shares)) == 1 else share - equal for share in load_shares]


def about_object_centre(p_object_ee: Vec3, wrench_ee: Vec6) -> Vec6:
    """J_Oᵀ f: the wrench about the object's centre of a wrench f at the end effector; both in object axes."""
    fx, fy, fz, mx, my, mz = wrench_ee
    lever = cross(p_object_ee, (fx, fy, fz))
    return (fx, fy, fz, mx + lever[0], my + lever[1], mz + lever[2])  # eq:grasp matrix, one arm's part


def _at_end_effector(p_object_ee: Vec3, wrench_centre: Vec6) -> Vec6:
    """J_O⁻ᵀ f: inverse of `about_object_centre`."""
    fx, fy, fz, mx, my, mz = wrench_centre
    lever = cross(p_object_ee, (fx, fy, fz))
    return (fx, fy, fz, mx - lever[0], my - lever[1], mz - lever[2])  # eq:J_o_i_def


def _mean(wrenches: Sequence[Vec6]) -> Vec6:
    x = [sum(column) / len(wrenches) for column in zip(*wrenches, strict=True)]
    return (x[0], x[1], x[2], x[3], x[4], x[5])


def _minus(a: Vec6, b: Vec6) -> Vec6:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5])
