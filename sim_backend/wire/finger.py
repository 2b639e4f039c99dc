"""The gripper of an emulated arm: a joint of its own, with ends, and with whatever stands between its fingers."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.fingers import Fingers
from sim_backend.wire.world import FreeJoint

STIFFNESS_NM_PER_RAD = 20.0  # of what the fingers press on, at the horn
DAMPING_NM_S_PER_RAD = 0.2


@dataclass(slots=True)
class FingerJoint(FreeJoint):
    """`blocked_rad`: the angle at which the fingers touch what is between them; None: nothing is."""

    fingers: Fingers | None = None
    blocked_rad: float | None = None
    pressed_Nm: float = 0.0  # on what is between them, at the horn

    def step(self, tau_Nm: float, dt_s: float) -> None:
        """As a free joint, with the torques of its ends and of what it presses on."""
        fingers = self.fingers
        if fingers is None:
            FreeJoint.step(self, tau_Nm, dt_s)
            return
        opening = 1.0 if fingers.open_rad > fingers.closed_rad else -1.0
        end = fingers.closed_rad if self.blocked_rad is None else self.blocked_rad
        pressed = self._pushed(opening * (end - self.q_rad), -opening * self.dq_rad_per_s)
        self.pressed_Nm = pressed if self.blocked_rad is not None else 0.0
        stopped = self._pushed(opening * (self.q_rad - fingers.open_rad), opening * self.dq_rad_per_s)
        FreeJoint.step(self, tau_Nm + opening * (pressed - stopped), dt_s)

    def force_N(self) -> float:
        """Of each finger on what is between them."""
        return 0.0 if self.fingers is None else self.pressed_Nm / abs(self.fingers.lever(self.q_rad))

    def width_m(self) -> float:
        """Between the fingers."""
        return 0.0 if self.fingers is None else self.fingers.width(self.q_rad)

    @staticmethod
    def _pushed(depth_rad: float, speed_rad_per_s: float) -> float:
        if depth_rad <= 0.0:
            return 0.0
        return max(0.0, STIFFNESS_NM_PER_RAD * depth_rad + DAMPING_NM_S_PER_RAD * speed_rad_per_s)
