"""Time series of a run as plain arrays: attitude arithmetic, poses against the desired ones, rows matched in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from agent.control.internal_force import beside_equal_shares
from agent.log.unshifted import unshifted
from agent.log.when import SAME_CLOCK_NS, in_lockstep
from agent.modes import Mode
from agent.safety import Flag

if TYPE_CHECKING:
    from agent.log.columns import Table
    from agent.log.runinfo import Plane, RunInfo

Array = NDArray[np.float64]

DURATIONS: Final = ("late_s", "read_s", "step_s", "write_s")  # of a cycle, as its row has them


# ------------------------------------------------------------------------------------------------ attitude, row by row


def attitude_error(quat_des: Array, quat: Array) -> Array:
    """e_ξ = ξ_d ⊗ ξ_O*, `(k, 4)` scalar first, normalised, from two `(k, 4)`."""
    eta_d, eps_d = quat_des[:, :1], quat_des[:, 1:]
    eta, eps = quat[:, :1], quat[:, 1:]
    # eq:quat_error
    e_eta = eta * eta_d + np.sum(eps * eps_d, axis=1, keepdims=True)
    e_eps = eta * eps_d - eta_d * eps + np.cross(eps, eps_d)
    e = np.hstack([e_eta, e_eps])
    return np.asarray(e / np.linalg.norm(e, axis=1, keepdims=True))


def rotation_angle(quat: Array) -> Array:
    """Angle of each rotation, `(k,)` rad in [0, π].

    2 atan2(‖ε‖, |η|) and not 2 acos |η|, which is blind below 1e-8 rad and wrong by percents at 1e-7.
    """
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(quat[:, 1:], axis=1), np.abs(quat[:, 0])))


def rotation_vector(quat: Array) -> Array:
    """Axis times angle of each rotation, `(k, 3)` rad, the shorter way round."""
    sine = np.linalg.norm(quat[:, 1:], axis=1)
    angle = rotation_angle(quat)
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = np.where(sine > 0.0, angle / sine, 2.0) * np.where(quat[:, 0] < 0.0, -1.0, 1.0)
    return np.asarray(quat[:, 1:] * gain[:, None])


def angle_about(quat: Array, plane: Plane) -> Array:
    """Angle about the plane's normal, `(k,)` rad in (−π, π]: φ_O of the paper's figure."""
    half = np.arctan2(plane.sign * quat[:, 1 + plane.normal], quat[:, 0])
    return np.asarray(np.pi - np.mod(np.pi - 2.0 * half, 2.0 * np.pi))


def rotate(quat: Array, vector: Array) -> Array:
    """R(ξ) v for each row of `quat` `(k, 4)` and one `vector` `(3,)`."""
    w, u = quat[:, :1], quat[:, 1:]
    t = 2.0 * np.cross(u, vector)
    return np.asarray(vector + w * t + np.cross(u, t))


# ------------------------------------------------------------------------------------------------------------ poses


@dataclass(frozen=True, slots=True)
class PoseSeries:
    """A pose against the desired one; all arrays have one row per tick and rows are in time order."""

    source: str  # "plant" or the arm's name
    sequence: NDArray[np.uint64]
    t: Array
    p_des: Array
    quat_des: Array
    p: Array
    quat: Array
    e_p: Array  # eq:position error
    e_xi: Array  # eq:quat_error, of the representative whose sign the arms' own e_η has
    tracking: NDArray[np.bool_]  # the desired pose is the trajectory's, not one that an arm holds

    @property
    def position_error(self) -> Array:
        """‖e_p‖, m."""
        return np.asarray(np.linalg.norm(self.e_p, axis=1))

    @property
    def attitude_error(self) -> Array:
        """Angle of e_ξ, rad."""
        return rotation_angle(self.e_xi)


def column(rows: Table, name: str, part: slice | None = None) -> Array:
    """One float field of the rows, or a part of each of its arrays, as a contiguous array."""
    return np.ascontiguousarray(rows.column(name, part), dtype=np.float64)


def joint_columns(rows: Table, name: str, joints: int) -> Array:
    """A joint field without its padding, `(k, joints)`."""
    return column(rows, name, slice(0, joints))


def component(rows: Table, name: str, number: int) -> Array:
    """One number of an array field, `(k,)`."""
    return column(rows, name, slice(number, number + 1))[:, 0]


def grasp_wrenches(plant: Table, arms: int) -> Array:
    """Wrench of each arm on the object at its end effector, `(k, arms, 6)`, world axes."""
    return column(plant, "grasp_wrench", slice(0, 6 * arms)).reshape(len(plant), arms, 6)


def grasp_force(plant: Table, arm: int) -> Array:
    """Force of one arm on the object, `(k, 3)`, world axes."""
    return column(plant, "grasp_wrench", slice(6 * arm, 6 * arm + 3))


def in_run(rows: Table, info: RunInfo) -> Table:
    """The rows of the trajectory, without what was logged before its zero and after its end."""
    t, half_s = rows["t"], 0.5 / info.rate_hz
    return rows[(t >= -half_s) & (t < info.duration_s - half_s)]


def going_on(arms: Mapping[str, Table], info: RunInfo) -> Mapping[str, Table]:
    """Rows by arm, of one that a fault of the simulated cell lets go limp or stops those before it: as a study counts.

    All of them where that leaves no arm.
    """
    if all(name in info.struck_s for name in arms):
        return arms
    return {name: rows[rows["t"] < info.struck_s.get(name, np.inf)] for name, rows in arms.items()}


def is_stale(rows: Table) -> NDArray[np.bool_]:
    """Rows (k,) of cycles that brought no fresh state: they say what was wanted, not what was."""
    return np.asarray(rows["flags"] & Flag.STALE.value != 0)


def durations(rows: Table) -> dict[str, Array]:
    """DURATIONS, each `(k,)` s; NaN where nothing was measured.

    Earlier releases left those of the row before it in a row without a fresh state: such a copy is no measurement.
    """
    took = np.stack([column(rows, name) for name in DURATIONS])
    copied = np.zeros(len(rows), dtype=bool)
    copied[1:] = is_stale(rows)[1:] & (took[:, 1:] == took[:, :-1]).all(axis=0)
    return dict(zip(DURATIONS, np.where(copied, np.nan, took), strict=True))


def pose_by_arm(name: str, rows: Table) -> PoseSeries:
    """The object's pose as one arm's own kinematics see it."""
    p, p_des = column(rows, "p_object"), column(rows, "p_object_des")
    quat, quat_des = column(rows, "quat_object"), column(rows, "quat_object_des")
    e_xi = _with_sign_of(column(rows, "e_eta"), attitude_error(quat_des, quat))
    tracking = np.asarray(rows["mode"] == Mode.TRACK)
    t, sequence = column(rows, "t"), rows["sequence"].copy()
    return PoseSeries(name, sequence, t, p_des, quat_des, p, quat, p - p_des, e_xi, tracking)


def pose_by_plant(arms: Mapping[str, Table], plant: Table, period_s: float) -> tuple[PoseSeries | None, str]:
    """The true pose against the desired one of the same tick, and a note for the reader, empty when all is well.

    `arms`: rows by arm.  Rows are matched by sequence number in lockstep, and unless the time stamps of one tell that
    plant and arm count from different instants, or that an arm has missed cycles; then by the stamps, or by UTC where
    the stamps are of different clocks.
    """
    half_ns = round(0.5e9 * period_s)
    in_step = in_lockstep([plant, *(rows for rows in arms.values() if len(rows))])
    for clock, tolerance, witness, allowed_ns, judged in (
        ("sequence", 0, "stamp_ns", half_ns, np.max),
        ("stamp_ns", half_ns, "utc_ns", SAME_CLOCK_NS, np.median),
        ("utc_ns", half_ns, "utc_ns", half_ns, np.median),
    ):
        at = [nearest(rows[clock], plant[clock], tolerance) for rows in arms.values()]
        if not any((i >= 0).any() for i in at):
            continue
        apart_ns = [
            plant[witness][i >= 0] - rows[witness][i[i >= 0]] for rows, i in zip(arms.values(), at, strict=True)
        ]
        if not in_step and judged(np.abs(np.concatenate(apart_ns))) > allowed_ns:
            continue
        held: NDArray[np.bool_] = np.any([i >= 0 for i in at], axis=0)
        note = f"plant rows are matched by {clock}: their sequence numbers are of other instants than the arms'"
        return _true_pose(arms, [i[held] for i in at], plant[held]), "" if clock == "sequence" else note
    return None, "no tick is in both the plant's and an arm's log: errors are by the arms' own kinematics"


def _true_pose(arms: Mapping[str, Table], at: list[NDArray[np.intp]], true: Table) -> PoseSeries:
    """`at`: for each arm and plant row the index of the arm's row, −1 where it has none; some arm has one."""
    first = np.argmax(np.array(at) >= 0, axis=0)  # the first arm that logged the tick
    k = len(true)
    p_des, quat_des, e_eta, t = np.empty((k, 3)), np.empty((k, 4)), np.empty(k), np.empty(k)
    tracking = np.ones(k, dtype=bool)
    for number, ((name, rows), i) in enumerate(zip(arms.items(), at, strict=True)):
        seen, own = pose_by_arm(name, rows), first == number
        from_row = i[own]
        shift = column(rows, "shift")[from_row]
        p_des[own], quat_des[own] = unshifted(seen.p_des[from_row], seen.quat_des[from_row], shift)
        e_eta[own], t[own] = seen.e_xi[from_row, 0], seen.t[from_row]
        tracking[i >= 0] &= seen.tracking[i[i >= 0]]
    p, quat = column(true, "p_object"), column(true, "quat_object")
    e_xi = _with_sign_of(e_eta, attitude_error(quat_des, quat))
    return PoseSeries("plant", true["sequence"].copy(), t, p_des, quat_des, p, quat, p - p_des, e_xi, tracking)


