"""The emulated arms and the physics they share, paced by times that come in from outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.world import JointWorld

CATCH_UP_NS = 200_000_000  # physics further behind than this lets the time go


@dataclass(slots=True)
class CellCounters:
    """Cumulative since the start."""

    substeps: int = 0
    skipped_ns: int = 0  # time that physics never lived through because the host was too slow


class EmulatedCell:
    """All arms of a cell.  `world` moves the joints that are in the plant."""

    def __init__(self, arms: Sequence[EmulatedArm], world: JointWorld | None, start_ns: int = 0) -> None:
        self.arms = tuple(arms)
        self.world = world
        self.counters = CellCounters()
        self.substep_s = world.substep_s if world is not None else 1e-3
        self._substep_ns = round(self.substep_s * 1e9)
        self.time_ns = start_ns
        for arm in self.arms:
            q, _ = self._state(arm)
            arm.power_up(q)

    def advance_to(self, now_ns: int) -> None:
        """Let physics catch up with `now_ns`, then turn all horns to where their joints are at that instant."""
        self.catch_up(now_ns)
        for arm in self.arms:
            self.sense(arm, now_ns)

    def catch_up(self, now_ns: int) -> None:
        """Let physics catch up with `now_ns` in whole substeps."""
        behind_ns = now_ns - self.time_ns
        if behind_ns > CATCH_UP_NS:
            self.counters.skipped_ns += behind_ns - CATCH_UP_NS
            self.time_ns = now_ns - CATCH_UP_NS
        while self.time_ns + self._substep_ns <= now_ns:
            self._substep()

    def sense(self, arm: EmulatedArm, now_ns: int) -> None:
        """Turn the horns of an arm to where its joints are at `now_ns`, so that what it reports is of that instant."""
        arm.sense(*self._state(arm), max(0, now_ns - self.time_ns) * 1e-9)

    def _substep(self) -> None:
        world = self.world
        for arm in self.arms:
            arm.sense(*self._state(arm), 0.0)
            torques = arm.actuate(self.substep_s, self.time_ns)
            if world is not None and arm.plant_arm is not None:
                world.apply(arm.plant_arm, torques)
        if world is not None:
            world.advance()
        self.time_ns += self._substep_ns
        self.counters.substeps += 1

    def _state(self, arm: EmulatedArm) -> tuple[Sequence[float], Sequence[float]]:
        if self.world is None or arm.plant_arm is None:
            return (), ()
        return self.world.state(arm.plant_arm)
