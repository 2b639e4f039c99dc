"""When a torque acts: a whole number of control periods and a part of one after the sample it answers, to the substep.

Within the substep in which one torque takes over from the one before, the mean of both over that substep acts, so that
the impulse is that of the exact instant.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from drivers.interface import Vector

WHOLE_TOLERANCE = 1e-6  # substeps


class DelayLine:
    """Torques on their way to the motors of one arm: what is pushed at tick k acts from `delay_s` after tick k on."""

    def __init__(self, delay_s: float, substep_s: float, substeps: int, joint_count: int) -> None:
        """substeps: of substep_s in a control period."""
        late = delay_s / substep_s
        late = float(round(late)) if abs(late - round(late)) <= WHOLE_TOLERANCE else late
        self.periods = int(late // substeps)  # whole ones: a torque cannot act earlier than so many ticks later
        self.first_substep = math.ceil(late)  # counted from tick 0: from here on nothing but what was pushed acts
        self._switch = late - substeps * self.periods  # substeps of a tick before the newer torque takes over
        self._rows = np.zeros((self.periods + 2, joint_count))

    @property
    def changes(self) -> tuple[int, ...]:
        """Substeps of a tick from which on another torque acts than in the substep before."""
        return (0, math.floor(self._switch), math.ceil(self._switch))

    def push(self, tick: int, tau_Nm: Vector) -> None:
        """Remember the command of `tick`."""
        self._rows[tick % len(self._rows)] = tau_Nm

    def acting(self, tick: int, substep: int = 0) -> Vector:
        """Torque (n,) that acts during a substep of `tick`, zero until the first comes through; not to write to."""
        newer: Vector = self._rows[(tick - self.periods) % len(self._rows)]
        older_share = self._switch - substep
        if older_share <= 0.0:
            return newer
        older: Vector = self._rows[(tick - self.periods - 1) % len(self._rows)]
        return older if older_share >= 1.0 else older_share * older + (1.0 - older_share) * newer

    def is_known(self, substep: int) -> bool:
        """Whether what acts during a substep of any tick is known before the command of that tick."""
        return self.periods >= 1 or self._switch - substep >= 1.0

    def clear(self) -> None:
        """Forget what is on its way: torque is off."""
        self._rows[:] = 0.0


def stretches(lines: Iterable[DelayLine], substeps: int) -> tuple[tuple[int, int], ...]:
    """(first substep, number) of the parts of a tick in which every line's torque is constant."""
    begins = sorted({at for line in lines for at in line.changes if at < substeps} | {0})
    return tuple((begin, end - begin) for begin, end in zip(begins, [*begins[1:], substeps], strict=True))
