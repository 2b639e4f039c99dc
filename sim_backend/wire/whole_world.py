"""A cell from rest to rest: arms that begin away from an object that stands on a table, and grip it if they can.

A gripper has something between its fingers while the end effector is near enough to its grasp; pressed on hard enough,
that closes the chain where it is, and opens it again when the fingers let go.  An arm without torque rests where it
stands, if that is its rest, and falls anywhere else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from drivers.fingers import Fingers
from drivers.interface import Vector
from sim_backend.physics.handled import HandledPlant
from sim_backend.physics.spec import PlantError
from sim_backend.physics.support import Support
from sim_backend.wire.coupled_world import CoupledWorld
from sim_backend.wire.finger import FingerJoint

HOLDS_FROM_N, HOLDS_TO_N = 2.0, 0.3  # of a finger: from the first on it holds, below the second it has let go
LOOK_EVERY = 5  # substeps, for what is between the fingers
CRADLE_NMS_PER_RAD = 1e4  # with which an arm without torque lies
CRADLE_WITHIN_RAD = 0.3


@dataclass(frozen=True, eq=False)
class HandSpec:
    """The gripper of one arm, and what it finds between its fingers at its grasp."""

    fingers: Fingers
    width_m: float  # of the object there
    reach_m: float = 0.007  # along and across the fingers: farther from its grasp there is nothing between them
    reach_rad: float = 0.15


@dataclass(frozen=True, eq=False)
class WholeSpec:
    """What a cell from rest to rest has beside its plant."""

    q_rest: tuple[Vector, ...]  # rad, of each arm's controlled joints
    hands: tuple[HandSpec, ...]
    size_m: Vector  # (3,) of the object, object axes
    object_off: pin.SE3  # where the object really stands, in the frame in which the cell believes it to


class WholeWorld(CoupledWorld):
    """The plant with open grasps, a support and grippers; a `sim_backend.wire.world.JointWorld`."""

    def __init__(self, plant: HandledPlant, whole: WholeSpec) -> None:
        if not float(np.abs(plant.spec.gravity).max()):
            raise PlantError("gravity", found="none", expected="some", remedy="a run from rest to rest needs a support")
        super().__init__(plant)
        self.plant = plant
        self.whole = whole
        self.fingers: tuple[FingerJoint, ...] = ()  # of each arm, once its servos are there
        self.holding = [False] * len(plant.slices)
        self._lying = [False] * len(plant.slices)
        self._viscous = [np.array(arm.actuator.viscous_Nms_rad) for arm in plant.spec.arms]
        self._substeps = 0
        stands = plant.spec.object.T_world_object * whole.object_off
        self.T_world_place = pin.SE3(stands)
        body = plant.spec.object
        self._support = Support(stands, whole.size_m, body.mass_kg, plant.spec.gravity)
        plant.let_go(np.concatenate(whole.q_rest), stands)
        for i in range(len(plant.slices)):
            self._lie(i, lying=True)

    def apply(self, arm: int, tau_Nm: Sequence[float]) -> None:
        """Set the torques of an arm's servos."""
        self.tau_Nm[self.plant.slices[arm]] = tau_Nm
        limp = not any(tau_Nm)
        if limp != self._lying[arm] and (not limp or self._rests(arm)):
            self._lie(arm, lying=limp)

    def advance(self) -> None:
        """Let one substep pass.  Raises PlantError when the motion is no longer finite."""
        plant, T = self.plant, self.plant.T_world_object
        wrench = self._support.wrench(T, plant.object_twist)
        plant.push(plant.calendar.wrench + (0.0 if wrench is None else wrench))
        if self._substeps % LOOK_EVERY == 0:
            for arm in range(len(self.fingers)):
                self._look(arm, T)
        self._substeps += 1
        plant.advance(self.acting(), 1)

    def lose(self, arm: int) -> None:
        """Fault: what the gripper of an arm holds slips out of it for good."""
        self.whole = WholeSpec(
            self.whole.q_rest,
            tuple(HandSpec(h.fingers, h.width_m, 0.0, 0.0) if i == arm else h for i, h in enumerate(self.whole.hands)),
            self.whole.size_m,
            self.whole.object_off,
        )
        self._let_go(arm)

    def set_down_error(self) -> tuple[float, float]:
        """m and rad between where the object is and where it stood."""
        off = self.T_world_place.actInv(self.plant.T_world_object)
        return float(np.linalg.norm(off.translation)), float(np.linalg.norm(pin.log3(off.rotation)))

    def _look(self, arm: int, T_world_object: pin.SE3) -> None:
        """What is between the fingers of an arm, and whether it holds it."""
        finger, hand = self.fingers[arm], self.whole.hands[arm]
        force = finger.force_N()
        if self.holding[arm]:
            if force < HOLDS_TO_N:
                self._let_go(arm)
            return
        T_world_ee = self.plant.end_effector(arm)
        off = (T_world_object * self.plant.spec.arms[arm].T_object_ee).actInv(T_world_ee)
        x, y, z = np.abs(off.translation).tolist()
        turned = float(np.linalg.norm(pin.log3(off.rotation)))
        free = max(0.0, 0.5 * (finger.width_m() - hand.width_m)) + hand.reach_m
        between = x <= hand.reach_m and z <= hand.reach_m and y <= free and turned <= hand.reach_rad
        if not between:
            finger.blocked_rad = None
        elif finger.blocked_rad is None and finger.width_m() >= hand.width_m:
            finger.blocked_rad = hand.fingers.angle(hand.width_m)
        if between and force >= HOLDS_FROM_N:
            self.plant.take_hold(arm)
            self.holding[arm] = True

    def _let_go(self, arm: int) -> None:
        if self.holding[arm]:
            self.plant.release(self.plant.spec.names[arm])
        self.holding[arm] = False
        self.fingers[arm].blocked_rad = None

    def _rests(self, arm: int) -> bool:
        off = self.plant.q[self.plant.slices[arm]] - self.whole.q_rest[arm]
        return float(np.abs(off).max()) <= CRADLE_WITHIN_RAD

    def _lie(self, arm: int, *, lying: bool) -> None:
        self._lying[arm] = lying
        viscous = self._viscous[arm]
        self.plant.brake(self.plant.spec.names[arm], np.full_like(viscous, CRADLE_NMS_PER_RAD) if lying else viscous)
