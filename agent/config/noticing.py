"""From which unexpected wrench on an arm it holds: derived from the cell's files (its own, arms', URDFs) alone.

Hosts with the same fingerprint have the same limits.

Without a fault, what the channels of the residual (agent.control.residual) carry comes from

- friction that is not that of the feed-forward, ‖F‖ with columns J⁻ᵀ e_j Δf_j, a fifth of it however well it is known:
  at a reversal a part of it is sudden;
- steps of the encoders through observer and law, columns J⁻ᵀ L B (J⁻¹ K H J) e_j α ½ lsb;
- steps of the measured speeds through the observer, columns J⁻ᵀ L B e_j β ½ lsb: a blow and a lift count with them;
- what errors of masses, torque constants, zeros, base, grasp and start make of W along the motion beyond what they make
  of it at its begin, which the slow channel subtracts: J⁻ᵀ Δτ and S δ (agent.verify.disagreement has their forms).

Each is a quadratic sum over independent errors at their bounds in `[tolerance]`, the largest over arms and places:

    fast = BLOW (REVERSAL friction + PEAK noise),     slow = MARGIN (CREEP √(friction² + errors²) + HUM √(l/L) noise)

and fast is no less than a touch needs, with L and l the rates of the residual and of the slow channel.  Where nothing
but a touch sets the limit of the sudden force, agent.control.touch tells one that is above it.  What pulls
against the motion, down or up (agent.control.against) or strikes (agent.control.knock) has limits in cells of three
and more arms: what a touch needs, or what friction and noise make of it; so has what hangs on the object with what
friction bears (agent.control.borne), but with joints that stick both together.  REVERSAL, PEAK, CREEP, HUM, ALONG and
CLIMBING are calibrated on the largest values that studies of the shipped cells showed (a test has them), LOAD, STEPS
and SHAKEN on those of cells that `coop new` made, too; a planar moment has a CREEP of its own.  agent.config.usual
works the sizes out.
"""

from __future__ import annotations

import math
from typing import Final

from agent.config.cell import Arm, Cell
from agent.config.usual import down, usual
from agent.control.against import Against
from agent.control.borne import Bearing
from agent.control.brace import Brace
from agent.control.knock import Knock
from agent.control.residual import Channels
from agent.control.touch import Touch

MARGIN: Final = 1.4
BLOW: Final = 1.5  # margin of the fast channel, in which a touch comes on top of what is usual
REVERSAL: Final = (0.3, 0.6)  # force, moment: of the friction, the sudden part
PEAK: Final = 6.7  # of noise, beyond the quadratic sum of half steps
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
SHAKEN: Final = (0.1, 1.7)  # of friction, and of steps of encoders and speeds: up
TOUCH_ALONG: Final = (1.05, 0.15)  # times an arm's share of a touch
TOUCH_LOAD: Final = 1.4  # times that share, of what hangs on the object with what friction bears (0.93 seen)
LOAD: Final = 0.85  # of friction and noise, for the same (0.52 N seen where nobody fails, of 1.1)
STUCK: Final = 0.82  # of them, or all friction along gravity, beside that share: the same with joints that stick
KNOCK: Final = 1.05  # of the level's limit, for what strikes the object
STEPS: Final = 3.15  # of steps of encoders and speeds, when a joint that stuck breaks away, for the same (2.6 seen)
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
    friction, noise, errors = usual(cell)[:3]
    touch = TOUCH * _share_N(cell)
    floors = FLOORS._replace(fast_N=max(FLOORS.fast_N, touch), fast_Nm=max(FLOORS.fast_Nm, TOUCH_LEVER_M * touch))
    hum = HUM * math.sqrt(slow_rate(cell) / cell.file.safety.noticing.rate_per_s)
    twist = CREEP_TWIST_PLANAR if cell.planar else CREEP
    found = (
        REVERSAL[0] * friction.force_N + PEAK * noise.force_N,
        REVERSAL[1] * friction.moment_Nm + PEAK * noise.moment_Nm,
        CREEP * math.hypot(friction.force_N, errors.force_N) + hum * noise.force_N,
        twist * math.hypot(friction.moment_Nm, errors.moment_Nm) + hum * noise.moment_Nm,
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
        return Against(period_s, spec.against_N or math.inf, spec.climb_N or math.inf, down(cell))
    share, usual_N, of = _share_N(cell), _usual_N(cell), usual(cell)
    level, climb = (max(t * share, a * usual_N) for t, a in zip(TOUCH_ALONG, ALONG, strict=True))
    climb_N = spec.climb_N or float(f"{climb:.3g}")
    if spec.against_N:
        return Against(period_s, spec.against_N, climb_N, down(cell))
    shaken = MARGIN * (SHAKEN[0] * of.friction.force_N + SHAKEN[1] * of.steps.force_N)
    level_N, climbing_N, shaken_N = (float(f"{x:.3g}") for x in (level, CLIMBING * usual_N, shaken))
    return Against(period_s, level_N, climb_N, down(cell), climbing_N=climbing_N, shaken_N=shaken_N)


def bearing(cell: Cell, arm: Arm) -> Bearing | None:
    """Sense of what hangs on the object with what the friction feed-forward of this arm bears.

    None of two arms, without gravity, and where nothing is fed forward, or friction that sticks.  Raises ConfigError.
    """
    friction = cell.offline(arm).friction
    if friction is None or friction.sticks or len(cell.arms) <= ALONE or not any(down(cell)):
        return None
    share, usual_N = _share_N(cell), _usual_N(cell)
    limits = (
        max(TOUCH_LOAD * share, LOAD * usual_N),
        TOUCH_ALONG[0] * share + max(usual(cell).turned_N, STUCK * usual_N),
    )
    load_N, stuck_N = (float(f"{limit:.3g}") for limit in limits)
    return Bearing(1.0 / cell.file.rate_hz, load_N, stuck_N, friction, down(cell))


def loads_N(cell: Cell) -> tuple[float, float] | None:
    """Limits of `bearing`, of joints that move and with those that stick; None where no arm has it.

    Raises ConfigError.
    """
    each = (bearing(cell, arm) for arm in cell.arms)
    return next(((found.limit_N, found.stuck_limit_N) for found in each if found is not None), None)


def knock(cell: Cell, along: Against | None) -> Knock | None:
    """What strikes the object; None without `against` of the cell (`along`).

    Raises ConfigError where an arm cannot be placed.
    """
    if along is None:
        return None
    stepped_N = 0.0 if cell.file.safety.noticing.against_N else STEPS * usual(cell).steps.force_N
    return Knock(along.period_s, float(f"{max(KNOCK * along.level_N, stepped_N):.3g}"))


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
    return Touch(1.0 / cell.file.rate_hz, spec.rate_per_s, most_N, down_N, plain_N, down(cell))


def _share_N(cell: Cell) -> float:
    """What an arm feels of a touch."""
    return TOUCH_N / len(cell.arms)


def _usual_N(cell: Cell) -> float:
    """Force of friction and noise, with a margin, of which limits of three and more arms are a part."""
    of = usual(cell)
    return MARGIN * (of.friction.force_N + of.noise.force_N)
