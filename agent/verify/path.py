"""One arm along the trajectory of its cell: joint angles, torques, and how near it comes to its limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell, ConfigError, placement
from agent.control import ik, known
from agent.control.errors import attitude_error
from agent.control.inverse import SingularJacobian, pseudo_inverse
from agent.control.models import ArmModel
from agent.verify.finding import Finding, Verdict, judged
from drivers.dynamixel.servo.models import CONTINUOUS_SHARE
from drivers.interface import Vector


@dataclass(frozen=True)
class Path:
    """One arm along the trajectory."""

    q: list[Vector]
    sigma_min: float  # as the agent sees it: a lower bound of the smallest singular value
    sigma_min_t: float
    tau_peak: Vector
    tau_rms: Vector  # (n,) N·m
    dq_peak: Vector  # (n,) rad/s
    power_peak: Vector  # (n,) W, |torque x speed|
    limit_margin: Vector


def start_configurations(cell: Cell, models: Sequence[ArmModel]) -> tuple[Vector, ...]:
    """Joint angles (n,) of each arm with the object at its start pose, nearest to q_near_rad.

    Raises ConfigError naming the arm when its grasp cannot be reached.
    """
    return tuple(
        reach(arm, model, cell.T_world_object_start, np.array(arm.entry.q_near_rad), "at the start")
        for arm, model in zip(cell.arms, models, strict=True)
    )


def start_error(cell: Cell) -> Vector:
    """e (6,) of the object where it stands against the begin of the motion: m, and −e_η e_ε."""
    desired = cell.trajectory().at(0.0)
    e_eta, e_eps = attitude_error(cell.file.object.quat_start, desired.quat)
    return np.array([*(np.array(cell.file.p_place_m) - desired.p), *(-e_eta * np.array(e_eps))])


def reach(arm: Arm, model: ArmModel, T: pin.SE3, q_near: Vector, when: str) -> Vector:
    """Joint angles (n,) of the arm with the object at T, nearest to q_near.  Raises ConfigError naming arm and time."""
    try:
        return ik.solve(model, T, q_near)
    except ik.Unreachable as error:
        remedy = (
            "the rest lies outside the plane of the controlled joints: align base and grasp poses"
            if error.out_of_task
            else "move the base, the grasp or the trajectory, or give q_near_rad nearer to the solution"
        )
        raise ConfigError(
            f"grasp of arm {arm.name} {when}",
            found=f"unreachable by {error.distance_m * 1e3:.3g} mm and {error.angle_rad * 1e3:.3g} mrad",
            expected="a pose the arm reaches",
            remedy=remedy,
        ) from error


def along_trajectory(cell: Cell, arm: Arm, model: ArmModel, q_start: Vector, instants: Sequence[float]) -> Path:
    """The arm at these instants, s, from q_start (n,) on.  Raises ConfigError where its grasp cannot be reached."""
    trajectory, offline = cell.trajectory(), cell.offline(arm)
    q, qs = q_start, []
    sigma, sigma_t = math.inf, 0.0
    tau_peak, dq_peak, power_peak = np.zeros((3, arm.n))
    tau_squares, seconds = [], []
    lower, upper = model.model.lowerPositionLimit, model.model.upperPositionLimit
    margin = np.minimum(q_start - lower, upper - q_start)
    for t in instants:
        desired = trajectory.at(t)
        q = reach(arm, model, placement(desired.p, desired.quat), q, f"at t = {t:.2f} s")
        qs.append(q)
        dq = pseudo_inverse(model.jacobian(q)) @ (model.task_basis @ np.array(desired.v))
        dq_peak = np.maximum(dq_peak, np.abs(dq))
        try:
            terms = known.torque(model, offline, q, dq, desired)
            tau = terms.tau_cmd
            if terms.sigma_min < sigma:
                sigma, sigma_t = terms.sigma_min, t
            tau_peak = np.maximum(tau_peak, np.abs(tau))
            power_peak = np.maximum(power_peak, np.abs(tau * dq))
            tau_squares.append(tau * tau)
            seconds.append(t)
        except SingularJacobian:
            sigma, sigma_t = 0.0, t
        margin = np.minimum(margin, np.minimum(q - lower, upper - q))
    tau_rms = _rms(tau_squares, seconds, arm.n)
    return Path(qs, sigma, sigma_t, tau_peak, tau_rms, dq_peak, power_peak, margin)


def _rms(squares: Sequence[Vector], seconds: Sequence[float], n: int) -> Vector:
    """Over time, (n,), however close the instants lie; zero of fewer than two."""
    if len(seconds) < 2:
        return np.zeros(n)
    found: Vector = np.sqrt(np.trapezoid(np.array(squares), seconds, axis=0) / (seconds[-1] - seconds[0]))
    return found


def arm_findings(cell: Cell, arm: Arm, path: Path) -> list[Finding]:
    """Singularity, torques, joint limits and currents of an arm along the trajectory."""
    safety = cell.file.safety
    findings = [
        judged(
            "smallest singular value of J", arm.name, f"at least {path.sigma_min:.4f} at t = {path.sigma_min_t:.2f} s",
            f"≥ {safety.sigma_min:g}", holds=path.sigma_min >= safety.sigma_min,
            remedy="stay away from stretched or folded poses",
        )
    ]  # fmt: skip
    bound, remedy = safety.tau_max_fraction_of_stall, "use a stronger arm, a lighter object or a pose with less load"
    remedy += ", or squeeze less" * any(a.entry.internal_wrench_N_Nm for a in cell.arms)
    for joint, tau, stall, room in zip(
        arm.entry.controlled, path.tau_peak, arm.tau_stall_Nm, path.limit_margin, strict=True
    ):
        findings.append(
            judged(
                f"torque along the trajectory, {joint}", arm.name,
                f"{tau:.3f} N·m, {tau / stall:.0%} of stall", f"≤ {bound:.0%} of {stall:g} N·m",
                holds=tau <= bound * stall, remedy=remedy,
            )
        )  # fmt: skip
        findings.append(
            judged(
                f"distance to joint limit, {joint}", arm.name, f"{room:.3f} rad", "> 0", holds=room > 0.0,
                remedy="move the base or the trajectory, or take the other elbow solution (q_near_rad)",
            )
        )  # fmt: skip
    return [*findings, _for_long(arm, path)]


def _for_long(arm: Arm, path: Path) -> Finding:
    """The joint whose servos are warmest of it; a pair shares, so that a share of stall is that of each servo."""
    shares = path.tau_rms / arm.tau_stall_Nm
    worst = int(np.argmax(shares))
    return judged(
        f"current for long, {arm.entry.controlled[worst]}", arm.name,
        f"{shares[worst]:.1%} of stall, root mean square along the trajectory",
        f"≤ {CONTINUOUS_SHARE:.0%}, which ROBOTIS advise", holds=bool(shares[worst] <= CONTINUOUS_SHARE),
        otherwise=Verdict.WARNING, remedy="rest between runs and watch its temperature, or a pose with less load",
    )  # fmt: skip
