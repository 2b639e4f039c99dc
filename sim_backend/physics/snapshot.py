"""One instant of a plant: what was true then, worked out when it is asked for, which may be some motion later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.interface import Vector


@dataclass(frozen=True, eq=False)
class Observation:
    """What is true at one instant and no arm can know.  Arrays belong to the receiver; J = joints of all arms."""

    t: float  # s since the plant's zero
    p_object: Vector  # (3,) m, of its frame, world
    quat_object: Vector  # (4,) scalar first
    v_object: Vector  # (6,) m/s, rad/s, linear first, world axes
    grasp_wrench: Vector  # (N, 6) N, N·m of each arm on the object at its end effector, world axes
    contact_error_m: Vector  # (N,)
    contact_error_rad: Vector  # (N,)
    slip_m: Vector  # (N,) how far pads have slipped since each grasp was closed; zeros of those that do not give
    slip_rad: Vector  # (N,)
    q: Vector  # (J,) rad, arm after arm
    dq: Vector  # (J,) rad/s
    tau_applied: Vector  # (J,) N·m of the motors after all actuator effects
    tau_friction: Vector  # (J,) N·m
    energy: float  # J, kinetic and potential, rotors included


class Snapshot:
    """An instant of which nothing but its state was kept."""

    def __init__(self, work_out: Callable[[], Observation]) -> None:
        """work_out: asked once at most."""
        self._work_out = work_out
        self._seen: Observation | None = None

    def observation(self) -> Observation:
        """What was true then."""
        if self._seen is None:
            self._seen = self._work_out()
        return self._seen
