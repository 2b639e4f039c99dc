"""The figures of a run, from its log alone; what was not measured is NaN, and `missing` says why."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from agent.log.runinfo import RunArm, RunInfo
from agent.log.when import STARTED_S
from agent.modes import Mode
from agent.report.arithmetic import NAN, mean, most, rms
from agent.report.errors import complaints, disagreement, left_apart, pose_errors
from agent.report.found_together import found_together
from agent.report.grip import grip_results
from agent.report.loss import loss_of
from agent.report.pace import Pace, pace_notes
from agent.report.phases import session_of
from agent.report.prepared import Prepared, prepare
from agent.report.rehearsal import added_to, hil_results
from agent.report.results import (
    ArmResults,
    Completeness,
    JointResults,
    Results,
    Spread,
    WrenchSize,
)
from agent.report.series import (
    Array,
    column,
    component,
    durations,
    going_on,
    grasp_force,
    joint_columns,
    largest_force,
    missing_ranges,
)
from agent.report.together import largest
from agent.safety import AT_BOUND, Flag
from agent.telemetry.row.sample import BUS_COUNTERS
from drivers.dynamixel.servo.models import CONTINUOUS_SHARE

if TYPE_CHECKING:
    from agent.log.columns import Table
    from agent.log.read import AnyLog

LATE_PERIODS: Final = 1.0  # a cycle that begins later than this many periods is late, as agent.runner counts them
LIMITED_Nm: Final = 1e-9  # safety changed a torque when it differs from the command by more than rounding


def summarise(log: AnyLog) -> Results:
    """All figures of a run.

    Errors count from the end of the transient to the end of the duration, on ticks that follow the trajectory; means
    of torques, and what the law says of itself, over the motion.  Peaks, limits, flags, modes and loop timing count
    over every row that an arm has, before its start too.  What a log cannot tell is NaN; `Results.missing` says why.
    """
    return summarise_prepared(prepare(log))


@np.errstate(over="ignore", invalid="ignore")  # poses of a run that went astray: what is no number counts as none
def summarise_prepared(run: Prepared) -> Results:
    """The same from a log that is prepared already."""
    info = run.info
    by_arm = {name: pose_errors(run.pose(name), info) for name in run.rows}
    by_plant = None if run.true is None else pose_errors(run.true, info)
    missing = [*run.missing]
    for errors in [*by_arm.values(), *([by_plant] if by_plant else [])]:
        missing += complaints(errors, info)
    rows = {arm.name: _completeness(run, arm.name) for arm in info.arms}
    factor = _real_time_factor(run, missing)
    found, set_down = session_of(run.log)
    arms = {arm.name: _arm(arm, run) for arm in info.arms if arm.name in run.whole}
    missing += [*pace_notes({name: arm.pace for name, arm in arms.items()}), *_infinite(run)]
    return Results(
        info=info,
        complete=run.log.complete and all(not c.gaps for c in rows.values()),
        by_plant=by_plant,
        by_arm=by_arm,
        arms=arms,
        rows=rows,
        arm_disagreement_m=disagreement(run),
        arm_disagreement_left_m=left_apart(run),
        internal_force_mean_N=_internal_force_mean_N(run),
        real_time_factor=factor,
        events=len(run.log.events),
        missing=tuple(missing),
        phases=found,
        set_down_error_m=set_down[0],
        set_down_error_rad=set_down[1],
        together=found_together(run),
        loss=loss_of(run),
        judged=not run.log.unjudged,
    )


# --------------------------------------------------------------------------------------------------------- one arm


def _arm(arm: RunArm, run: Prepared) -> ArmResults:
    whole, info = run.whole[arm.name], run.info
    rows, seen = run.rows.get(arm.name, whole[:0]), run.seen.get(arm.name, whole[:0])
    period_s = 1.0 / info.rate_hz
    e_eta, lyapunov, flags = column(rows, "e_eta"), column(rows, "lyapunov"), whole["flags"]
    signs = np.sign(e_eta[np.isfinite(e_eta) & (e_eta != 0.0)])
    took = durations(whole)
    sent = joint_columns(whole, "tau_sent", len(arm.joints))
    late = took["late_s"]
    return ArmResults(
        model=arm.model,
        modes=_modes(whole),
        flags={flag.name or "": int(np.sum(flags & flag.value != 0)) for flag in Flag if flag},
        joints={joint: _joint(arm, j, whole, rows, period_s) for j, joint in enumerate(arm.joints)},
        late_cycles=int(np.sum(late > LATE_PERIODS * period_s)),
        overruns=int(np.sum(np.nansum([*took.values()], axis=0) > period_s)),
        pace=Pace.of(rows, info.rate_hz),
        timing={f: Spread.of(values) for f, values in took.items()},
        bus={f: int(whole[f][-1]) for f in BUS_COUNTERS},
        wrench_cmd=_wrench_size(column(rows, "wrench_cmd")),
        internal_cmd=_wrench_size(column(rows, "wrench_internal")),
        internal_realised=_internal_realised(arm, run),
        load_share_cmd=arm.load_share,
        load_share_realised=_load_share(arm, run),
        rms_velocity_error_m_per_s=_rms_velocity_error(seen, slice(0, 3), info),
        rms_angular_velocity_error_rad_per_s=_rms_velocity_error(seen, slice(3, 6), info),
        e_eta_start=_at(e_eta, 0),
        e_eta_end=_at(e_eta, -1),
        e_eta_sign_changes=int(np.sum(signs[1:] != signs[:-1])),
        lyapunov_start_J=_at(lyapunov, 0),
        lyapunov_end_J=_at(lyapunov, -1),
        sigma_min=float(np.nanmin(column(rows, "sigma_min"), initial=np.inf)),
        load_max=most(np.where(np.isinf(sent), NAN, np.abs(sent)) / np.array(arm.tau_max_Nm)),
        shift_max_m=largest(whole, "shift", slice(0, 3)),
        shift_max_rad=largest(whole, "shift", slice(3, 6)),
        friction_factor=_at(column(whole, "friction_factor"), -1),
        **_unexpected(whole),
        hil=hil_results(rows, arm.tau_max_Nm),
        grip=grip_results(whole, run.log.servos.get(arm.name)),
    )


def _infinite(run: Prepared) -> list[str]:
    """Torques that no servo can have been sent, by joint: of a damaged log."""
    found = []
    for arm in run.info.arms:
        if arm.name in run.whole:
            counts = np.sum(np.isinf(joint_columns(run.whole[arm.name], "tau_sent", len(arm.joints))), axis=0)
            found += [
                f"{count} torques sent to {joint} of {arm.name} are infinite and count in no figure"
                for joint, count in zip(arm.joints, counts.tolist(), strict=True)
                if count
            ]
    return found


def _at(values: Array, index: int) -> float:
    return float(values[index]) if len(values) else NAN


def _unexpected(rows: Table) -> dict[str, float]:
    names = ("fast_max_N", "fast_max_Nm", "slow_max_N", "slow_max_Nm")
    return {f"unexpected_{name}": most(component(rows, "unexpected", i)) for i, name in enumerate(names)}


def _rms_velocity_error(seen: Table, part: slice, info: RunInfo) -> float:
    error = column(seen, "v_object", part) - column(seen, "v_object_des", part)
    settled = (column(seen, "t") >= info.transient_s) & (seen["mode"] == Mode.TRACK)
    return rms(np.linalg.norm(error[settled], axis=1))


def _joint(arm: RunArm, j: int, whole: Table, rows: Table, period_s: float) -> JointResults:
    cmd, limited, sent = (component(whole, f, j) for f in ("tau_cmd", "tau_limited", "tau_sent"))
    sent = np.where(np.isinf(sent), NAN, sent)
    peak = most(np.abs(sent - added_to(whole, j)))
    law = component(rows, "tau_sent", j) - added_to(rows, j)
    consecutive = np.diff(rows["sequence"]) == 1
    return JointResults(
        peak_torque_Nm=peak,
        peak_torque_fraction=peak / arm.tau_stall_Nm[j],
        rms_torque_Nm=rms(law),
        rms_of_continuous=rms(law) / (CONTINUOUS_SHARE * arm.tau_stall_Nm[j]),
        limited_s=float(np.sum(np.abs(limited - cmd) > LIMITED_Nm) * period_s),
        at_limit_s=float(np.sum(np.abs(sent) >= AT_BOUND * arm.tau_max_Nm[j]) * period_s),
        chatter_Nm=mean(np.where(consecutive, np.abs(np.diff(law)), NAN)),
        tau_max_Nm=arm.tau_max_Nm[j],
        tau_stall_Nm=arm.tau_stall_Nm[j],
    )


# ----------------------------------------------------------------------------------------- internal force, load share


def _internal_realised(arm: RunArm, run: Prepared) -> WrenchSize:
    if run.grasps is None:
        return WrenchSize(NAN, NAN, NAN, NAN)
    settled, i = run.grasps.t >= run.info.transient_s, run.info.arms.index(arm)
    force, moment = run.grasps.internal_force[settled, i], run.grasps.internal_moment[settled, i]
    return WrenchSize(most(force), rms(force), most(moment), rms(moment))


def _internal_force_mean_N(run: Prepared) -> float:
    """Mean after the transient until the first arm holds, of the arm with the most beyond what it was to give."""
    if run.grasps is None:
        return NAN
    begin_s, until_s, t = run.info.transient_s, math.inf, run.grasps.t
    for rows in going_on(run.rows, run.info).values():
        held = rows["t"][(rows["mode"] != Mode.TRACK) & (rows["t"] >= begin_s)]
        until_s = min(until_s, *held[:1].tolist(), math.inf)
    counted = (t >= begin_s) & (t < until_s)
    return mean(largest_force(run.grasps.unasked_force[counted]))


def _load_share(arm: RunArm, run: Prepared) -> float:
    """Σ f_i·f / Σ f·f over the ticks after the transient, f = Σ f_i: the shares of all arms add up to one."""
    if run.grasps is None:
        return NAN
    settled = run.grasps.plant[run.grasps.t >= run.info.transient_s]
    total = sum((grasp_force(settled, i) for i in range(1, len(run.info.arms))), start=grasp_force(settled, 0))
    weight = float(np.nansum(total * total))
    force = grasp_force(settled, run.info.arms.index(arm))
    return float(np.nansum(force * total)) / weight if weight > 0.0 else NAN


# ------------------------------------------------------------------------------------------------------- completeness


def _completeness(run: Prepared, name: str) -> Completeness:
    """Rows of one arm against those it says it wrote; an arm that did not live to say so should have run to the end."""
    rows, info = run.log.agents.get(name), run.info
    sequence = np.empty(0, dtype=np.uint64) if rows is None else rows["sequence"]
    to_its_end = info.ticks
    # an arm that waited for the start with its torque on has rows of that time, too
    if rows is not None and len(rows) and float(rows["t"][-1]) > STARTED_S:
        to_its_end = int(sequence[-1]) + round((info.duration_s - float(rows["t"][-1])) * info.rate_hz)
    told = [event.data.get("ticks") for event in run.log.events if event.source == name]
    written = next((n for n in reversed(told) if isinstance(n, int)), to_its_end)
    recorded = int(np.searchsorted(sequence, written))
    gaps = tuple(missing_ranges(sequence, written))
    return Completeness(written, recorded, written - recorded, len(sequence) - recorded, gaps)


def _modes(rows: Table) -> tuple[tuple[float, str], ...]:
    mode, t = rows["mode"], rows["t"]
    changes = np.flatnonzero(np.diff(mode, prepend=mode[:1] + 1))
    known = {m.value: m.name for m in Mode}
    return tuple((float(t[i]), known.get(int(mode[i]), f"mode {mode[i]}")) for i in changes)


def _real_time_factor(run: Prepared, missing: list[str]) -> float:
    """Time of the run over wall time, of the slowest arm.

    Each agent says at its end how long the run took by the wall (`wall_s` of its event).  Without that the rows' UTC
    must do; in simulation it may be mapped from the simulated clock, and then says nothing of the wall.
    """
    tracked = {name: rows[rows["mode"] == Mode.TRACK.value] for name, rows in run.rows.items()}
    spans = {name: float(rows["t"][-1] - rows["t"][0]) for name, rows in tracked.items() if len(rows) > 1}
    walls = [(event.source, event.data.get("wall_s")) for event in run.log.events]
    told = {source: wall for source, wall in walls if isinstance(wall, float | int) and wall > 0}
    factors = []
    for name, span in spans.items():
        rows = tracked[name]
        utc_ns, stamp_ns = (int(rows[f][-1]) - int(rows[f][0]) for f in ("utc_ns", "stamp_ns"))
        if name in told:
            factors.append(span / told[name])
        elif run.info.driver == "sim" and utc_ns == stamp_ns:
            missing.append("the real-time factor is not known: UTC in the rows follows the simulated clock")
            return NAN
        elif utc_ns > 0:
            factors.append(span / (utc_ns * 1e-9))
    if not factors:
        why = "the rows' UTC does not go on" if spans else "no arm followed the trajectory for two cycles"
        missing.append(f"the real-time factor is not known: {why}")
    return min(factors, default=NAN)


def _wrench_size(wrenches: Array) -> WrenchSize:
    force, moment = np.linalg.norm(wrenches[:, :3], axis=1), np.linalg.norm(wrenches[:, 3:], axis=1)
    return WrenchSize(most(force), rms(force), most(moment), rms(moment))
