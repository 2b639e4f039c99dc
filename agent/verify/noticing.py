"""From which unexpected wrench the arms of a cell hold, what they learn of friction, and what is looked at before.

The residual takes the adaptive law's estimates for what is expected, so what they lack looks like somebody who presses.
In READY the leak σ forgets that, W(t) = J⁻ᵀ Y (θ̂(0) − θ_nominal) e^{−σ t}; what the estimates do after it answers the
feedback and makes less of the residual, not more.  A start before W is below every limit holds an arm by its own
ignorance.

A motion that does not begin at rest where the object stands looks like a blow: the residual takes the step of the
reference, J⁻¹ (v_d − K e) in joint velocities, for somebody's doing, and shows L J⁻ᵀ B of it within a tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from agent.config import noticing
from agent.config.cell import Arm, Cell, ConfigError
from agent.config.coordination import friction_factor, unlearned
from agent.config.friction import joint_friction
from agent.config.schema.arm import Provenance, ServoJoint
from agent.config.schema.controller import ControllerKind
from agent.config.schema.driver import DriverKind
from agent.control.adaptation_bound import ReferenceTwist, estimated_wrench
from agent.control.inverse import SingularJacobian, invert_jacobian
from agent.control.models import ArmModel, Matrix
from agent.control.residual import Channels
from agent.monitors.bounds import Name
from agent.monitors.gravity import WINDOW_S, WINDOWS
from agent.verify.finding import Finding, Verdict, judged, warning
from agent.verify.path import start_error
from drivers.interface import Vector

AT_REST: Final = 1e-9  # m, m/s, rad/s: a motion that begins there


def rested(cell: Cell) -> list[Finding]:
    """Whether the torque at rest is looked at before the motion, and where not, why; nothing where nobody is to."""
    file = cell.file
    if Name.GRAVITY in file.safety.monitors.off:
        return []
    what, ready_s, least_s = "torque at rest before the motion", file.simulation.ready_s, WINDOW_S * WINDOWS
    if file.session is not None:
        least_s += file.session.take_up_s
    if file.driver is DriverKind.SIM and ready_s < least_s:
        return [
            Finding(what, "cell", f"not looked at: simulated arms are READY for {ready_s:g} s alone", f"{least_s:g} s")
        ]
    return [Finding(what, "cell", "looked at while READY", f"{least_s:g} s")]


def noticed(cell: Cell) -> list[Finding]:
    """The thresholds, derived or given; nothing where `[safety.noticing]` is off."""
    spec = cell.file.safety.noticing
    if not spec.enabled:
        return []
    what = "an arm holds above an unexpected wrench of"
    try:
        x = noticing.thresholds(cell)
    except ConfigError as error:
        return [Finding(what, "cell", str(error.found), str(error.expected), Verdict.REFUSED, error.remedy)]
    given = [spec.fast_N, spec.fast_Nm, spec.slow_N, spec.slow_Nm]
    source = "derived from the cell" if given == [None] * 4 else "given" if None not in given else "partly given"
    pulled = noticing.against(cell)
    struck = noticing.knock(cell, pulled)
    along = ""
    if pulled is not None and struck is not None:
        loads = noticing.loads_N(cell)
        borne = (
            "" if loads is None else " ({:g} N with what friction bears, {:g} N of joints that stick)".format(*loads)
        )
        along = (
            f"; {pulled.level_N:g} N, or thrice {pulled.climb_N:g} N, against the motion; {pulled.hangs_N:.2g} N down"
            f"{borne}, {pulled.lifted_N:.2g} N up; {struck.limit_N:.2g} N of a blow"
        )
    may_be = noticing.touch(cell, x)
    touched = "" if may_be is None else f" ({may_be.most_N:g} N where it may be a touch)"
    at_once, staying = f"{x.fast_N:g} N{touched}, {x.fast_Nm:g} N·m", f"{x.slow_N:g} N, {x.slow_Nm:g} N·m"
    found = f"{at_once} at once; {staying} that stay{along} ({source})"
    findings = [Finding(what, "cell", found, ""), *_too_low(cell)]
    brace = noticing.brace(cell)
    if brace is not None:
        pulls = f"up to {brace.limit_N:g} N where it is carried on"
        findings.append(Finding("an arm that holds pulls back", "cell", pulls, ""))
    return findings


def _too_low(cell: Cell) -> list[Finding]:
    """Limits that the cell gives below what friction, encoders and a touch make of them without a fault."""
    spec, of = cell.file.safety.noticing, Channels._fields
    given = [(key, getattr(spec, key)) for key in of]
    if all(value is None for _, value in given):
        return []
    least = [x / noticing.MARGIN for x in noticing.derived(cell)]
    return [
        warning(
            f"safety.noticing.{key}", "cell", f"{value:g}",
            f"≥ {usual:.3g}, which friction, encoders, a touch or [tolerance] make where nobody fails",
            "leave it out, then it follows from the cell; or the arms hold for nothing",
        )
        for (key, value), usual in zip(given, least, strict=True)
        if value is not None and value < usual
    ]  # fmt: skip


def learned(cell: Cell) -> list[Finding]:
    """Between which bounds arms learn their friction, and where none does, why; nothing where none is fed forward."""
    controller, what = cell.file.controller, "friction that an arm learns"
    if not controller.friction_feedforward or controller.kind is ControllerKind.ADAPTIVE:
        return []
    found: dict[str, list[str]] = {}
    for arm in cell.arms:
        learns = friction_factor(cell, arm)
        bounds = learns and f"{learns.least:g} to {learns.most:.3g} times its file's"
        told = bounds or f"none: {unlearned(cell, arm)}"
        found.setdefault(told, []).append(arm.name)
    return [Finding(what, ", ".join(arms), told, "") for told, arms in found.items()]


def unstated(cell: Cell) -> list[Finding]:
    """Arms moved by servos of whose breakaway and load friction neither file nor cell says anything; limits lack it.

    A file whose Coulomb friction is measured says that there is none: whoever measured it looked for both.
    """
    stated = cell.tolerance
    if cell.file.driver is not DriverKind.DYNAMIXEL or stated.breakaway or stated.load_friction:
        return []
    arms = [arm.name for arm in cell.arms if not any(map(_says_so, arm.servos))]
    if not arms or not cell.file.safety.noticing.enabled:
        return []
    return [
        warning(
            "friction of joints at rest", ", ".join(arms), "no more than of joints that move: so the arm files have it",
            "breakaway, or friction that grows with load, as servos have it",
            "run `coop identify`, or state tolerance.breakaway and tolerance.load_friction (0.5 and 0.05, say): an arm "
            "may hold for what its own joints do",
        )
    ]  # fmt: skip


def _says_so(servo: ServoJoint) -> bool:
    """Whether the arm file says what friction at rest there is."""
    return joint_friction(servo).sticks or servo.coulomb_Nm.status is Provenance.MEASURED


def unlearnt(cell: Cell, models: Sequence[ArmModel], q_start: Sequence[Vector]) -> list[Finding]:
    """How long the arms of an adaptive cell must wait before a start; nothing where nothing can be noticed or learnt.

    models, q_start (n,): one for each arm.  Raises ConfigError where the thresholds cannot be derived.
    """
    if cell.file.controller.kind is not ControllerKind.ADAPTIVE or not cell.file.safety.noticing.enabled:
        return []
    sizes = [_lacking(cell, i, model, q) for i, (model, q) in enumerate(zip(models, q_start, strict=True))]
    force, moment = np.max(sizes, axis=0).tolist()
    wait_s = forgotten_s((force, moment), noticing.thresholds(cell), cell.file.controller.adaptive.leak_per_s)
    ready_s = cell.file.simulation.ready_s
    lack = f"{force:.2g} N, {moment:.2g} N·m"
    found = f"{lack}, forgotten after {wait_s:.2g} s" if math.isfinite(wait_s) else f"{lack}, which no leak forgets"
    return [
        judged(
            "what the estimates of the start lack", "cell", found, f"within {ready_s:g} s of READY",
            holds=wait_s <= ready_s, otherwise=Verdict.WARNING,
            remedy="wait longer in READY (simulation.ready_s), begin with start = \"nominal\", or set leak_per_s: "
            "an arm may hold by what it does not know",
        )
    ]  # fmt: skip


def forgotten_s(lacking: tuple[float, float], limits: Channels, leak_per_s: float) -> float:
    """Time after which a force and a moment that are forgotten are below the limits, s."""
    over = max(lacking[0] / min(limits.fast_N, limits.slow_N), lacking[1] / min(limits.fast_Nm, limits.slow_Nm))
    if over <= 1.0:
        return 0.0
    return math.log(over) / leak_per_s if leak_per_s > 0.0 else math.inf


def begun(cell: Cell, models: Sequence[ArmModel], q_start: Sequence[Vector]) -> list[Finding]:
    """Whether the arms hold for the begin of the motion; nothing where it begins at rest where the object stands.

    models, q_start (n,): one for each arm.  Nothing, too, where other findings refuse the poses.
    """
    error, v = start_error(cell), np.array(cell.trajectory().at(0.0).v)
    if not cell.file.safety.noticing.enabled or float(np.abs([error, v]).max()) < AT_REST:
        return []
    each = zip(cell.arms, models, q_start, strict=True)
    try:
        force, moment = np.max(
            [blow(cell, arm, model, q, v[:, None], error[:, None]) for arm, model, q in each], axis=0
        ).tolist()
        most_N, surely_N, most_Nm = blow_limits(cell)
    except (SingularJacobian, ConfigError):
        return []
    holds, perhaps = (force <= x and moment <= most_Nm for x in (most_N, surely_N))
    return [
        judged(
            "what the begin of the motion looks like to an arm", "cell", f"{force:.2g} N, {moment:.2g} N·m at once",
            f"≤ {most_N:g} N, {most_Nm:g} N·m",
            holds=holds, otherwise=Verdict.WARNING if perhaps else Verdict.REFUSED,
            remedy="let the motion begin at rest (ramp_s) where the object stands (object.p_start_m, quat_start), "
            "else all arms hold as it begins; or switch off what they hold for (safety.noticing.enabled)",
        )
    ]  # fmt: skip


def blow_limits(cell: Cell) -> tuple[float, float, float]:
    """Force above which an arm may hold at once and above which it does, N, and moment, N·m.  Raises ConfigError."""
    limits, struck = noticing.thresholds(cell), noticing.knock(cell, noticing.against(cell))
    most_N = limits.fast_N if struck is None else min(limits.fast_N, struck.limit_N)
    may_be = noticing.touch(cell, limits) if struck is None else None
    return most_N, most_N if may_be is None else may_be.most_N, limits.fast_Nm


def blow(cell: Cell, arm: Arm, model: ArmModel, q: Vector, v: Matrix, error: Matrix) -> tuple[float, float]:
    """Force (N) and moment (N·m) that the residual makes of the first step of the reference, quadratic sum of columns.

    v (6, k): twists of the motion as it begins; error (6, k): of the object there.  Raises SingularJacobian.
    """
    gains, P, k = cell.offline(arm).gains, model.task_basis, model.evaluate(q, np.zeros(model.n))
    J_inv, _ = invert_jacobian(k.J, k.B)
    jumps = J_inv @ P @ (v - np.array([[*gains.k_p, *gains.k_eps]]).T * error)
    wrenches = P.T @ J_inv.T @ (cell.file.safety.noticing.rate_per_s * k.B @ jumps)
    return float(np.linalg.norm(wrenches[:3])), float(np.linalg.norm(wrenches[3:]))


def _lacking(cell: Cell, i: int, model: ArmModel, q: Vector) -> tuple[float, float]:
    """Force (N) and moment (N·m) at the object, at rest at q (n,), between an arm's first estimates and its file."""
    offline, still, P = cell.offline(cell.arms[i]), np.zeros(6), model.task_basis
    data = offline.adaptation
    if data is None:
        raise TypeError("only an adaptive agent has estimates")
    Y, Y_O = estimated_wrench(model, offline, q, ReferenceTwist(still, still), P)
    lack = Y @ (data.start.arm - data.nominal.arm) + Y_O @ (data.start.object - data.nominal.object)
    world = P.T @ lack
    return float(np.linalg.norm(world[:3])), float(np.linalg.norm(world[3:]))
