"""A motion that begins where the object stands: lifted off its support first, at rest before and after; pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from agent.control.quaternion import Quat, Vec3
from agent.control.trajectory import Desired, Trajectory
from agent.control.trajectory_rest import RestToRest


@dataclass(frozen=True, slots=True)
class Lifted:
    """To the first pose of `inner` by minimum jerk within `lift_s` > 0, and then `inner`, later by that."""

    inner: Trajectory
    p_place: Vec3
    quat_place: Quat
    lift_s: float
    _lift: RestToRest = field(init=False)

    def __post_init__(self) -> None:
        first = self.inner.at(0.0)
        lift = RestToRest(self.p_place, self.quat_place, first.p, first.quat, self.lift_s, 0.0, and_back=False)
        object.__setattr__(self, "_lift", lift)

    @property
    def period_s(self) -> float:
        """The inner motion's, and the time of the lift."""
        return self.inner.period_s + self.lift_s

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s); at rest at the place before 0."""
        return self.inner.at(t - self.lift_s) if t >= self.lift_s else self._lift.at(t)
