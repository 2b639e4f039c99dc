"""Where everything of a run was at a few instants a second, taken from the columns of its log.

An instant at which an arm has no row shows the arm's last one before it, and `fresh` says so.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.log.columns import Table
from agent.log.unshifted import unshifted
from agent.report.prepared import Prepared
from agent.report.series import column, component, grasp_wrenches, internal_wrenches, joint_columns
from agent.view.pose import Array, poses

PICTURES_HZ: Final = 20.0
PICTURES_MAX: Final = 6000  # a longer run is shown in fewer pictures a second


@dataclass(frozen=True, slots=True)
class ArmMotion:
    """One arm at k instants."""

    q: Array  # (k, n) rad, of the controlled joints
    belief: Array  # (k, 7) pose of the object by this arm's own kinematics
    desired: Array  # (k, 7) beside a true object the pose that all steer to, else the one that this arm does
    force_cmd: Array  # (k, 3) N, of the commanded wrench at its end effector, world axes
    internal: Array  # (k, 3) N, of the internal wrench there: realised where a simulation tells it, else commanded
    mode: NDArray[np.int64]  # (k,)
    fresh: NDArray[np.bool_]  # (k,) the arm has a row of this instant
    grasps: NDArray[np.bool_]  # (k,) its grasp is closed, as far as a simulation tells

    def at(self, which: NDArray[np.bool_]) -> ArmMotion:
        """At some of the instants."""
        return ArmMotion(*(getattr(self, f.name)[which] for f in fields(self)))


@dataclass(frozen=True, slots=True)
class Motion:
    """Everything at k instants."""

    t: Array  # (k,) s of the run
    arms: Mapping[str, ArmMotion]
    true: Array | None  # (k, 7) of the object, in simulation

    @property
    def object(self) -> Array:
        """Where the object is shown, (k, 7): where it truly is, on real arms where the first arm believes it."""
        return next(iter(self.arms.values())).belief if self.true is None else self.true

    def row_at(self, t: float) -> int:
        """The last instant that is not after `t`; the first before all."""
        return max(0, int(np.searchsorted(self.t, t + 1e-6, side="right")) - 1)

    def within(self, begin_s: float, end_s: float) -> Motion:
        """The instants from one time to before another."""
        which = (self.t >= begin_s - 1e-9) & (self.t < end_s - 1e-9)
        arms = {name: arm.at(which) for name, arm in self.arms.items()}
        return Motion(self.t[which], arms, None if self.true is None else self.true[which])


def motion_of(run: Prepared, pictures_hz: float = PICTURES_HZ, begin_s: float = 0.0, end_s: float = np.inf) -> Motion:
    """The motion of a run that has a row, from one time, or its first instant, to before another, or its last."""
    first = max(begin_s, min(float(rows["t"][0]) for rows in run.rows.values()))
    last = min(end_s - 1e-6, max(float(rows["t"][-1]) for rows in run.rows.values()))
    count = min(PICTURES_MAX, 1 + max(0, int((last - first) * pictures_hz + 1e-9)))
    t = first + np.arange(count) / pictures_hz if count < PICTURES_MAX else np.linspace(first, last, count)
    half_s = 0.75 / run.info.rate_hz
    seen = run.true is not None and run.grasps is not None
    arms = {arm.name: _arm(run.rows[arm.name], t, half_s, len(arm.joints), beside_truth=seen) for arm in run.arms}
    if run.true is None or run.grasps is None:
        return Motion(t, arms, None)
    at = _latest(run.true.t, t)
    true = poses(run.true.p[at], run.true.quat[at])
    plant = run.grasps.plant[_latest(run.grasps.t, t)]
    numbers = {arm.name: i for i, arm in enumerate(run.info.arms)}
    arms = _beside_plant(arms, plant, numbers, len(run.info.arms))
    return Motion(t, arms, true)


def motion_now(
    arms: Mapping[str, NDArray[np.void]], plant: NDArray[np.void] | None, silent: Collection[str] = ()
) -> Motion | None:
    """One instant of a run that goes on, from the newest row (1,) of each arm and of the plant; None without an arm.

    silent: arms of which no row has come for a while: what is seen of them is not of now.
    """
    if not arms:
        return None
    t = np.array([max(float(rows["t"][0]) for rows in arms.values())])
    seen = plant is not None
    own = {
        name: _arm(Table.of(rows), t, np.inf, int(rows["joint_count"][0]), beside_truth=seen)
        for name, rows in arms.items()
    }
    own |= {name: replace(own[name], fresh=np.zeros(1, np.bool_)) for name in silent if name in own}
    if plant is None:
        return Motion(t, own, None)
    some = Table.of(plant)
    count = int(plant["arm_count"][0])
    if count == len(own):  # the plant has its arms in the cell's order, as `arms` has
        own = _beside_plant(own, some, {name: i for i, name in enumerate(own)}, count)
    return Motion(t, own, poses(column(some, "p_object"), column(some, "quat_object")))


def joined(motions: Sequence[Motion]) -> Motion:
    """Several motions of the same arms, one after the other."""
    arms = {
        name: ArmMotion(*(np.concatenate([getattr(m.arms[name], f.name) for m in motions]) for f in fields(ArmMotion)))
        for name in motions[0].arms
    }
    true = [m.object for m in motions] if any(m.true is not None for m in motions) else None
    return Motion(np.concatenate([m.t for m in motions]), arms, None if true is None else np.concatenate(true))


def _arm(rows: Table, t: Array, half_s: float, joints: int, *, beside_truth: bool) -> ArmMotion:
    own = column(rows, "t")
    at = _latest(own, t, half_s)
    some = rows[at]
    desired = column(some, "p_object_des"), column(some, "quat_object_des")
    if beside_truth:
        desired = unshifted(*desired, column(some, "shift"))
    return ArmMotion(
        q=joint_columns(some, "q", joints),
        belief=poses(column(some, "p_object"), column(some, "quat_object")),
        desired=poses(*desired),
        force_cmd=column(some, "wrench_cmd", slice(0, 3)),
        internal=column(some, "wrench_internal", slice(0, 3)),
        mode=some["mode"].astype(np.int64),
        fresh=np.abs(own[at] - t) <= half_s,
        grasps=np.ones(len(t), np.bool_),
    )


def _beside_plant(
    arms: Mapping[str, ArmMotion], plant: Table, numbers: Mapping[str, int], count: int
) -> dict[str, ArmMotion]:
    """The arms with what k rows of a plant of so many arms tell: internal force as the report has it, closed grasps."""
    internal = internal_wrenches(grasp_wrenches(plant, count), column(plant, "quat_object"), None)[:, :, :3]
    return {
        name: replace(
            arm,
            internal=internal[:, numbers[name]],
            grasps=~np.isnan(component(plant, "contact_error_m", numbers[name])),
        )
        for name, arm in arms.items()
    }


def _latest(own: Array, t: Array, ahead_s: float = 1e-9) -> NDArray[np.intp]:
    """Index of the last of the sorted `own` that is not after each of `t` (but by rounding); the first before all."""
    return np.maximum(np.searchsorted(own, t + ahead_s, side="right") - 1, 0)
