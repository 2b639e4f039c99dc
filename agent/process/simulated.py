"""The simulated cell's description, from the cell file and its reality; the plant loads its own models from it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.friction import joint_friction
from agent.config.reality import reality_of
from agent.config.schema.fault import Fault, FaultKind
from agent.config.schema.reality import Reality as RealityEntry
from agent.config.schema.simulation import Effects
from drivers.dynamixel.servo.counts import PWM_UNIT_DUTY, TICK_RAD, VELOCITY_UNIT_RAD_PER_S
from drivers.dynamixel.servo.models import RATED_VOLTAGE_V
from drivers.interface import Vector
from drivers.substeps import substep_s
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.calendar import Happening, Limpness, Opening, Push, Seizure
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.reality import ArmReality, Reality, realised
from sim_backend.physics.spec import ArmSpec, GraspSpec, ObjectSpec, PlantSpec

_STRUCK: Final[Mapping[FaultKind, type[Limpness | Seizure | Opening]]] = MappingProxyType(
    {FaultKind.LIMP: Limpness, FaultKind.LOCKED: Seizure, FaultKind.OPEN: Opening}
)


def plant_spec(
    cell: Cell, q_start: Sequence[Vector], reality: RealityEntry | None = None, faults: Sequence[Fault] = ()
) -> PlantSpec:
    """Plant of the cell as it is: the object at its start pose, arms at q_start or, where they are off, near it.

    reality: in the place of the cell's own; faults: beside the cell's own.  Twins of arms in the loop are as the files
    say: what is otherwise about an arm is so about the real one (`lone_spec`).  Raises PlantError (GraspError) where it
    cannot be.
    """
    spec = _realised(cell, q_start, reality or reality_of(cell), cell.file.looped)
    return replace(spec, happenings=(*spec.happenings, *_struck(cell, faults)))


def lone_spec(cell: Cell, q_start: Sequence[Vector]) -> PlantSpec:
    """The cell whose arms are as real ones are, for those in the loop that are emulated, each on its own."""
    return _realised(cell, q_start, reality_of(cell), ())


def _realised(cell: Cell, q_start: Sequence[Vector], real: RealityEntry | None, twins: Collection[str]) -> PlantSpec:
    believed = _believed_spec(cell, q_start)
    if real is None:
        return believed
    given = real.model_dump(exclude={"seed", "arms"})
    arms = {name: ArmReality(**arm.model_dump()) for name, arm in real.arms.items() if name not in twins}
    return realised(believed, Reality(**given, arms=arms))


def _believed_spec(cell: Cell, q_start: Sequence[Vector]) -> PlantSpec:
    obj, heavier = cell.file.object, 1.0 + cell.file.simulation.object_mass_error
    return PlantSpec(
        arms=tuple(_arm_spec(cell, arm, q) for arm, q in zip(cell.arms, q_start, strict=True)),
        object=ObjectSpec(
            heavier * obj.mass_kg,
            heavier * np.array(obj.inertia_kg_m2.matrix()),
            np.array(cell.file.p_place_m),
            np.array(obj.quat_start),
        ),
        gravity=cell.gravity,
        substep_s=substep_s(cell.file.rate_hz, cell.file.simulation.substeps_per_cycle),
        grasp=_pads(cell),
        happenings=_happenings(cell),
    )


def _happenings(cell: Cell) -> tuple[Happening, ...]:
    """What befalls the cell, on the plant's clock, which a lockstep run starts `ready_s` before the trajectory's.

    Of a run at the wall clock's pace the start is known later (agent.process.common_start).
    """
    simulation = cell.file.simulation
    begin = simulation.ready_s
    pushes = [Push(begin + p.at_s, p.duration_s, (*p.force_N, *p.moment_Nm)) for p in simulation.push]
    openings = [Opening(begin + o.at_s, o.arm) for o in simulation.opening]
    return (*pushes, *openings, *_struck(cell, simulation.fault))


def _struck(cell: Cell, faults: Sequence[Fault]) -> list[Happening]:
    """What the plant does of them, at the begin of a cycle; an arm that holds is stopped by whoever runs its agent."""
    rate_hz, ready_s = cell.file.rate_hz, cell.file.simulation.ready_s
    begin = round(ready_s * rate_hz)
    return [
        _STRUCK[fault.kind]((begin + fault.cycle(cell.period_ns)) / rate_hz, fault.arm)
        for fault in faults
        if fault.kind is not FaultKind.HOLD
    ]


def _pads(cell: Cell) -> GraspSpec | None:
    grasp = cell.file.simulation.grasp
    return None if grasp is None else GraspSpec(**grasp.model_dump())


def _arm_spec(cell: Cell, arm: Arm, q_start: Vector) -> ArmSpec:
    return ArmSpec(
        name=arm.name,
        urdf_xml=arm.urdf_xml,
        controlled=tuple(arm.entry.controlled),
        locked_rad=arm.entry.locked_rad,
        T_world_base=arm.T_world_base,
        ee_frame=arm.file.ee_frame,
        T_object_ee=arm.T_object_ee,
        q_start=q_start,
        rotor_inertia=arm.rotor_inertia,
        actuator=actuator_spec(cell, arm),
        friction=_friction(cell, arm),
    )


def _friction(cell: Cell, arm: Arm) -> FrictionSpec | None:
    """Friction with presliding where the arm file has breakaway or load friction for any joint."""
    if not (cell.file.simulation.effects.friction and any(s.sticks for s in arm.servos)):
        return None
    coulomb, viscous, breakaway, speed, exponent, load, breakaway_load = np.array(
        [joint_friction(servo) for servo in arm.servos]
    ).T
    return FrictionSpec(coulomb, breakaway, speed, exponent, load, breakaway_load, viscous)


def actuator_spec(cell: Cell, arm: Arm) -> ActuatorSpec:
    """What the arm's servos add, as far as the cell switches it on."""
    effects: Effects = cell.file.simulation.effects
    n, zero = arm.n, np.zeros(arm.n)
    infinite = np.full(n, np.inf)
    return ActuatorSpec.of(
        n,
        delay_s=cell.file.simulated_delay_s,
        tau_max_Nm=arm.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall,
        torque_lsb_Nm=_torque_lsb(arm) if effects.torque_quantisation else zero,
        torque_scale=1.0 + effects.torque_constant_error,
        stall_Nm=arm.tau_stall_Nm if effects.saturation else infinite,
        no_load_rad_s=np.array([m.no_load_rad_per_s for m in arm.servo_models]) if effects.saturation else infinite,
        coulomb_Nm=np.array([s.coulomb_Nm.value for s in arm.servos]) if effects.friction else zero,
        viscous_Nms_rad=np.array([s.viscous_Nm_s_per_rad.value for s in arm.servos]) if effects.friction else zero,
        coulomb_speed_rad_s=cell.file.simulation.friction_smooth_rad_per_s,
        position_lsb_rad=TICK_RAD if effects.position_quantisation else 0.0,
        velocity_lsb_rad_s=VELOCITY_UNIT_RAD_PER_S if effects.velocity_quantisation else 0.0,
    )


def _torque_lsb(arm: Arm) -> Vector:
    """(n,) N·m per step of goal current, or of goal PWM where a servo has no current mode."""
    steps = []
    for servo, model in zip(arm.servos, arm.servo_models, strict=True):
        if model.current_unit_mA is not None and model.has_current_mode:
            constant = servo.torque_constant_Nm_per_A
            per_ampere = constant.value if constant is not None else model.torque_constant_Nm_per_A
            step = model.current_unit_mA * 1e-3 * per_ampere
        else:
            step = PWM_UNIT_DUTY * RATED_VOLTAGE_V * model.stall_torque_Nm_per_V
        steps.append(step * len(servo.ids))
    return np.array(steps)
