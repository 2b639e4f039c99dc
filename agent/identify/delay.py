"""The loop's delay as a recording shows it: by how much later the torque acted than it was sent.

Torque that acts δ later than believed is τ(t − δ) = τ − δ dτ/dt, so dτ/dt is one more column, and δ its parameter.
The torque is then taken that much later, until nothing is left over.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.identify.recording import Recording, acted
from drivers.interface import Vector

Matrix = NDArray[np.float64]

ROUNDS: Final = 5
CLOSE_S: Final = 1e-5
LONGEST_PERIODS: Final = 20.0
SURE: Final = 3.0  # standard errors beyond which a delay is another one


class Delay(NamedTuple):
    """From a sample to the instant at which its torque acts."""

    value_s: float
    sigma_s: float
    believed_s: float  # by the cell file
    taken_s: float  # for the other figures

    @property
    def is_taken(self) -> bool:
        """Whether the other figures were found with a delay that may be this one."""
        return abs(self.value_s - self.taken_s) <= SURE * self.sigma_s


def measured(
    recording: Recording, filtered: Callable[[Matrix], Matrix], solve: Callable[[Matrix, Matrix], tuple[Vector, Vector]]
) -> Delay | None:
    """Delay and its standard error, s; None where it finds none that explains the motion.

    filtered: a torque of the whole recording (count, n), low-passed at the samples of the equations (k, n); solve:
    parameters and standard errors of the equations whose torque is shifted by the first argument and whose last column
    is the second, both (k, n).
    """
    T, taken = recording.period_s, recording.delay_s
    before, delay = filtered(recording.tau), taken
    for _ in range(ROUNDS):
        tau = acted(recording.sent, delay / T)
        value, sigma = solve(filtered(tau) - before, filtered(np.gradient(tau, T, axis=0)))
        delay += float(value[-1])
        if not 0.0 <= delay <= LONGEST_PERIODS * T:
            break
        if abs(float(value[-1])) < CLOSE_S:
            return Delay(delay, float(sigma[-1]), taken, taken)
    return None
