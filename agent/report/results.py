"""The results of a run as frozen records, each figure with its unit, and as the content of results.json."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Final

import numpy as np

from agent.log.runinfo import Bounded, RunInfo
from agent.report.arithmetic import NAN
from agent.report.decay import AttitudeDecay, PositionDecay
from agent.report.found_together import FoundTogether
from agent.report.grip import GripResults
from agent.report.loss import Loss, loss_keys
from agent.report.pace import Pace
from agent.report.phases import Phase
from agent.report.quantity import Better, Quantity, Unit, flatten, json_ready, units_of
from agent.report.rehearsal import HilResults
from agent.report.series import Array

SCHEMA: Final = 2  # of results.json; grows when a key changes its meaning


class Judgement(Enum):
    """What a bound says of a figure."""

    MET = "met"
    NOT_MET = "not met"
    NOT_SHOWN = "not shown"  # nothing measured, or a part of the run cannot be judged


Metres = Annotated[float, Unit("m")]
Radians = Annotated[float, Unit("rad")]
Seconds = Annotated[float, Unit("s")]
Torque = Annotated[float, Unit("N·m")]
Ratio = Annotated[float, Unit("")]
Count = Annotated[int, Unit("")]


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, 99th percentile and largest of a duration over the run."""

    p50_s: Seconds
    p99_s: Seconds
    max_s: Seconds

    @staticmethod
    def of(values: Array) -> Spread:
        """Spread of finite values; NaN when there is none."""
        good = values[np.isfinite(values)]
        if not len(good):
            return Spread(NAN, NAN, NAN)
        p50, p99 = np.percentile(good, [50.0, 99.0], method="higher").tolist()
        return Spread(p50, p99, float(good.max()))


@dataclass(frozen=True, slots=True)
class PoseErrors:
    """Object pose against the desired one, from the end of the transient to the end of the run."""

    source: str
    rows: int
    unusable_rows: int  # of the whole run: pose is not a number
    not_tracking_rows: int  # after the transient: an arm held or was off, so there was no trajectory to follow
    longest_gap_s: Seconds  # after the transient: without a pose, at the end too; NaN where there is none at all
    t_gap_s: Annotated[float, Unit("s", Better.NEITHER)]  # when it begins; NaN without one
    whole: bool  # all of the run after the transient can be judged
    max_position_error_m: Metres
    max_attitude_error_rad: Radians
    rms_position_error_m: Metres
    rms_attitude_error_rad: Radians
    t_max_position_s: Annotated[float, Unit("s", Better.NEITHER)]
    t_max_attitude_s: Annotated[float, Unit("s", Better.NEITHER)]
    max_in_plane_error_m: Metres  # NaN when the run has no plane
    max_out_of_plane_error_m: Metres
    position: PositionDecay
    attitude: AttitudeDecay


@dataclass(frozen=True, slots=True)
class JointResults:
    """Torque of one joint; of an arm in the loop without what its driver added.

    Means are of the motion, the rest of the whole run, with the wait for the start and what came behind the end.
    """

    peak_torque_Nm: Torque
    peak_torque_fraction: Ratio  # of stall
    rms_torque_Nm: Torque
    rms_of_continuous: Ratio  # rms current of each of its servos, of what one bears for long (an estimate)
    limited_s: Seconds  # safety changed the commanded torque
    at_limit_s: Seconds  # |torque sent| at tau_max, with all that was added
    chatter_Nm: Torque  # mean |change of torque sent| per tick
    tau_max_Nm: Annotated[float, Unit("N·m", Better.NEITHER)]
    tau_stall_Nm: Annotated[float, Unit("N·m", Better.NEITHER)]


@dataclass(frozen=True, slots=True)
class WrenchSize:
    """Size of a wrench: norms of its force and of its moment."""

    max_force_N: Annotated[float, Unit("N", Better.NEITHER)]
    rms_force_N: Annotated[float, Unit("N", Better.NEITHER)]
    max_moment_Nm: Annotated[float, Unit("N·m", Better.NEITHER)]
    rms_moment_Nm: Annotated[float, Unit("N·m", Better.NEITHER)]


