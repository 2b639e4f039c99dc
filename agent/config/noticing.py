"""From which unexpected wrench on an arm it holds: derived from the cell file alone, so the same on every host.

Without a fault, what the channels of the residual (agent.control.residual) carry comes from

- friction that is not that of the feed-forward, ‖F‖ with columns J⁻ᵀ e_j Δf_j, a fifth of it however well it is known:
  at a reversal a part of it is sudden;
- steps of the encoders through observer and law, columns J⁻ᵀ L B (J⁻¹ K H J) e_j α ½ lsb;
- what errors of masses, torque constants, zeros, base, grasp and start make of W along the motion beyond what they make
  of it at its begin, which the slow channel subtracts: J⁻ᵀ Δτ and S δ (agent.verify.disagreement has their forms).

Each is a quadratic sum over independent errors at their bounds in `[tolerance]`, the largest over arms and places:

    fast = BLOW (REVERSAL friction + PEAK noise),     slow = MARGIN (CREEP √(friction² + errors²) + HUM √(l/L) noise)

and fast is no less than a touch needs, with L and l the rates of the residual and of the slow channel.  Where nothing
but a touch sets the limit of the sudden force, agent.control.touch tells one that is above it.  What pulls
against the motion, down or up (agent.control.against) or strikes (agent.control.knock) has limits in cells of three
and more arms: what a touch needs, or what friction and noise make of it; what hangs on the object with what friction
bears (agent.control.borne) has both together.  REVERSAL, PEAK, CREEP, HUM, ALONG, CLIMBING and LOAD are calibrated on
the largest values that studies of the shipped cells showed (a test has them); a planar moment has a CREEP of its own.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from agent.config import observer
from agent.config.cell import Arm, Cell, ConfigError, placement
from agent.config.friction import at_rest_Nm
from agent.config.once import once_per_cell
from agent.config.statics import carried_Nm
from agent.config.trajectory import sample_times
from agent.control import ik
from agent.control.against import Against
from agent.control.borne import Bearing
from agent.control.brace import Brace
from agent.control.errors import HALF_ANGLE
from agent.control.inverse import SingularJacobian, invert_jacobian
from agent.control.knock import Knock
from agent.control.law import Offline
from agent.control.models import ArmModel, Kinematics, Matrix
from agent.control.residual import Channels
from agent.control.touch import Touch
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.interface import Vector

PLACES: Final = 12  # along the motion, and more where these hide a part of it
MARGIN: Final = 1.4
BLOW: Final = 1.5  # margin of the fast channel, in which a touch comes on top of what is usual
UNKNOWN_LEAST: Final = 0.2  # of friction: where it sticks or turns round no figure of it helps
REVERSAL: Final = (0.3, 0.6)  # force, moment: of the friction, the sudden part
PEAK: Final = 6.7  # of noise, beyond the quadratic sum of half steps
CALIBRATED_SHARE: Final = 0.2  # position gain of the observer in those studies; a slower one doubles friction's jumps
CREEP: Final = 0.92
CREEP_TWIST_PLANAR: Final = 1.15  # moment of three joints: all weak and all stiff is rare, but it comes
HUM: Final = 2.0
SLOW_PLANAR_PER_S, SLOW_PER_S = 2.0, 4.0
TOUCH_N: Final = 2.0  # on the object, which is no trip; an arm feels its share of it, and what is usual
TOUCH: Final = 1.75  # times that share
TOUCH_MOST: Final = 2.6  # times that share, the most of a touch along the motion (2.42 seen)
TOUCH_DOWN: Final = 1.95  # and down (1.81 seen)
TOUCH_PLAIN: Final = 1.0  # times that share, of the plain force (0.91 seen)
TOUCH_LEVER_M: Final = 0.2  # moment that the arms' inertia makes of that force
ALONG: Final = (0.35, 0.097)  # level, climb: of friction and noise
CLIMBING: Final = 0.285  # of the same: the level at which a climb counts
TOUCH_ALONG: Final = (1.05, 0.15)  # times an arm's share of a touch
LOAD: Final = 0.82  # of friction and noise, beside that share: what hangs on the object with what friction bears
RUBS: Final = 0.5  # of friction, no less in that: the feed-forward turns round however well it is known
KNOCK: Final = 1.05  # of the level's limit, for what strikes the object
ALONE: Final = 2  # arms that feel a touch as they feel the other one
BRACE_N: Final = 2.0  # of a hold that three and more arms carry on
FLOORS: Final = Channels(0.5, 0.05, 0.3, 0.03)


def thresholds(cell: Cell) -> Channels:
    """What the cell file gives, and where it gives nothing, what follows from it.  Raises ConfigError."""
    spec = cell.file.safety.noticing
    given = (spec.fast_N, spec.fast_Nm, spec.slow_N, spec.slow_Nm)
    if all(value is not None for value in given):
        return Channels(*given)  # type: ignore[arg-type]
    return Channels(*(d if g is None else g for g, d in zip(given, derived(cell), strict=True)))


def slow_rate(cell: Cell) -> float:
    """Of the slow channel, 1/s."""
    given = cell.file.safety.noticing.slow_per_s
    if given is not None:
        return given
    return SLOW_PLANAR_PER_S if cell.planar else SLOW_PER_S


def derived(cell: Cell) -> Channels:
    """What follows from the cell file: N, N·m, to three digits.  Raises ConfigError where an arm cannot be placed."""
    (friction_N, friction_Nm), (noise_N, noise_Nm), (errors_N, errors_Nm), _ = _largest(cell)
    touch = TOUCH * _share_N(cell)
    floors = FLOORS._replace(fast_N=max(FLOORS.fast_N, touch), fast_Nm=max(FLOORS.fast_Nm, TOUCH_LEVER_M * touch))
    hum = HUM * math.sqrt(slow_rate(cell) / cell.file.safety.noticing.rate_per_s)
    twist = CREEP_TWIST_PLANAR if cell.planar else CREEP
    found = (
        REVERSAL[0] * friction_N + PEAK * noise_N,
        REVERSAL[1] * friction_Nm + PEAK * noise_Nm,
        CREEP * math.hypot(friction_N, errors_N) + hum * noise_N,
        twist * math.hypot(friction_Nm, errors_Nm) + hum * noise_Nm,
    )
    margins = (BLOW, BLOW, MARGIN, MARGIN)
    return Channels(*(float(f"{max(f, m * x):.3g}") for f, m, x in zip(floors, margins, found, strict=True)))


def against(cell: Cell) -> Against | None:
    """Sense of what pulls against the motion, with limits given or derived.

    None where nothing is given and each of two arms feels a touch as much as its neighbour.  Raises ConfigError where
    an arm cannot be placed.
    """
    spec, period_s = cell.file.safety.noticing, 1.0 / cell.file.rate_hz
    if len(cell.arms) <= ALONE:
        if spec.against_N is None and spec.climb_N is None:
            return None
        return Against(period_s, spec.against_N or math.inf, spec.climb_N or math.inf, _down(cell))
    share, usual = _share_N(cell), _usual_N(cell)
    level, climb = (float(f"{max(t * share, a * usual):.3g}") for t, a in zip(TOUCH_ALONG, ALONG, strict=True))
    climbing = 0.0 if spec.against_N else float(f"{CLIMBING * usual:.3g}")
    return Against(period_s, spec.against_N or level, spec.climb_N or climb, _down(cell), climbing_N=climbing)


def bearing(cell: Cell, arm: Arm) -> Bearing | None:
    """Sense of what hangs on the object with what the friction feed-forward of this arm bears.

    None of two arms, without gravity, and where nothing is fed forward, or friction that sticks.  Raises ConfigError.
    """
    friction = cell.offline(arm).friction
    if friction is None or friction.sticks or len(cell.arms) <= ALONE or not any(_down(cell)):
        return None
    limit_N = TOUCH_ALONG[0] * _share_N(cell) + LOAD * _usual_N(cell, least=RUBS)
    return Bearing(1.0 / cell.file.rate_hz, float(f"{limit_N:.3g}"), friction, _down(cell))


def load_N(cell: Cell) -> float | None:
    """Limit of `bearing`; None where no arm has that sense.  Raises ConfigError."""
    return next((found.limit_N for arm in cell.arms if (found := bearing(cell, arm)) is not None), None)


def knock(along: Against | None) -> Knock | None:
    """Sense of what strikes the object, with a limit that follows from `against` of the cell (`along`)."""
    return None if along is None else Knock(along.period_s, float(f"{KNOCK * along.level_N:.3g}"))


def brace(cell: Cell) -> Brace | None:
    """How an arm that holds pulls back where it is carried on; None where it does not."""
    spec = cell.file.safety.noticing
    derived_N = 0.0 if len(cell.arms) <= ALONE else BRACE_N
    limit_N = derived_N if spec.brace_N is None else spec.brace_N
    return Brace(1.0 / cell.file.rate_hz, limit_N) if spec.enabled and limit_N else None


def touch(cell: Cell, limits: Channels) -> Touch | None:
    """What may be a touch above the limit of the sudden force; None where that is given, or more than a touch needs.

    limits: `thresholds` of the cell.
    """
    spec, share = cell.file.safety.noticing, _share_N(cell)
    needed, most_N, down_N, plain_N = (float(f"{t * share:.3g}") for t in (TOUCH, TOUCH_MOST, TOUCH_DOWN, TOUCH_PLAIN))
    if spec.fast_N is not None or limits.fast_N > needed:
        return None
    return Touch(1.0 / cell.file.rate_hz, spec.rate_per_s, most_N, down_N, plain_N, _down(cell))


def _share_N(cell: Cell) -> float:
    """What an arm feels of a touch."""
    return TOUCH_N / len(cell.arms)


def _usual_N(cell: Cell, least: float = 0.0) -> float:
    """Force of friction and noise, with a margin, of which limits of three and more arms are a part.

    least: of all friction, which counts where less of it is unknown.
    """
    (unknown_N, _), (noise_N, _), _, (rubbing_N, _) = _largest(cell)
    return MARGIN * (max(unknown_N, least * rubbing_N) + noise_N)


def _down(cell: Cell) -> tuple[float, float, float]:
    """Direction of gravity, world axes; zero where there is none."""
    x, y, z = cell.gravity.tolist()
    size = math.hypot(x, y, z) or math.inf
    return (x / size, y / size, z / size)


class _Arm(NamedTuple):
    """One arm, what it knows, and its law on the task rows."""

    cell: Cell
    arm: Arm
    model: ArmModel
    offline: Offline
    KH: Matrix  # (m, m) K H
    S: Matrix  # (6, m) wrench per error


class _Place(NamedTuple):
    """An arm at one place of the motion."""

    v: Vector  # (m,) of the motion
    k: Kinematics
    J_inv: Matrix  # (n, m)
    to_wrench: Matrix  # (6, n) J⁻ᵀ of joint torques


@once_per_cell
def _largest(cell: Cell) -> tuple[tuple[float, float], ...]:
    """Force and moment of unknown friction, noise, errors and all friction, largest over arms and places."""
    return tuple((force, moment) for force, moment in np.max([_sizes(cell, arm) for arm in cell.arms], axis=0).tolist())


def _sizes(cell: Cell, arm: Arm) -> Matrix:
    """(4, 2) force and moment of unknown friction, noise, errors and all friction, largest over the places."""
    known = _known(cell, arm)
    places = _places(known)
    errors = [_errors(known, at) for at in places]
    late = [known.S @ (cell.tolerance.skew_s * at.v) for at in places]
    changes = [np.column_stack([e - errors[0], x]) for e, x in zip(errors, late, strict=True)]
    rubbing = [_rubbing(known, at) for at in places]
    unknown = [_unknown(known) * columns for columns in rubbing]
    of_each = [unknown, [_noise(known, at) for at in places], changes, rubbing]
    return np.array([np.max([_size(columns) for columns in one], axis=0) for one in of_each])


def _size(columns: Matrix) -> tuple[float, float]:
    """Quadratic sum of forces and of moments; columns (6, s)."""
    return float(np.linalg.norm(columns[:3])), float(np.linalg.norm(columns[3:]))


def _known(cell: Cell, arm: Arm) -> _Arm:
    model, offline = cell.model(arm), cell.offline(arm)
    P, gains, H = model.task_basis, offline.gains, np.array(HALF_ANGLE)
    KH = np.array([*gains.k_p, *gains.k_eps]) * H
    S = np.diag(np.array(gains.k_v) * KH + offline.load_share * H)
    return _Arm(cell, arm, model, offline, P @ np.diag(KH) @ P.T, P.T @ (P @ S @ P.T))


def _places(known: _Arm) -> list[_Place]:
    cell, arm, model = known.cell, known.arm, known.model
    trajectory, q, P = cell.trajectory(), np.array(arm.entry.q_near_rad), model.task_basis
    places = []
    for t in sample_times(cell.file, trajectory, PLACES)[:-1]:
        desired = trajectory.at(t)
        try:
            q = ik.solve(model, placement(desired.p, desired.quat), q)
            k = model.evaluate(q, np.zeros(model.n))
            J_inv, _ = invert_jacobian(k.J, k.B)
        except (ik.Unreachable, SingularJacobian) as error:
            raise ConfigError(
                f"thresholds of [safety.noticing], arm {arm.name} at t = {t:.2f} s",
                found=f"a pose that the arm cannot hold ({str(error) or 'singular'})",
                expected="poses along the motion to derive them at",
                remedy="see `coop check`, or give fast_N, fast_Nm, slow_N and slow_Nm",
            ) from error
        places.append(_Place(P @ np.array(desired.v), k, J_inv, P.T @ J_inv.T))
    return places


def _unknown(known: _Arm) -> float:
    """Share of an arm's friction that its feed-forward may lack."""
    low, high = known.cell.tolerance.friction
    return high if known.offline.friction is None else max(high - 1.0, 1.0 - low, UNKNOWN_LEAST)