def nearest(keys: NDArray[np.generic], wanted: NDArray[np.generic], tolerance: int) -> NDArray[np.intp]:
    """Index of the nearest of the sorted `keys` for each of `wanted`, −1 where none is within `tolerance`."""
    have, want = keys.astype(np.int64), wanted.astype(np.int64)
    if not len(have):
        return np.full(len(want), -1, np.intp)
    above = np.minimum(np.searchsorted(have, want), len(have) - 1)
    below = np.maximum(above - 1, 0)
    index = np.where(np.abs(have[below] - want) < np.abs(have[above] - want), below, above)
    return np.asarray(np.where(np.abs(have[index] - want) <= tolerance, index, -1))


def same_ticks(one: Table, other: Table, period_s: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the rows of two arms that are of one instant of the trajectory, to half a period; each (k,).

    Their sequence numbers part where one of them misses a cycle.
    """
    keys = [np.rint(rows["t"] * 1e9).astype(np.int64) for rows in (one, other)]
    there = nearest(keys[1], keys[0], round(0.5e9 * period_s))
    here = np.flatnonzero(there >= 0)
    return here, there[here]


def _with_sign_of(e_eta: Array, e_xi: Array) -> Array:
    # e_ξ and −e_ξ are one rotation; the figures show the one the law worked with
    return np.where((e_eta * e_xi[:, 0] < 0.0)[:, None], -e_xi, e_xi)


# ------------------------------------------------------------------------------------------------- rows that are absent


def missing_ranges(sequence: NDArray[np.uint64], ticks: int) -> list[tuple[int, int]]:
    """First and last number of every stretch of 0 … ticks−1 that is not in the sorted, unique `sequence`."""
    edges = np.concatenate([[-1], sequence[sequence < ticks].astype(np.int64), [ticks]])
    jumps = np.flatnonzero(np.diff(edges) > 1)
    return [(int(edges[i]) + 1, int(edges[i + 1]) - 1) for i in jumps]


def largest_or_zero(values: Array) -> float:
    """The largest of these, zero of none; NaN where one of them is."""
    return float(values.max()) if len(values) else 0.0


def largest_force(internal: Array) -> Array:
    """Size of the force of the arm with the most, `(k,)` N, from sizes `(k, N)`; what is no number counts as none."""
    most = internal.max(axis=1)
    return np.asarray(np.where(np.isfinite(most), most, 0.0))


def internal_wrenches(wrenches: Array, quat: Array, p_object_ee: Array | None) -> Array:
    """Internal part of the grasp wrenches, (I − G* Gᵀ) f, `(k, N, 6)`; moments are NaN without the grasp offsets.

    G* = (1/N) [J_O1⁻¹ … J_ON⁻¹]ᵀ, the paper's equal-share generalised inverse: every arm is charged 1/N of the
    wrench on the object's centre of mass, carried to its own end effector; what is left moves nothing.
    With J_O = [[I, S(p)], [0, I]] and p = p_O/E:  Jᵀ[f; m] = [f; m − p × f],  J⁻ᵀ[F; M] = [F; M + p × F].
    `wrenches` `(k, N, 6)` at the end effectors in world axes, `quat` `(k, 4)` of the object, `p_object_ee` `(N, 3)`.
    """
    internal = np.full_like(wrenches, np.nan)
    force, moment = wrenches[:, :, :3], wrenches[:, :, 3:]
    share_force = force.mean(axis=1, keepdims=True)
    internal[:, :, :3] = force - share_force
    if p_object_ee is None:
        return internal
    arm_count = wrenches.shape[1]
    p = np.stack([-rotate(quat, p_object_ee[i]) for i in range(arm_count)], axis=1)
    share_moment = (moment - np.cross(p, force)).mean(axis=1, keepdims=True)
    internal[:, :, 3:] = moment - (share_moment + np.cross(p, share_force))
    return internal


def meant_by_shares(wrenches: Array, load_shares: Sequence[float], normal: Array | None) -> Array:
    """What of the forces of `internal_wrenches` the load shares mean, (c_i − 1/N) Σ_j f_j, `(k, N, 3)` N, world axes.

    Zeros with equal shares.  normal: of the plane that the arms move in, `(3,)`: out of it they share nothing.
    """
    beside = np.array(beside_equal_shares(load_shares))
    if not beside.any():
        return np.zeros((*wrenches.shape[:2], 3))
    load = wrenches[:, :, :3].sum(axis=1)
    if normal is not None:
        load = load - (load @ normal)[:, None] * normal
    return np.asarray(beside[:, None] * load[:, None, :])