@dataclass(frozen=True, slots=True)
class ArmResults:
    """Everything about one arm but its pose errors."""

    model: str
    modes: tuple[tuple[float, str], ...]  # when each mode began, s
    flags: Mapping[str, int]  # ticks on which safety raised each flag
    joints: Mapping[str, JointResults]
    late_cycles: Count
    overruns: Count
    pace: Pace
    timing: Mapping[str, Spread]
    bus: Mapping[str, int]
    wrench_cmd: WrenchSize
    internal_cmd: WrenchSize
    internal_realised: WrenchSize
    load_share_cmd: Annotated[float, Unit("", Better.NEITHER)]
    load_share_realised: Annotated[float, Unit("", Better.NEITHER)]
    rms_velocity_error_m_per_s: Annotated[float, Unit("m/s")]
    rms_angular_velocity_error_rad_per_s: Annotated[float, Unit("rad/s")]
    e_eta_start: Annotated[float, Unit("", Better.NEITHER)]
    e_eta_end: Annotated[float, Unit("", Better.NEITHER)]
    e_eta_sign_changes: Count  # not zero: the attitude error went past half a turn
    lyapunov_start_J: Annotated[float, Unit("J", Better.NEITHER)]
    lyapunov_end_J: Annotated[float, Unit("J")]
    sigma_min: Annotated[float, Unit("", Better.HIGHER)]
    load_max: Ratio  # largest torque sent, of the limit of its joint
    shift_max_m: Annotated[float, Unit("m", Better.NEITHER)]  # of the desired pose
    shift_max_rad: Annotated[float, Unit("rad", Better.NEITHER)]
    friction_factor: Annotated[float, Unit("", Better.NEITHER)]  # of its file's friction, as it had learned in the end
    unexpected_fast_max_N: Annotated[float, Unit("N")]  # beside the load share, as the arm finds it; NaN if it does not
    unexpected_fast_max_Nm: Torque
    unexpected_slow_max_N: Annotated[float, Unit("N")]
    unexpected_slow_max_Nm: Torque
    hil: HilResults | None = None  # of an arm in the loop
    grip: GripResults | None = None  # of an arm whose gripper says how it is


@dataclass(frozen=True, slots=True)
class Completeness:
    """Rows of one arm: the cycles it ran, numbered from 0."""

    expected: Annotated[int, Unit("", Better.NEITHER)]
    recorded: Annotated[int, Unit("", Better.NEITHER)]  # of these
    lost: Count  # of these, the others
    after_end: Annotated[int, Unit("", Better.NEITHER)]  # numbered beyond them
    gaps: tuple[tuple[int, int], ...]  # first and last sequence number of every missing stretch


