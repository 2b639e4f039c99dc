"""How a real arm and its twin in the simulated cell are kept together: formulae and their state, without any clock.

Both get the agent's torque τ.  In every cycle, with q, dq of the real arm and q_t, dq_t, h of the twin (h: the mean
torque of its grasp over the last cycle),

    c = K (q_t − q) + D (dq_t − dq),   K = w² diag B,   D = 2 z w diag B
    p = B (dq − dq_t),   I += T (a₋₂ − h + b₋₂ + r),   r = L (p − I)
    a = clip(alive (h + c)) to the real arm,   −b = −alive (c − r) to the twin.

a is what carries the object's part to the real arm.  r is the torque by which the real arm does otherwise than its
model; the twin is given it, so that the partners feel it.  c takes away what is left.  w follows from the loop's delay
(drivers.rehearsal).

Somebody who touches the arm shows in u, which is r with a higher L, as what is more than r̄, the mean of r over 0.2 s.
For a share s of it (sim_backend.hil.touch) arm and twin are parted: the agent goes by its twin, which feels none of it,

    q + s (q_t − q),   a = clip(alive (h + c − s (u − r̄))),   b = (1 − s) alive (c − r) − s r̄.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.interface import Vector
from sim_backend.hil.touch import Borne, Touch

FRESH_CYCLES: Final = 3.0  # a state of the twin older than this is stale
FADE_S: Final = 0.1  # in which the addition goes to zero when it is
OBSERVER_PER_S: Final = 40.0  # L
SUDDEN_PER_S: Final = 60.0  # L of u
LOOK_BACK: Final = 2  # cycles until a torque shows in the motion
LASTING_S: Final = 0.2  # over which r is averaged for a twin whose arm is silent


@dataclass(frozen=True, eq=False)
class Settings:
    """One arm's coupling."""

    period_s: float
    frequency_rad_per_s: float  # w
    damping_ratio: float  # z
    clamp_Nm: Vector  # (n,) largest addition
    ramp_s: float  # from nothing to the whole coupling
    apart_max_rad: float  # of any joint, beyond which arm and twin have nothing to do with each other
    touch: Borne


@dataclass(frozen=True, slots=True)
class TwinState:
    """What the plant says of a twin; arrays belong to the receiver."""

    stamp_ns: int
    q: Vector  # (n,) rad
    dq: Vector  # (n,) rad/s
    grasp: Vector  # (n,) N·m, mean torque of its grasp over the cycle before
    pulled: Vector  # (n,) N·m, the same over all cycles since the state that was seen before


@dataclass(frozen=True, slots=True)
class Here:
    """The arm's own dynamics where it is."""

    inertia: NDArray[np.float64]  # B (n, n)
    to_force: NDArray[np.float64]  # (3, n) force where the object is, of joint torques


class _Otherwise:
    """Observer of the torque r by which the real arm does otherwise than the twin; zero until both have moved along."""

    def __init__(self, rate_per_s: float, limit_Nm: Vector) -> None:
        """rate_per_s: L; limit_Nm (n,): r is no larger."""
        self._rate_per_s, self._limit_Nm = rate_per_s, limit_Nm
        self._estimate: Vector | None = None  # I
        self.r: Vector = np.zeros_like(limit_Nm)

    def end(self) -> None:
        """They do not move along any more."""
        self._estimate = None

    def advance(self, p: Vector, acted: Vector, dt: float) -> Vector:
        """r (n,); p (n,): difference of their momenta; acted (n,): torque that was on the one and not on the other."""
        if self._estimate is None:
            self._estimate, self.r = p, np.zeros_like(p)
        else:
            self._estimate = self._estimate + dt * (acted + self.r)
            self.r = _clamped(self._rate_per_s * (p - self._estimate), self._limit_Nm)
        return self.r


