"""What a run with faults shows: when it was noticed, what the arms did, and what became of forces and of the object."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from agent.config.cell import Cell
from agent.faults.bench import ArmRun, Rehearsal
from agent.faults.plan import Kind, Target
from agent.modes import Mode
from agent.report.series import internal_wrenches, largest_or_zero, meant_by_shares
from agent.safety import Flag
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.interface import Vector

TELLING: Final = (
    Flag.NOT_FINITE | Flag.SINGULAR | Flag.STALE | Flag.OFF_TRACK | Flag.UNEXPECTED | Flag.DAMPED | Flag.GAP
)
STOPPED: Final = frozenset({Mode.HOLD, Mode.FAULT, Mode.OFF, Mode.LOWER})
GONE: Final = "gone"
NS: Final = 1e-9


@dataclass(frozen=True)
class Measured:
    """Figures of a run; times from the first fault, forces and ways from then on."""

    noticed_s: float | None  # by any arm
    noticed: str  # by whom, and how
    stopped_s: Mapping[str, float | None]  # by arm: until it left the motion; None: it did not
    ended: Mapping[str, str]  # by arm: the mode in which it ended, or what ended it
    why: Mapping[str, str]  # by arm: the reason it gave, empty without one
    internal_N: float  # largest part of an arm's force that moves nothing, beyond what its load share means
    internal_before_N: float  # the same before the fault
    sag_m: float  # by how much the object fell below where it should be
    moved_rad: float  # by a joint of an arm with a fault, within the servos' watchdog time
    speed_rad_per_s: float  # of the fastest joint
    others_rad_per_s: float  # of the fastest joint of an arm without a fault
    fall_m_per_s: float  # of the object, downwards
    torque_share: float  # of the largest torque allowed, of the joint with the most
    apart_rad: float = 0.0  # of an arm in the loop and its twin, the joint with the most
    strayed_m: float = 0.0  # by which the object left its way, or the place at which it was first stopped
    misled_rad: float = 0.0  # by which a joint was not where an arm with a fault took it to be while it followed

    @property
    def grown_N(self) -> float:
        """By how much the largest internal force from the fault on is more than that of the motion before it."""
        return self.internal_N - self.internal_before_N

    @property
    def reacted_s(self) -> float | None:
        """Until the last arm that lives has left the motion; None where one of them goes on."""
        times = [t for arm, t in self.stopped_s.items() if self.ended[arm] != GONE]
        return None if not times or None in times else max(t for t in times if t is not None)

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "noticed_s": _rounded(self.noticed_s),
            "noticed": self.noticed,
            "reacted_s": _rounded(self.reacted_s),
            "stopped_s": {arm: _rounded(t) for arm, t in self.stopped_s.items()},
            "ended": dict(self.ended),
            "why": dict(self.why),
            "internal_force_N": _rounded(self.internal_N),
            "internal_force_before_N": _rounded(self.internal_before_N),
            "sag_m": _rounded(self.sag_m),
            "moved_rad": _rounded(self.moved_rad),
            "speed_rad_per_s": _rounded(self.speed_rad_per_s),
            "others_rad_per_s": _rounded(self.others_rad_per_s),
            "fall_m_per_s": _rounded(self.fall_m_per_s),
            "torque_share": _rounded(self.torque_share),
            "apart_rad": _rounded(self.apart_rad),
            "strayed_m": _rounded(self.strayed_m),
            "misled_rad": _rounded(self.misled_rad),
        }


def measured(run: Rehearsal) -> Measured:
    """The figures of a run, from its first fault on; without one from the common start."""
    onset = min((fault.onset_s for fault in run.faults), default=0.0)
    t = np.array([at for at, _ in run.truth])
    after = t >= onset
    found = sorted((at, text) for name, arm in run.arms.items() for at, text in _noticed(name, arm, run, onset))
    stopped = {name: _stopped(arm, run, onset) for name, arm in run.arms.items()}
    lost = {str(fault.arm) for fault in run.faults if (fault.target, fault.kind) == (Target.GRASP, Kind.OFF)}
    first_stop = min((at for name, at in stopped.items() if at is not None and name not in lost), default=math.inf)
    force = _internal(run)
    return Measured(
        noticed_s=found[0][0] - onset if found else None,
        noticed=found[0][1] if found else "",
        stopped_s={name: None if at is None else at - onset for name, at in stopped.items()},
        ended={name: _end(arm) for name, arm in run.arms.items()},
        why={name: _why(arm) for name, arm in run.arms.items()},
        internal_N=largest_or_zero(force[after]),
        internal_before_N=largest_or_zero(force[~after & (t >= 0.0)]),
        sag_m=_sag(run, t, onset, first_stop),
        moved_rad=_moved(run, t, onset),
        speed_rad_per_s=largest_or_zero(np.array([np.abs(seen.dq).max() for _, seen in run.truth])[after]),
        others_rad_per_s=_others(run, t, onset),
        fall_m_per_s=_fall(run, t, onset),
        torque_share=max((_share(run.cell, name, arm, run, onset) for name, arm in run.arms.items()), default=0.0),
        apart_rad=max((_apart(run.cell, name, arm, run, onset) for name, arm in run.arms.items()), default=0.0),
        strayed_m=_strayed(run, t, onset, first_stop),
        misled_rad=max((_misled(run, str(fault.arm), onset) for fault in run.faults if fault.arm), default=0.0),
    )


def _noticed(name: str, arm: ArmRun, run: Rehearsal, onset: float) -> Iterator[tuple[float, str]]:
    """What an arm said after the fault began; times on the trajectory's clock."""
    rows, t = _timed(arm, run)
    if len(rows):
        telling = np.flatnonzero((rows["flags"] & int(TELLING) != 0) & (t >= onset))
        if len(telling):
            flags = Flag(int(rows["flags"][telling[0]])) & TELLING
            yield float(t[telling[0]]), f"{name}: {flags.name}"
    for at, event in arm.events:
        if at >= onset:
            yield at, f"{name}: {event.kind.value}"
    for at, text in arm.warnings:
        if at >= onset:
            yield at, f"{name}: {text}"
    for at, mode in arm.modes:
        if at >= onset and mode in STOPPED:
            yield at, f"{name}: {mode.name}"
    if arm.error is not None and len(rows):
        yield float(max(t[-1], onset)), f"{name}: {arm.error.what}"


