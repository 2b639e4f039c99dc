"""One run of a study and what is measured on it, as plain numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.config.cell import Cell
from agent.config.reality import draw
from agent.config.schema.fault import NS, Fault
from agent.config.schema.reality import Reality
from agent.control.internal_force import internal_wrenches as asked_of_all
from agent.control.quaternion import angle_between
from agent.report.loss import LOST_M, LOST_RAD, is_lost
from agent.report.series import internal_wrenches, largest_force, largest_or_zero, meant_by_shares, rotate
from agent.study.lab import Laboratory, Run
from agent.verify.force import mean_bound_N
from drivers.interface import DriverError, Vector
from sim_backend.physics.spec import PlantError

AFTER_TRIP_S: Final = 3.0  # how long a run goes on once an arm has given up following
POSITION_BEYOND_ANCHOR_M: Final = 1e-3  # bounds: beyond what the anchor sees wrongly itself
ATTITUDE_BEYOND_ANCHOR_RAD: Final = 6e-3
PEAK_FRACTION: Final = 0.5  # of stall


def bounds_of(cell: Cell) -> dict[str, float]:
    """What a run of the cell must not exceed, by figure."""
    return {
        "position_beyond_anchor_m": POSITION_BEYOND_ANCHOR_M,
        "attitude_beyond_anchor_rad": ATTITUDE_BEYOND_ANCHOR_RAD,
        "internal_force_mean_N": mean_bound_N(cell),
        "peak_torque_fraction": PEAK_FRACTION,
    }


@dataclass(frozen=True)
class RunResult:
    """Figures of one run.  Errors and forces count from the transient's end to the end, the loss or the first trip.

    The errors of a lost run are at least those at which an object counts as lost.

    A fault ends nothing: what it does to the object is what they are for.  Of a run that is not `settled` everything
    from the common start to its end counts, and what was seen before where that is all.
    """

    cell: str
    index: int
    seed: int  # of its reality
    lost: bool
    tripped: bool
    within_bounds: bool
    settled: bool  # seen after the transient, before a loss or a trip
    tracked_s: float  # how long all arms followed: until the end, the loss, the first trip or the first fault
    first_fault_s: float | None  # when the first fault was to come, the cell's own or the study's; None: none was
    tripped_s: float | None  # when the first arm gave up; negative before the start
    lost_s: float | None  # when the object was lost
    position_error_m: float  # largest, of the true object
    attitude_error_rad: float
    position_beyond_anchor_m: float  # largest, less the error of what the anchor sees at the same instant
    attitude_beyond_anchor_rad: float
    internal_force_mean_N: float  # beyond load share and asked squeeze, of the arm with the largest at each instant
    internal_force_max_N: float
    peak_torque_fraction: float  # of stall, of the joint and instant with the largest; the whole run
    reaction_s: float | None  # from the first fault to the first other arm that trips; None: no fault, or nobody did
    tripped_by: str  # flags of the first trip, or the monitor that stopped the arm; empty without one
    why: str  # it was lost, or the first trip; empty without one


def run_once(lab: Laboratory, index: int, seed: int, faults: Sequence[Fault] = ()) -> RunResult:
    """Draw the reality of this seed, run the cell in it for its duration, and measure.  Raises Refusal."""
    cell = lab.cell
    return measure(lab, draw(cell.file.tolerance, seed, cell), index, seed, faults)


def measure(
    lab: Laboratory, reality: Reality | None, index: int = 0, seed: int = 0, faults: Sequence[Fault] = ()
) -> RunResult:
    """Run the cell in this reality (None: as its file says) and measure.  Raises Refusal.

    Trips of the arms' monitors count as those of noticing do, and the cell's own faults as `faults` of a study do.
    """
    run, seen = Run(lab, reality, faults), _Seen(lab)
    file = lab.cell.file
    ticks = run.ready_ticks + round(file.duration_s * file.rate_hz)
    lost, t = "", run.t
    while run.tick < ticks and not lost:
        if run.trips and run.t > run.trips[0].t + AFTER_TRIP_S:
            break
        t = run.t
        try:
            looking = run.tick % file.observe_every == 0
            truth = run.observe() if looking else None
            run.advance()
        except (PlantError, DriverError) as error:
            lost = f"t = {t:.3f} s: {error.what}"
            break
        if truth is not None:
            lost = seen.note(t, truth.p_object, truth.quat_object, truth.grasp_wrench, run)
    return seen.result(run, index, seed, (t, lost) if lost else None)


class _Seen:
    """What has been seen of a run, one entry per observation."""

    def __init__(self, lab: Laboratory) -> None:
        self._lab, self._anchor = lab, lab.cell.anchor
        self._trajectory = lab.cell.trajectory()
        self._asked_N = _asked_N(lab.cell)
        self._errors: list[tuple[float, float, float, float, float]] = []  # t, errors, errors of what the anchor sees
        self._quat: list[Vector] = []
        self._wrench: list[Vector] = []

    def note(self, t: float, p: Vector, quat: Vector, wrench: Vector, run: Run) -> str:
        """Take over an observation of time t; what says that the object is lost, or nothing."""
        desired = self._trajectory.at(max(self._by_the_anchor(t, run), 0.0))
        q = tuple(quat.tolist())
        off_m, off_rad = math.dist(p.tolist(), desired.p), angle_between(q, desired.quat)
        own_m = own_rad = 0.0
        seen = run.places[self._anchor].sees()
        if seen is not None:
            own_m, own_rad = math.dist(p.tolist(), seen[0]), angle_between(q, seen[1])
        self._errors.append((t, off_m, off_rad, own_m, own_rad))
        self._quat.append(quat)
        self._wrench.append(wrench)
        if is_lost(off_m, off_rad):
            return f"t = {t:.3f} s: the object is off by {off_m * 1e3:.0f} mm, {off_rad:.2f} rad"
        return ""

    def _by_the_anchor(self, t: float, run: Run) -> float:
        """The same instant by the anchor's clock, s: nobody can tell when the others should have been anywhere.

        In whole nanoseconds, as the arm itself counts it.
        """
        return (round(t * 1e9) + round(run.plant.spec.arms[self._anchor].skew_s * 1e9)) * NS

    def result(self, run: Run, index: int, seed: int, lost: tuple[float, str] | None) -> RunResult:
        """The figures of the whole run; lost: when and why it ended early."""
        lab, file = self._lab, self._lab.cell.file
        trip = run.trips[0] if run.trips else None
        tripped_s = None if trip is None else trip.t
        first_fault_s = min((fault.at_s for fault in run.faults), default=None)
        until_s = min(run.t, math.inf if tripped_s is None else tripped_s)
        seen = np.array(self._errors).reshape(-1, 5)
        counted = (seen[:, 0] >= file.report.transient_s) & (seen[:, 0] <= until_s)
        settled = bool(counted.any())
        if not settled:
            counted = seen[:, 0] >= 0.0
        if not counted.any():
            counted = np.ones(len(seen), dtype=bool)
        _, off_m, off_rad, own_m, own_rad = seen[counted].T
        force = self._internal_force_N()[counted]
        least_m, least_rad = (LOST_M, LOST_RAD) if lost else (0.0, 0.0)  # what comes behind the loss was not measured
        bounded = {
            "position_beyond_anchor_m": max(largest_or_zero(off_m - own_m), least_m),
            "attitude_beyond_anchor_rad": max(largest_or_zero(off_rad - own_rad), least_rad),
            "internal_force_mean_N": float(force.mean()) if len(force) else 0.0,
            "peak_torque_fraction": float((run.peak_Nm / lab.stall_Nm).max()),
        }
        kept = all(bounded[figure] <= bound for figure, bound in bounds_of(lab.cell).items())
        return RunResult(
            cell=file.name,
            index=index,
            seed=seed,
            lost=lost is not None,
            tripped=trip is not None,
            within_bounds=kept and lost is None and not gave_up(tripped_s, first_fault_s),
            settled=settled,
            tracked_s=max(0.0, min(until_s, math.inf if first_fault_s is None else first_fault_s)),
            first_fault_s=first_fault_s,
            tripped_s=tripped_s,
            lost_s=None if lost is None else lost[0],
            position_error_m=max(largest_or_zero(off_m), least_m),
            attitude_error_rad=max(largest_or_zero(off_rad), least_rad),
            internal_force_max_N=largest_or_zero(force),
            reaction_s=_reaction_s(run, first_fault_s),
            tripped_by="" if trip is None else trip.by,
            why=lost[1] if lost is not None else "" if trip is None else trip.told,
            **bounded,
        )

    def _internal_force_N(self) -> Vector:
        """(k,) largest part of an arm's force that moves nothing and that nothing asks of it, at each observation.

        f_i − c_i Σ_j f_j less the internal force that it is to give: what its load share means is none of it.
        """
        if not self._wrench:
            return np.zeros(0)
        wrench, quat, cell = np.array(self._wrench), np.array(self._quat), self._lab.cell
        shares, normal = [arm.entry.load_share for arm in cell.arms], cell.model(cell.arms[0]).plane_normal
        found = internal_wrenches(wrench, quat, None)[:, :, :3] - meant_by_shares(wrench, shares, normal)
        if self._asked_N is not None:
            found = found - np.stack([rotate(quat, force) for force in self._asked_N], axis=1)
        return largest_force(np.linalg.norm(found, axis=2))


def _asked_N(cell: Cell) -> list[Vector] | None:
    """What each arm is to press by, N, object axes; None where no squeeze is asked for.

    Arms of a plane give nothing out of it, wherever the object has turned in it.
    """
    if not any(arm.entry.internal_wrench_N_Nm for arm in cell.arms):
        return None
    P, R = cell.model(cell.arms[0]).task_basis[:, :3], cell.T_world_object_start.rotation
    in_task = R.T @ P.T @ P @ R
    return [in_task @ wrench[:3] for wrench in asked_of_all(*cell.internal_wrenches_desired())]


def gave_up(tripped_s: float | None, first_fault_s: float | None) -> bool:
    """Whether an arm tripped with no fault to trip for; when the first arm did, and when the first fault came, s."""
    return tripped_s is not None and (first_fault_s is None or tripped_s < first_fault_s)


def _reaction_s(run: Run, first_s: float | None) -> float | None:
    """From the first fault to the first trip of an arm that has none."""
    if first_s is None:
        return None
    struck = {fault.arm for fault in run.faults}
    return next((trip.t - first_s for trip in run.trips if trip.arm not in struck and trip.t >= first_s), None)
