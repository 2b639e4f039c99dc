"""The cell's plant as the world of emulated servos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.build import AnyPlant, build_plant
from sim_backend.physics.handled import HandledPlant
from sim_backend.physics.spec import PlantError, PlantSpec
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.coupled_world import CoupledWorld
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.whole_world import WholeSpec, WholeWorld
from sim_backend.wire.wiring import ArmWiring


def without_servo_electronics(spec: PlantSpec) -> PlantSpec:
    """Return the plant's specification with friction kept and all else that emulated servos bring themselves removed.

    Delay (what bus, agent and clock make of it), command resolution, torque limit, back-EMF and quantised readings come
    from the servos; a wrong torque constant (`torque_scale`), wrong zeros, backlash and friction stay with the plant.
    """

    def bare(actuator: ActuatorSpec) -> ActuatorSpec:
        return ActuatorSpec.of(
            actuator.joint_count,
            torque_scale=actuator.torque_scale,
            coulomb_Nm=actuator.coulomb_Nm,
            viscous_Nms_rad=actuator.viscous_Nms_rad,
            coulomb_speed_rad_s=actuator.coulomb_speed_rad_s,
            zero_error_rad=actuator.zero_error_rad,
            backlash_rad=actuator.backlash_rad,
        )

    return replace(spec, arms=tuple(replace(arm, actuator=bare(arm.actuator)) for arm in spec.arms))


class PlantWorld(CoupledWorld):
    """The plant of sim_backend.physics.  Build the plant from `without_servo_electronics`.

    With `supported` the cell rests on a support until the servos of every arm have given torque once; before that
    nobody holds the object, and it would fall before the agents have switched torque on.
    """

    def __init__(self, plant: AnyPlant, *, supported: bool = True) -> None:
        super().__init__(plant)
        self.plant = plant
        self._idle = set(range(len(plant.slices))) if supported else set()

    @property
    def supported(self) -> bool:
        """True while the cell rests on its support."""
        return bool(self._idle)

    def apply(self, arm: int, tau_Nm: Sequence[float]) -> None:
        """Set the torques of an arm's servos."""
        self.tau_Nm[self.plant.slices[arm]] = tau_Nm
        if arm in self._idle and any(tau_Nm):
            self._idle.remove(arm)

    def advance(self) -> None:
        """Let one substep pass.  Raises PlantError when the motion is no longer finite."""
        if self._idle:
            self.plant.rest(1)
        else:
            self.plant.advance(self.acting(), 1)


def emulate(
    spec: PlantSpec,
    arms: Sequence[ArmWiring],
    *,
    timing: BusTiming | None,
    supported: bool = True,
) -> tuple[EmulatedCell, PlantWorld]:
    """Build emulated servos on the plant of a cell; `arms` in the order of `spec.arms`.

    `timing` None makes every reply available at once.

    Raises PlantError (GraspError) when the plant cannot be built.
    """
    world = PlantWorld(build_plant(without_servo_electronics(spec)), supported=supported)
    emulated = [EmulatedArm(wiring, timing=timing) for wiring in arms]
    return EmulatedCell(emulated, world), world


def emulate_whole(
    spec: PlantSpec, whole: WholeSpec, arms: Sequence[ArmWiring], *, timing: BusTiming | None
) -> tuple[EmulatedCell, WholeWorld]:
    """Build emulated servos on a cell from rest to rest; `spec` has pads, `arms` are in its order.

    Raises PlantError (GraspError) when the plant cannot be built, or an arm has no gripper.
    """
    world = WholeWorld(HandledPlant(without_servo_electronics(spec)), whole)
    emulated = [EmulatedArm(wiring, timing=timing) for wiring in arms]
    grippers = [arm.gripper for arm in emulated]
    found = [gripper for gripper in grippers if gripper is not None]
    if len(found) != len(arms):
        raise PlantError(
            "grippers", found=f"{len(found)} for {len(arms)} arms", expected="one each", remedy="wire them"
        )
    world.fingers = tuple(found)
    return EmulatedCell(emulated, world), world