class Coupling:
    """The coupling of one arm; `addition` and `on_twin` hold until the next call of `step` or `alone`."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        n = len(settings.clamp_Nm)
        self.addition: Vector = np.zeros(n)  # to the real arm's torque
        self.on_twin: Vector = np.zeros(n)  # to the twin's torque
        self.lasting: Vector = np.zeros(n)  # of that what stays when the arm is silent: alive r, averaged
        self.q_twin: Vector = np.zeros(n)  # at the real arm's instant
        self.age_s = 0.0
        self.alive = 0.0  # 0: apart, 1: coupled
        self.touch = Touch(settings.touch)
        self._dq_twin: Vector = np.zeros(n)
        self._otherwise = _Otherwise(OBSERVER_PER_S, settings.clamp_Nm)
        self._sudden = _Otherwise(SUDDEN_PER_S, np.full(n, np.inf))  # u
        self._grasp: Vector = np.zeros(n)  # the object's part of the addition
        self._before: deque[Vector] = deque([np.zeros(n)] * LOOK_BACK, LOOK_BACK)  # a + b of the last cycles
        self._stamp_ns: int | None = None

    @property
    def fresh(self) -> bool:
        """Whether the twin's state was fresh at the last step."""
        return self.age_s <= FRESH_CYCLES * self.settings.period_s

    def step(self, stamp_ns: int, q: Vector, dq: Vector, twin: TwinState, here: Here) -> None:
        """A fresh state of the real arm, the newest one of the twin, and what is known of the arm there."""
        s, dt, B = self.settings, self._elapsed_s(stamp_ns), here.inertia
        self.age_s = (stamp_ns - twin.stamp_ns) * 1e-9
        horizon = FRESH_CYCLES * s.period_s
        dq_t = self._dq_twin = twin.dq
        self.q_twin = twin.q + dq_t * min(max(self.age_s, -horizon), horizon)
        self._ramp(dt / s.ramp_s if self.fresh else -dt / FADE_S)
        if self.alive == 0.0:
            self._end()
        p, acted = B.dot(dq - dq_t), self._acted(dt) - twin.pulled
        r, u = self._otherwise.advance(p, acted, dt), self._sudden.advance(p, acted, dt)
        inertia, w = np.diagonal(B), s.frequency_rad_per_s
        c = inertia * (w * w * (self.q_twin - q) + 2.0 * s.damping_ratio * w * (dq_t - dq))
        beside, share = u - self.lasting, 0.0
        if not self.fresh:
            self.touch.over()
        elif self.alive == 1.0:
            self.touch.advance(_size(here.to_force.dot(beside)), _size(here.to_force.dot(c)), dt)
            share = self.touch.share
        self._grasp = self._clamped(self.alive * twin.grasp)
        self.addition = self._clamped(self.alive * (twin.grasp + c - share * beside))
        self.on_twin = (1.0 - share) * self.alive * (r - c) + share * self.lasting
        self.lasting = self.lasting + (1.0 - share) * min(1.0, dt / LASTING_S) * (self.alive * r - self.lasting)
        self._before.append(self.addition - self.on_twin)

    def seen(self, q: Vector, dq: Vector) -> tuple[Vector, Vector, Vector]:
        """What the agent goes by, for the arm's joints q and velocities dq (n,): its twin's while the arm is touched.

        And the joints of the one of the two that it does not go by.
        """
        share = self.touch.share
        if share == 0.0:
            return q, dq, self.q_twin
        rest = 1.0 - share
        return rest * q + share * self.q_twin, rest * dq + share * self._dq_twin, rest * self.q_twin + share * q

    def unheard(self) -> None:
        """A cycle without a state of the real arm: what answered its motion is gone, on both sides.

        The object's part stays on the arm; on the twin it is what the arm has lately done otherwise than its model.
        """
        self.addition, self.on_twin = self._grasp, self.lasting
        self._before.append(self.addition - self.on_twin)

    def alone(self, stamp_ns: int) -> None:
        """A fresh state of the real arm, whose twin is not to be followed any more: the addition fades."""
        before = self.alive
        self._ramp(-self._elapsed_s(stamp_ns) / FADE_S)
        self.addition = self.addition * (self.alive / before if before > 0.0 else 0.0)
        self.on_twin = self.lasting = np.zeros_like(self.on_twin)
        self._end()
        self._before.append(self.addition)

    def apart_rad(self, q: Vector) -> float:
        """Largest difference of a joint between the real arm at q (n,) and the twin."""
        return float(np.abs(self.q_twin - q).max())

    def _acted(self, dt: float) -> Vector:
        """What of the last cycles' torques, on the arm and not on its twin, made the motion of the last dt s."""
        T, (older, newer) = self.settings.period_s, self._before
        return older if dt <= T else (T * older + (dt - T) * newer) / dt

    def _end(self) -> None:
        """Arm and twin do not move along."""
        self._otherwise.end()
        self._sudden.end()
        self.touch.over()

    def _clamped(self, tau_Nm: Vector) -> Vector:
        return _clamped(tau_Nm, self.settings.clamp_Nm)

    def _ramp(self, by: float) -> None:
        self.alive = min(1.0, max(0.0, self.alive + by))

    def _elapsed_s(self, stamp_ns: int) -> float:
        """Since the last step, at most as long as a state is fresh."""
        before, self._stamp_ns = self._stamp_ns, stamp_ns
        period_s = self.settings.period_s
        if before is None:
            return period_s
        return min(max((stamp_ns - before) * 1e-9, 0.0), math.ceil(FRESH_CYCLES) * period_s)


def _clamped(tau_Nm: Vector, clamp_Nm: Vector) -> Vector:
    return np.minimum(np.maximum(tau_Nm, -clamp_Nm), clamp_Nm)


def _size(force: NDArray[np.float64]) -> float:
    return math.sqrt(float(force.dot(force)))
