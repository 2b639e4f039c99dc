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


class Delay(NamedTuple):
    """From a sample to the instant at which its torque acts."""

    value_s: float
    sigma_s: float
    believed_s: float


def measured(
    recording: Recording, filtered: Callable[[Matrix], Matrix], solve: Callable[[Matrix, Matrix], tuple[Vector, Vector]]
) -> Delay | None:
    """Delay and its standard error, s; None where it finds none that explains the motion.

    filtered: a torque of the whole recording (count, n), low-passed at the samples of the equations (k, n); solve:
    parameters and standard errors of the equations whose torque is shifted by the first argument and whose last column
    is the second, both (k, n).
    """
    T, believed = recording.period_s, recording.delay_s
    before, delay = filtered(recording.tau), believed
    for _ in range(ROUNDS):
        tau = acted(recording.sent, delay / T)
        value, sigma = solve(filtered(tau) - before, filtered(np.gradient(tau, T, axis=0)))
        delay += float(value[-1])
        if not 0.0 <= delay <= LONGEST_PERIODS * T:
            break
        if abs(float(value[-1])) < CLOSE_S:
            return Delay(delay, float(sigma[-1]), believed)
    return None
