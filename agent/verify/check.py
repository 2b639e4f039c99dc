"""A cell examined along its whole trajectory before anything moves: findings, and a refusal where it must not run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from agent.config import trajectory as motion
from agent.config.cell import Cell, ConfigError
from agent.config.schema.controller import ControllerKind
from agent.config.schema.driver import DriverKind
from agent.control.errors import attitude_angle, attitude_error
from agent.control.models import ArmModel, ModelError
from agent.verify.adaptive import examine_adaptation
from agent.verify.box import largest_internal_wrench
from agent.verify.bus import buses
from agent.verify.finding import Finding, Verdict, judged
from agent.verify.force import internal_force, mean_bound_N
from agent.verify.margin import Damping, damping, places, sampled_loop
from agent.verify.marks import marks
from agent.verify.noticing import begun, learned, noticed, rested, unlearnt, unstated
from agent.verify.path import Path, along_trajectory, arm_findings, reach, start_configurations
from agent.verify.plausible import plausibility
from agent.verify.radius import mended, told
from agent.verify.rehearsal import examine_rehearsal
from agent.verify.session import lives, session
from drivers.interface import Vector

if TYPE_CHECKING:
    from agent.verify.robustness import Robustness

SAMPLES = 48  # points along the trajectory, beside those that the trajectory names itself
STABILITY_SAMPLES = 12
NAMED_MAX = 6000  # of the trajectory's own points, over all arms: some seconds of computing

__all__ = ["CheckReport", "Finding", "Verdict", "examine", "reach", "start_configurations"]


@dataclass(frozen=True)
class CheckReport:
    """All findings, the start configuration of each arm, and what reality may make of the cell where it was asked."""

    findings: tuple[Finding, ...]
    q_start: tuple[Vector, ...]
    robustness: Robustness | None = None

    @property
    def ok(self) -> bool:
        """Whether the cell may run."""
        return all(f.verdict is not Verdict.REFUSED for f in self.findings)

    def require(self) -> None:
        """Raise ConfigError with the first refusal."""
        for f in self.findings:
            if f.verdict is Verdict.REFUSED:
                raise ConfigError(f"{f.what} ({f.where})", found=f.found, expected=f.wanted, remedy=f.remedy)


def examine(cell: Cell, *, wired: bool | None = None, thorough: bool | None = None) -> CheckReport:
    """Examine the whole cell.  Raises ConfigError where nothing further can be computed (an unreachable grasp).

    wired: a rate that the servo buses of the cell cannot carry is refused, not only warned of; None: if servos move
    the arms (`driver`).  thorough: bounds of the monitors, how near bodies come and what reality may make of the cell
    are computed too, which takes up to a second; None: if servos move the arms.
    """
    servos = cell.file.driver is DriverKind.DYNAMIXEL
    try:
        models = [cell.model(arm) for arm in cell.arms]
    except ModelError as error:
        raise ConfigError(error.what, found=error.found, expected=error.expected, remedy=error.remedy) from error
    findings: list[Finding] = []
    _same_task_space(cell, models)
    q_start = start_configurations(cell, models)
    findings += _start(cell)
    instants, paths = _instants(cell), []
    findings += _thinned(instants)
    for arm, model, q0 in zip(cell.arms, models, q_start, strict=True):
        path = along_trajectory(cell, arm, model, q0, instants.times)
        findings += arm_findings(cell, arm, path)
        paths.append(path)
    of_arms = lives(cell)
    findings += [*plausibility(cell), *internal_force(cell, models), *noticed(cell)]
    findings += [*begun(cell, models, q_start), *rested(cell), *learned(cell), *unstated(cell)]
    findings += session(cell, of_arms)
    findings += buses(cell, q_start, wired=servos if wired is None else wired)
    findings += marks(cell, wired=servos if wired is None else wired)
    findings += _stability(cell, models, paths)
    findings += examine_rehearsal(cell, models, [p.q for p in paths], instants.times)
    if cell.file.controller.kind is ControllerKind.ADAPTIVE:
        findings += [*_adaptation(cell, models, paths, instants.times), *unlearnt(cell, models, q_start)]
    if not (servos if thorough is None else thorough):
        return CheckReport(tuple(findings), q_start)
    from agent.verify.thorough import examine_thoroughly  # noqa: PLC0415 - what agents in simulation never need

    more, found = examine_thoroughly(cell, models, paths, instants.times, of_arms)
    return CheckReport((*findings, *more), q_start, found)


def _same_task_space(cell: Cell, models: Sequence[ArmModel]) -> None:
    first = models[0].plane_normal
    for arm, model in zip(cell.arms[1:], models[1:], strict=True):
        other = model.plane_normal
        if (first is None) != (other is None) or (
            first is not None and other is not None and abs(first.dot(other)) < 1.0 - 1e-9
        ):
            raise ConfigError(
                f"motion plane of arm {arm.name}",
                found="none (six-dimensional)" if other is None else f"normal {other.tolist()}",
                expected="the same as of arm " + cell.arms[0].name,
                remedy="make all arms planar in one plane, or all six-dimensional",
            )


def _start(cell: Cell) -> list[Finding]:
    safety, desired = cell.file.safety, cell.trajectory().at(0.0)
    obj = cell.file.object
    distance = math.dist(cell.file.p_place_m, desired.p)
    e_eta, e_eps = attitude_error(obj.quat_start, desired.quat)
    angle = attitude_angle(e_eta, e_eps)
    axis = np.round(np.array(e_eps) / max(math.hypot(*e_eps), 1e-12), 3).tolist()
    return [
        judged(
            "start position error", "cell", f"{distance * 1e3:.2f} mm", f"≤ {safety.start_error_max_m * 1e3:g} mm",
            holds=distance <= safety.start_error_max_m,
            remedy="start nearer to the trajectory, or raise start_error_max_m",
        ),
        judged(
            "e_η(0)", "cell", f"{e_eta:.6f}", f"|e_η| ≥ {safety.e_eta_min:g}", holds=abs(e_eta) >= safety.e_eta_min,
            remedy=f"the object is turned by {math.degrees(angle):.1f}° about {axis} from its desired attitude",
        ),
        judged(
            "start attitude error", "cell", f"{angle * 1e3:.2f} mrad", f"≤ {safety.start_error_max_rad * 1e3:g} mrad",
            holds=angle <= safety.start_error_max_rad, remedy="turn the object, or raise start_error_max_rad",
        ),
    ]  # fmt: skip


@dataclass(frozen=True)
class _Instants:
    """Times at which the trajectory is examined, ascending, and how many it names itself."""

    times: list[float]
    named: int
    taken: int  # of the named ones


def _instants(cell: Cell) -> _Instants:
    trajectory = cell.trajectory()
    end = min(trajectory.period_s, cell.file.duration_s)
    named, count = motion.waypoint_times(cell.file, end, NAMED_MAX // len(cell.arms))
    times = motion.sample_times(cell.file, trajectory, SAMPLES - 1)
    return _Instants(sorted({*named, *times}), count, len(named))


def _thinned(instants: _Instants) -> list[Finding]:
    if instants.taken == instants.named:
        return []
    return [
        judged(
            "instants examined", "cell", f"{instants.taken} of {instants.named}", "all", holds=False, remedy=
            "the trajectory has more than are examined; examine a cell with a part of it, or with fewer way-points",
            otherwise=Verdict.WARNING,
        )
    ]  # fmt: skip


def _stability(cell: Cell, models: Sequence[ArmModel], paths: Sequence[Path]) -> list[Finding]:
    file, P = cell.file, models[0].task_basis
    along = list(zip(*(p.q for p in paths), strict=True))
    where = places(cell, models, along[:: max(1, len(along) // STABILITY_SAMPLES)])
    label = f"spectral radius at {file.rate_hz:g} Hz, {file.delay_s * 1e3:.3g} ms delay"
    findings = [
        _radius(cell, label if error == 0.0 else f"the same, arms' inertia {error:+.0%}", found, gate=error == 0.0)
        for error, found in damping(where, P, sampled_loop(cell)).items()
    ]
    if file.simulated_delay_s != file.delay_s:
        found = damping(where, P, sampled_loop(cell, simulated=True))[0.0]
        what = f"the same, {file.simulated_delay_s * 1e3:.3g} ms delay as simulated"
        findings.append(_radius(cell, what, found, gate=False))
    return findings


def _radius(cell: Cell, what: str, found: Damping, *, gate: bool) -> Finding:
    limit = cell.file.radius_max
    unstable = "raise rate_hz, or take the gains that `coop tune` proposes"
    finding = judged(
        what, "cell", told(found.radius, limit), f"≤ {limit:g}", holds=found.radius <= limit,
        remedy=mended(found.radius, cell.file.rate_hz, unstable),
        otherwise=Verdict.REFUSED if gate else Verdict.WARNING,
    )  # fmt: skip
    return replace(finding, by_gains=True)


def _adaptation(
    cell: Cell, models: Sequence[ArmModel], paths: Sequence[Path], instants: Sequence[float]
) -> list[Finding]:
    along = list(zip(*(p.q for p in paths), strict=True))
    every = max(1, len(along) // STABILITY_SAMPLES)
    found = examine_adaptation(cell, models, along[::every], instants[::every])
    spec, radius_max = cell.file.controller.adaptive, cell.file.radius_max
    rows = (
        ("gamma", f"{spec.gamma:g}", found.gamma_max, spec.gamma <= found.gamma_max, "lower gamma, or raise rate_hz"),
        (
            "gamma_object", f"{spec.gamma_object:g}", found.gamma_object_max,
            spec.gamma_object <= found.gamma_object_max, "lower gamma_object, or raise rate_hz",
        ),
        (
            "spectral radius with the estimates of the start", told(found.radius_at_start, radius_max), radius_max,
            found.radius_at_start <= radius_max,
            "set rotor_inertia = false, begin nearer to the configured parameters, or raise rate_hz",
        ),
    )  # fmt: skip
    box = _box(cell, *largest_internal_wrench(cell, models, along[::every], instants[::every]))
    return [
        Finding(what, "cell", value, f"≤ {limit:.4g}", Verdict.OK if ok else Verdict.WARNING, "" if ok else remedy)
        for what, value, limit, ok, remedy in rows
    ] + [box]


def _box(cell: Cell, force_N: float, moment_Nm: float) -> Finding:
    """How hard arms press whose estimates are at their bounds, where they drift to without a leak."""
    leak, most_N = cell.file.controller.adaptive.leak_per_s, mean_bound_N(cell)
    what, size = "internal wrench within the bounds of the estimates", f"≤ {force_N:.3g} N, {moment_Nm:.3g} N·m"
    if leak:
        return Finding(what, "cell", f"{size}, leak {leak:g}/s", "")
    return judged(
        what, "cell", f"{size}, no leak", f"≤ {most_N:g} N, or a leak", holds=force_N <= most_N,
        otherwise=Verdict.WARNING,
        remedy="set controller.adaptive.leak_per_s (4, say), or narrower bounds: estimates of arms that disagree drift "
        "apart until they are at their bounds",
    )  # fmt: skip