def _stopped(arm: ArmRun, run: Rehearsal, onset: float) -> float | None:
    """When the arm left the motion, or gave up."""
    times = [at for at, mode in arm.modes if mode in STOPPED and at >= onset]
    ended = arm.summary is not None and arm.summary.mode in STOPPED
    if (ended or arm.error is not None) and not times:
        _, t = _timed(arm, run)
        times = [float(t[-1])] if len(t) else []
    return min(times, default=None)


def _end(arm: ArmRun) -> str:
    if arm.summary is not None:
        return arm.summary.mode.name
    return GONE if arm.error is None else type(arm.error).__name__


def _why(arm: ArmRun) -> str:
    if arm.error is not None:
        return str(arm.error)
    return "" if arm.summary is None else arm.summary.reason


def _timed(arm: ArmRun, run: Rehearsal) -> tuple[Any, Vector]:
    """Its rows, and their times on the trajectory's clock (not on the arm's own, which may be wrong)."""
    rows = arm.rows
    return rows, (rows["stamp_ns"].astype(np.int64) - run.zero_ns) * NS


def _internal(run: Rehearsal) -> Vector:
    wrenches = np.array([seen.grasp_wrench for _, seen in run.truth])
    quats = np.array([seen.quat_object for _, seen in run.truth])
    shares = [arm.entry.load_share for arm in run.cell.arms]
    meant = meant_by_shares(wrenches, shares, run.cell.model(run.cell.arms[0]).plane_normal)
    sizes: Vector = np.linalg.norm(internal_wrenches(wrenches, quats, None)[:, :, :3] - meant, axis=2).max(axis=1)
    return np.where(np.isfinite(sizes), sizes, 0.0)


