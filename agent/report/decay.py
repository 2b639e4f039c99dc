"""How an error at the start of a run goes away: its size, and when it is half and a tenth of that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np

from agent.report.arithmetic import NAN
from agent.report.quantity import Better, Unit
from agent.report.series import Array


@dataclass(frozen=True, slots=True)
class PositionDecay:
    """Times since the first row that follows the trajectory, NaN if it has not gone."""

    initial: Annotated[float, Unit("m", Better.NEITHER)]
    half_s: Annotated[float, Unit("s")]  # first time at half the initial error or below
    tenth_s: Annotated[float, Unit("s")]  # from here to the end never above a tenth of it

    @classmethod
    def of(cls, t: Array, error: Array) -> Self:
        """Of the error (k,) at the instants t (k,), s; NaN without any."""
        if not len(error):
            return cls(NAN, NAN, NAN)
        start = float(error[0])
        if start == 0.0:
            return cls(0.0, NAN, NAN)
        below_half = np.flatnonzero(error <= 0.5 * start)
        above_tenth = np.flatnonzero(error > 0.1 * start)
        last = int(above_tenth[-1])
        half_s = float(t[below_half[0]] - t[0]) if len(below_half) else NAN
        return cls(start, half_s, float(t[last + 1] - t[0]) if last + 1 < len(t) else NAN)


@dataclass(frozen=True, slots=True)
class AttitudeDecay(PositionDecay):
    """The same of an angle."""

    initial: Annotated[float, Unit("rad", Better.NEITHER)]