@dataclass(frozen=True, slots=True)
class Results:
    """All figures of a run."""

    info: RunInfo
    complete: bool  # the recorder says so and no row of the run is missing
    by_plant: PoseErrors | None
    by_arm: Mapping[str, PoseErrors]
    arms: Mapping[str, ArmResults]
    rows: Mapping[str, Completeness]
    arm_disagreement_m: Metres  # largest distance between two arms' views of the object
    arm_disagreement_left_m: Metres  # of what their shifts leave of it at the end; NaN where no arm has shifted
    internal_force_mean_N: Annotated[float, Unit("N")]  # true, of the arm with the most at each instant, as in a study
    real_time_factor: Annotated[float, Unit("", Better.HIGHER)]
    events: Annotated[int, Unit("", Better.NEITHER)]
    missing: tuple[str, ...]
    phases: tuple[Phase, ...] = ()  # of a session from rest to rest
    set_down_error_m: Metres = NAN  # between where the object stands after a session and where it stood before
    set_down_error_rad: Radians = NAN
    together: FoundTogether | None = None  # None where alignment took nothing off
    loss: Loss | None = None  # of the object or a grasp; None: nothing tells the truth
    judged: bool = True  # False: of a log without a whole member, or with rows of another configuration

    @property
    def error_source(self) -> str:
        """Where the headline errors are from."""
        return "true object pose" if self.by_plant else "worst arm's own kinematics"

    def headline(self, name: str) -> float:
        """One error of PoseErrors: of the true pose where the log holds it, otherwise of the worst arm."""
        if self.by_plant:
            return float(getattr(self.by_plant, name))
        return float(np.fmax.reduce([getattr(e, name) for e in self.by_arm.values()] or [NAN]))

    def verdict(self, bounded: Bounded) -> Judgement | None:
        """What the cell's bound says of a figure; None where the cell sets no bound."""
        if bounded not in self.info.bounds:
            return None
        value = self.headline(bounded.value)
        if self.judged and value > self.info.bounds[bounded]:
            return Judgement.NOT_MET
        sources = [self.by_plant] if self.by_plant else [self.by_arm.get(arm.name) for arm in self.info.arms]
        whole = self.judged and all(e is not None and e.whole for e in sources)
        return Judgement.MET if whole and not math.isnan(value) else Judgement.NOT_SHOWN

    @property
    def within_bounds(self) -> bool:
        """True when every bound that the cell sets, if any, is shown to be met and no object or grasp is known lost."""
        kept = self.loss is None or self.loss.kept
        return kept and all(self.verdict(bounded) is Judgement.MET for bounded in self.info.bounds)

    @property
    def rehearsing(self) -> list[str]:
        """Arms in the loop."""
        return [name for name, arm in self.arms.items() if arm.hil is not None]

    @property
    def worst_torque(self) -> tuple[float, str, str]:
        """Largest peak torque as a fraction of stall, with its arm and joint; (NaN, "", "") without any."""
        every = [
            (r.peak_torque_fraction, arm, joint)
            for arm, results in self.arms.items()
            for joint, r in results.joints.items()
            if math.isfinite(r.peak_torque_fraction)
        ]
        return max(every, default=(NAN, "", ""))

    @property
    def rows_expected(self) -> int:
        """Rows that a whole log of this run has, all arms together."""
        return sum(c.expected for c in self.rows.values())

    @property
    def rows_recorded(self) -> int:
        """Those of them that the log has."""
        return sum(c.recorded for c in self.rows.values())

    @property
    def late_cycles(self) -> int:
        """Cycles that began late, all arms together."""
        return sum(a.late_cycles for a in self.arms.values())

    def flat(self) -> dict[str, Quantity]:
        """Every figure by its dotted name, such as `arms.left.joints.elbow.peak_torque_Nm`."""
        found = dict(flatten(self))
        units = units_of(PoseErrors)
        for name in HEADLINE:
            found[name] = Quantity(self.headline(name), units[name].unit, units[name].better)
        found["peak_torque_fraction.worst"] = Quantity(self.worst_torque[0], "", Better.LOWER)
        found["late_cycles"] = Quantity(float(self.late_cycles), "", Better.LOWER)
        return found

    def to_json(self) -> dict[str, Any]:
        """The content of results.json; what was not measured is null."""
        info, (value, arm, joint) = self.info, self.worst_torque
        torque: dict[str, Any] = {
            a: {j: r.peak_torque_fraction for j, r in results.joints.items()} for a, results in self.arms.items()
        }
        verdicts = {b.value: self.verdict(b) for b in info.bounds}
        plain = {
            "schema": SCHEMA,
            "cell": info.cell,
            "fingerprint": info.fingerprint,
            "driver": info.driver,
            "controller": info.controller,
            "host": info.host,
            "versions": info.versions,
            "rate_hz": info.rate_hz,
            "duration_s": info.duration_s,
            "transient_s": info.transient_s,
            "error_source": self.error_source,
            **{name: self.headline(name) for name in HEADLINE},
            "bounds": {b.value: bound for b, bound in info.bounds.items()},
            "verdicts": {name: v.value for name, v in verdicts.items() if v},
            "peak_torque_fraction": torque | {"worst": {"value": value, "arm": arm, "joint": joint}},
            "rms_torque_Nm": {a: {j: r.rms_torque_Nm for j, r in s.joints.items()} for a, s in self.arms.items()},
            "rows_expected": self.rows_expected,
            "rows_recorded": self.rows_recorded,
            "complete": self.complete,
            "real_time_factor": self.real_time_factor,
            "late_cycles": self.late_cycles,
            "arm_disagreement_m": self.arm_disagreement_m,
            "arm_disagreement_left_m": self.arm_disagreement_left_m,
            "internal_force_mean_N": self.internal_force_mean_N,
            "events": self.events,
            **loss_keys(self.loss),
            "by_plant": self.by_plant,
            "by_arm": self.by_arm,
            "rows": self.rows,
            "arms": self.arms,
            "missing": self.missing,
            "phases": self.phases,
            "set_down_error_m": self.set_down_error_m,
            "set_down_error_rad": self.set_down_error_rad,
        }
        return dict(json_ready(plain))


HEADLINE: Final = ("max_position_error_m", "max_attitude_error_rad", "rms_position_error_m", "rms_attitude_error_rad")