def _sag(run: Rehearsal, t: Vector, onset: float, stop: float) -> float:
    """Below the desired height while all follow, and below the height of the first stop after it."""
    g = run.cell.gravity
    size = float(np.linalg.norm(g))
    if not size:
        return 0.0
    up, desired = -g / size, run.cell.trajectory()
    height = np.array([seen.p_object for _, seen in run.truth]) @ up
    at_stop = float(np.interp(stop, t, height)) if math.isfinite(stop) else math.inf
    wanted = [at_stop if at >= stop else float(np.dot(desired.at(max(at, 0.0)).p, up)) for at in t]
    return max(0.0, largest_or_zero((np.array(wanted) - height)[t >= onset]))


def _strayed(run: Rehearsal, t: Vector, onset: float, stop: float) -> float:
    """Farthest from its desired position, counted from how it was off at onset.

    That stands from the first stop of an arm that has the object on: whoever lost it stops without it.
    """
    desired = run.cell.trajectory()
    wanted = np.array([desired.at(max(min(at, stop), 0.0)).p for at in t])
    off = np.array([seen.p_object for _, seen in run.truth]) - wanted
    after = t >= onset
    return largest_or_zero(np.linalg.norm(off[after] - off[after][:1], axis=1))


def _misled(run: Rehearsal, name: str, onset: float) -> float:
    """Largest error of a joint's value that the arm computed a torque of the motion from."""
    arm, (rows, t) = run.cell.arm(name), _timed(run.arms[name], run)
    used = (t >= onset) & (rows["mode"] == Mode.TRACK) & (rows["flags"] & int(Flag.STALE) == 0)
    if not used.any():
        return 0.0
    begin = sum(each.n for each in run.cell.arms[: run.cell.index(name)])
    times, true = np.array([at for at, _ in run.truth]), np.array([seen.q for _, seen in run.truth])
    joints = (np.interp(t[used], times, true[:, begin + j]) for j in range(arm.n))
    return largest_or_zero(np.abs(rows["q_measured"][used][:, : arm.n].T - np.array(list(joints))).ravel())


def _moved(run: Rehearsal, t: Vector, onset: float) -> float:
    """Farthest way of a joint of the arms with a fault within the watchdog's time, from where it was."""
    window = (t >= onset) & (t <= onset + WATCHDOG_S)
    if not window.any():
        return 0.0
    q = np.array([seen.q for _, seen in run.truth])[window]
    struck, begin, most = {str(fault.arm) for fault in run.faults}, 0, 0.0
    for arm in run.cell.arms:
        if arm.name in struck:
            most = max(most, float(np.abs(q[:, begin : begin + arm.n] - q[0, begin : begin + arm.n]).max()))
        begin += arm.n
    return most


def _others(run: Rehearsal, t: Vector, onset: float) -> float:
    """Speed of the fastest joint of the arms to which nothing was done."""
    struck = {str(fault.arm) for fault in run.faults}
    own = np.concatenate([np.full(arm.n, arm.name not in struck) for arm in run.cell.arms])
    return largest_or_zero(np.abs(np.array([seen.dq for _, seen in run.truth])[t >= onset][:, own]).ravel())


def _fall(run: Rehearsal, t: Vector, onset: float) -> float:
    """Largest speed at which the object went down."""
    after = t >= onset
    if after.sum() < 2:
        return 0.0
    g = run.cell.gravity
    down = g / np.linalg.norm(g) if g.any() else g
    depth = np.array([seen.p_object for _, seen in run.truth]) @ down
    return max(0.0, largest_or_zero(np.gradient(depth[after], t[after])))


def _share(cell: Cell, name: str, arm: ArmRun, run: Rehearsal, onset: float) -> float:
    rows, t = _timed(arm, run)
    own = cell.arm(name)
    if not len(rows):
        return 0.0
    bound = own.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall
    sent = np.abs(rows["tau_sent"][:, : own.n]) / bound
    return largest_or_zero(np.nan_to_num(sent[t >= onset]).ravel())


def _apart(cell: Cell, name: str, arm: ArmRun, run: Rehearsal, onset: float) -> float:
    rows, t = _timed(arm, run)
    if name not in cell.file.looped or not len(rows):
        return 0.0
    apart = np.abs(rows["q_twin"] - rows["q_measured"])[:, : cell.arm(name).n]
    return largest_or_zero(np.nan_to_num(apart[t >= onset]).ravel())


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 5)
