"""Whether a gripper has closed on what it should, from what its servo says cycle by cycle; pure."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple

from drivers.interface import GripState

STILL_M_PER_S = 2e-3
SETTLE_S = 0.25  # so long the fingers stand before they are believed
MOVES_M = 1e-3  # less than this is no motion


class GripResult(enum.Enum):
    """What came of a gripper that was told to close, or to open."""

    MOVING = "is still moving"
    HOLDS = "holds the object"
    NOTHING = "closed on nothing"
    TOO_EARLY = "closed on something that is wider than the object"
    STUCK = "does not move"
    OPEN = "is open"
    NO_FORCE = "does not press"


class Watch(NamedTuple):
    """What is remembered of a gripper from cycle to cycle."""

    since_ns: int  # when it was told
    from_m: float  # where it was then
    still_since_ns: int  # since when it stands, or when it last moved


@dataclass(frozen=True, slots=True)
class GripPlan:
    """What the gripper of one arm does with the object of its cell."""

    closed_m: float  # the smallest and largest width of the gripper
    open_m: float
    width_m: float  # of the object between the fingers
    effort: float  # with which it presses
    tolerance_m: float = 3e-3  # of that width
    timeout_s: float = 4.0

    def begin(self, state: GripState) -> Watch:
        """The gripper has just been told to close or to open."""
        return Watch(state.stamp_ns, state.width_m, state.stamp_ns)

    def watch(self, watch: Watch, state: GripState) -> Watch:
        """A cycle later."""
        standing = abs(state.speed_m_per_s) <= STILL_M_PER_S
        return watch if standing else watch._replace(still_since_ns=state.stamp_ns)

    def closing(self, watch: Watch, state: GripState) -> GripResult:
        """What came of closing so far."""
        if not self._settled(watch, state):
            return GripResult.MOVING
        if abs(state.width_m - watch.from_m) < MOVES_M and state.width_m > self.width_m + self.tolerance_m:
            return GripResult.STUCK
        if state.width_m < self.width_m - self.tolerance_m:
            return GripResult.NOTHING
        if state.width_m > self.width_m + self.tolerance_m:
            return GripResult.TOO_EARLY
        return GripResult.HOLDS if state.effort >= 0.5 * self.effort else GripResult.NO_FORCE

    def opening(self, watch: Watch, state: GripState) -> GripResult:
        """What came of opening so far."""
        if state.width_m >= self.open_m - self.tolerance_m:
            return GripResult.OPEN
        return GripResult.STUCK if self._settled(watch, state) else GripResult.MOVING

    def lost(self, state: GripState) -> bool:
        """Whether fingers that held the object are nearer together than it is wide."""
        return state.width_m < self.width_m - self.tolerance_m

    def _settled(self, watch: Watch, state: GripState) -> bool:
        if state.stamp_ns - watch.since_ns > self.timeout_s * 1e9:
            return True
        begun = state.stamp_ns - watch.since_ns > 2e9 * SETTLE_S
        return begun and state.stamp_ns - watch.still_since_ns > SETTLE_S * 1e9
