"""Joint position and velocity for the law, from the servos' quantised values; pure, its state is in `Memory`.

A servo reports position in steps of 1.5 mrad and velocity in steps of 24 mrad/s.  The observer predicts both
with the acceleration that the law expects of the joint and corrects the prediction by the measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.control.memory import Memory
from drivers.interface import Vector


@dataclass(frozen=True, slots=True)
class Observer:
    """Fixed-gain observer of all joints; gains per tick."""

    period_s: float
    position_gain: float  # share of the position innovation that corrects the position
    velocity_gain_per_s: float  # of the position innovation, into velocity
    velocity_gain: float  # share of the velocity innovation that corrects the velocity
    delay_cycles: int  # 0 or 1: torque of a tick acts from that tick, or from the next one

    def correct(self, memory: Memory, q_measured: Vector, dq_measured: Vector) -> tuple[Vector, Vector]:
        """Estimates (q, dq), each (n,), at the instant of the measurement."""
        if not memory.primed:
            return q_measured, dq_measured
        ddq = memory.ddq_before if self.delay_cycles else memory.ddq
        return self.follow(memory.q, memory.dq, ddq, q_measured, dq_measured)

    def follow(
        self, q: Vector, dq: Vector, ddq: Vector, q_measured: Vector, dq_measured: Vector
    ) -> tuple[Vector, Vector]:
        """Estimates one period after (q, dq), with acceleration ddq expected in between; linear in all arguments."""
        T = self.period_s
        dq_predicted = dq + T * ddq
        q_predicted = q + T * dq + (0.5 * T * T) * ddq
        q_innovation = q_measured - q_predicted
        dq_innovation = dq_measured - dq_predicted
        q = q_predicted + self.position_gain * q_innovation
        dq = dq_predicted + self.velocity_gain_per_s * q_innovation + self.velocity_gain * dq_innovation
        return q, dq
