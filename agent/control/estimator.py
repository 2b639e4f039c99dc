"""Joint position and velocity for the law, from the servos' quantised values; pure, its state is in `Memory`.

A servo reports position in steps of 1.5 mrad and velocity in steps of 24 mrad/s.  The observer predicts both
with the acceleration that the law expects of the joint and corrects the prediction by the measurement.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from agent.control.memory import Memory
from agent.control.models import Matrix
from drivers.interface import Vector


def held(
    T: float | Matrix, half_square: float | Matrix, share: float, first: Matrix, rest: Matrix
) -> tuple[Matrix, Matrix]:
    """Change over one period T (s) of a velocity, and of its position beyond T times the velocity at the begin.

    The acceleration is `first` during the first `share` (0 to 1) of the period and `rest` from then on; arrays of any
    one shape.  half_square: ½ T²; both numbers, or both arrays ().
    """
    if share == 1.0:
        return T * first, half_square * first
    if share == 0.0:
        return T * rest, half_square * rest
    late = 1.0 - share
    return T * (share * first + late * rest), half_square * (share * (1.0 + late) * first + late * late * rest)


@dataclass(frozen=True, slots=True)
class Observer:
    """Fixed-gain observer of all joints; gains per tick."""

    period_s: float
    position_gain: float  # share of the position innovation that corrects the position
    velocity_from_position_per_s: float  # of the position innovation, into velocity
    velocity_gain: float  # share of the velocity innovation that corrects the velocity
    delay_periods: float  # 0 to 1: the torque of a tick acts so long after it, until then that of the tick before
    # T, ½ T² and the gains as arrays (): numpy multiplies by a Python float at half the speed
    _arrays: tuple[Matrix, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        T = self.period_s
        gains = self.position_gain, self.velocity_from_position_per_s, self.velocity_gain
        object.__setattr__(self, "_arrays", tuple(map(np.array, (T, 0.5 * T * T, *gains))))

    def correct(self, memory: Memory, q_measured: Vector, dq_measured: Vector) -> tuple[Vector, Vector]:
        """Estimates (q, dq), each (n,), at the instant of the measurement."""
        if not memory.primed:
            return q_measured, dq_measured
        return self.follow(memory.q, memory.dq, memory.ddq_before, memory.ddq, q_measured, dq_measured)

    def follow(
        self, q: Vector, dq: Vector, ddq_before: Vector, ddq: Vector, q_measured: Vector, dq_measured: Vector
    ) -> tuple[Vector, Vector]:
        """Estimates one period after (q, dq); linear in all arguments.

        ddq: acceleration that the torque of the tick at (q, dq) is to give; ddq_before: that of the tick before it.
        """
        T, half_square, position_gain, velocity_from_position, velocity_gain = self._arrays
        dq_change, q_change = held(T, half_square, self.delay_periods, ddq_before, ddq)
        dq_predicted = dq + dq_change
        q_predicted = q + T * dq + q_change
        q_innovation = q_measured - q_predicted
        dq_innovation = dq_measured - dq_predicted
        q = q_predicted + position_gain * q_innovation
        dq = dq_predicted + velocity_from_position * q_innovation + velocity_gain * dq_innovation
        return q, dq