def _rubbing(known: _Arm, at: _Place) -> Matrix:
    """(6, n) J⁻ᵀ of the friction of each joint, breakaway and load in it."""
    held = at.k.g + carried_Nm(known.cell, known.arm, at.k)
    friction = np.array([at_rest_Nm(s, tau) for s, tau in zip(known.arm.servos, held.tolist(), strict=True)])
    found: Matrix = at.to_wrench * friction
    return found


def _noise(known: _Arm, at: _Place) -> Matrix:
    """(6, n) what half a step of each encoder leaves in the unexpected wrench."""
    seen, L = observer.build(known.cell.file), known.cell.file.safety.noticing.rate_per_s
    share = 1.0 if seen is None else max(CALIBRATED_SHARE, seen.position_gain)
    jump = at.J_inv @ known.KH @ at.k.J  # of dq_r, per angle
    found: Matrix = at.to_wrench @ (L * at.k.B @ jump) * (share * 0.5 * TICK_RAD)
    return found


def _errors(known: _Arm, at: _Place) -> Matrix:
    """(6, s) what constant errors make of the unexpected wrench here: a column each."""
    cell, arm, P, k = known.cell, known.arm, known.model.task_basis, at.k
    stated = cell.tolerance
    held = k.g + carried_Nm(cell, arm, k)
    x, y, z = (np.array(k.p_object) - arm.T_world_base.translation).tolist()
    across = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # ω × reach
    R = np.reshape(k.R_world_object, (3, 3))
    shifts = np.column_stack([across * stated.base_rad, R * stated.grasp_m]) / math.sqrt(3.0)
    off = np.column_stack([P[:, :3] @ shifts, stated.zeros_of(arm.n) * k.J])
    torques = np.column_stack([stated.masses * k.g, stated.torque_constant * np.diag(held)])
    return np.column_stack([at.to_wrench @ torques, known.S @ off])
