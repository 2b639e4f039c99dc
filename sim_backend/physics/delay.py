"""When a torque acts: a whole number of control periods and a part of one after the sample it answers, to the substep.

Within the substep in which one torque takes over from the one before, the mean of both over that substep acts, so that
the impulse is that of the exact instant.  A delay may differ from tick to tick, the same in every run of one jitter:
another size of it, which another reality draws, is another sequence.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorError, ActuatorSpec

WHOLE_TOLERANCE = 1e-6  # substeps
JITTER_UNIT_S = 1e-12  # jitters that differ by more are other sequences
JITTER_TICKS = 4096  # after so many ticks the sequence of a delay that jitters begins again


class DelayLine:
    """Torques on their way to the motors of one arm: what is pushed at tick k acts from `delay_s` after tick k on."""

    def __init__(
        self, delay_s: float, substep_s: float, substeps: int, joint_count: int, *, jitter_s: float = 0.0, seed: int = 0
    ) -> None:
        """substeps: of substep_s in a control period; jitter_s: by which the delay differs from delay_s at most.

        Raises ActuatorError where torques could overtake each other.
        """
        late, jitter = delay_s / substep_s, jitter_s / substep_s
        if not 0.0 <= 2.0 * jitter < substeps:
            raise ActuatorError(
                "delay_jitter_s", found=f"{jitter_s:g}",
                expected=f"below half a period, {substep_s * substeps / 2:g} s",
                remedy="lower it: a torque would overtake the one before",
            )  # fmt: skip
        late = float(round(late)) if abs(late - round(late)) <= WHOLE_TOLERANCE else late
        earliest = late - jitter
        self.periods = int(earliest // substeps)  # whole ones: a torque cannot act earlier than so many ticks later
        self.first_substep = math.ceil(late + jitter)  # counted from tick 0: from here on only what was pushed acts
        self._substeps = substeps
        self._switch = earliest - substeps * self.periods  # substeps of a tick before the newer torque can take over
        self._lates: list[float] = []  # of the ticks, in substeps, where they differ
        if jitter > 0.0:
            rng = np.random.default_rng([seed, round(jitter_s / JITTER_UNIT_S)])
            self._lates = (late + jitter * rng.uniform(-1.0, 1.0, JITTER_TICKS)).tolist()
        self._rows = np.zeros((int((late + jitter) // substeps) + 3, joint_count))

    @classmethod
    def of(cls, actuator: ActuatorSpec, substep_s: float, substeps: int, seed: int) -> DelayLine:
        """Line of an arm's servos; seed: of its jitter, which lines that jitter apart do not share."""
        return cls(
            actuator.delay_s, substep_s, substeps, actuator.joint_count, jitter_s=actuator.delay_jitter_s, seed=seed
        )

    @property
    def changes(self) -> tuple[int, ...]:
        """Substeps of a tick from which on another torque acts than in the substep before."""
        if self._lates:
            return tuple(range(self._substeps))
        return (0, math.floor(self._switch), math.ceil(self._switch))

    def push(self, tick: int, tau_Nm: Vector) -> None:
        """Remember the command of `tick`."""
        self._rows[tick % len(self._rows)] = tau_Nm

    def acting(self, tick: int, substep: int = 0) -> Vector:
        """Torque (n,) that acts during a substep of `tick`, zero until the first comes through; not to write to."""
        if self._lates:
            return self._jittered(tick, substep)
        newer: Vector = self._rows[(tick - self.periods) % len(self._rows)]
        older_share = self._switch - substep
        if older_share <= 0.0:
            return newer
        older: Vector = self._rows[(tick - self.periods - 1) % len(self._rows)]
        return older if older_share >= 1.0 else older_share * older + (1.0 - older_share) * newer

    def _jittered(self, tick: int, substep: int) -> Vector:
        """Mean over the substep of the torques that act in it, each from its own instant to that of the next."""
        begin = tick * self._substeps + substep
        tau: Vector = np.zeros(self._rows.shape[1])
        until = begin + 1.0
        for pushed in range(tick, tick - len(self._rows) + 1, -1):
            since = pushed * self._substeps + self._lates[pushed % JITTER_TICKS]
            if since < until:
                share = until - max(since, float(begin))
                tau += share * self._rows[pushed % len(self._rows)]
                until -= share
            if until <= begin:
                break
        return tau

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
