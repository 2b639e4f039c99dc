"""What may stand under `[simulation.reality]` of a cell file: what the simulated cell has against what its files say.

The agents do not read it: they believe the rest of the file, as the agents of real arms do.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import Field

from agent.config.schema.tolerance import Tolerance, refuse_overtaking
from agent.config.schema.types import AS_LIST, AngularStiffness, LinearStiffness, Name, Seed, Strict, wrong

Offset = Annotated[float, Field(ge=-0.1, le=0.1)]  # m
Turn = Annotated[float, Field(ge=-0.3, le=0.3)]  # rad
Gap = Annotated[float, Field(ge=0.0, le=0.1)]  # rad
Offsets = Annotated[tuple[Offset, Offset, Offset], AS_LIST]
Turns = Annotated[tuple[Turn, Turn, Turn], AS_LIST]
Times = Annotated[float, Field(ge=0.05, le=20.0)]  # what the files say
Friction = Annotated[float, Field(ge=0.0, le=20.0)]  # times what the files say
Seconds = Annotated[float, Field(ge=0.0, le=0.5)]
Rub = Annotated[float, Field(ge=0.0, le=20.0)]  # N·m
LoadPart = Annotated[float, Field(ge=0.0, le=0.9)]  # of the motor's torque
STIFFNESSES: Final = ("pads_N_per_m", "pads_Nm_per_rad")
NOTHING = (0.0, 0.0, 0.0)


class ArmReality(Strict):
    """Errors of one arm; joint values one per controlled joint."""

    base_m: Offsets = NOTHING
    """True base less believed, world axes."""
    base_rad: Turns = NOTHING
    """Rotation vector, world axes, about the base's origin."""
    grasp_m: Offsets = NOTHING
    """True grasp less believed, object axes."""
    grasp_rad: Turns = NOTHING
    """Rotation vector, object axes."""
    zeros_rad: Annotated[tuple[Turn, ...], AS_LIST] = ()
    """Reported angle less true, one per controlled joint; empty: no error."""
    masses: Times = 1.0
    """Times the masses of its links."""
    link_masses: Annotated[tuple[Times, ...], AS_LIST] = ()
    """Times that again, of what each controlled joint carries up to the next; empty: alike."""
    friction: Friction = 1.0
    """Times the friction of its joints, as its file has it."""
    joint_friction: Annotated[tuple[Friction, ...], AS_LIST] = ()
    """Times that again, one per controlled joint; empty: alike."""
    breakaway_Nm: Annotated[tuple[Rub, ...], AS_LIST] = ()
    """Above Coulomb friction at rest, in the place of the arm file's, one per controlled joint; empty: as there."""
    stribeck_rad_per_s: Annotated[float, Field(ge=1e-3, le=100.0)] | None = None
    """Speed over which breakaway falls off, this or the arm file's; none: 1 of this, as there of the arm file's."""
    load_friction: Annotated[tuple[LoadPart, ...], AS_LIST] = ()
    """Per N·m of the motor, in the place of the arm file's, one per controlled joint; empty: as there."""
    torque_constant: Annotated[tuple[Times, ...], AS_LIST] = ()
    """True over believed, one per controlled joint; empty: no error."""
    backlash_rad: Annotated[tuple[Gap, ...], AS_LIST] = ()
    """Of its gears, from one end of the gap to the other, one per controlled joint; empty: none."""
    pads_N_per_m: LinearStiffness | None = None
    """Stiffness of its own finger pads; none: as the other arms'."""
    pads_Nm_per_rad: AngularStiffness | None = None
    """The same in rotation."""
    skew_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """By which its clock, and so its trajectory, is ahead."""


class Reality(Strict):
    """Errors of the cell: each as given, the others drawn from `seed` within the cell's [tolerance], or none."""

    seed: Seed | None = None
    """Errors that are not given are drawn from it within [tolerance]; none: as believed."""
    object: Times = 1.0
    """Times the object's mass and inertia."""
    object_centre_m: Offsets = NOTHING
    """True centre of mass less the object's frame, object axes."""
    pads_N_per_m: LinearStiffness | None = None
    """Stiffness of finger pads; none: [simulation.grasp], without which it goes with the other stiffness."""
    pads_Nm_per_rad: AngularStiffness | None = None
    """The same in rotation."""
    pads_damping_ratio: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    """Of an arm that swings on its pad."""
    delay_s: Seconds | None = None
    """Loop delay of the plant; none: as believed."""
    delay_jitter_s: Seconds = 0.0
    """By which it differs from tick to tick; at most the delay, and below half a period."""
    arms: dict[Name, ArmReality] = Field(default_factory=dict)
    """Errors of single arms, by name."""

    def require_pads(self, *, welded: bool) -> None:
        """Refuse half of what makes a weld a pad; welded: without [simulation.grasp].  Raises PydanticCustomError."""
        keys = (*STIFFNESSES, "pads_damping_ratio")
        given = [key for key in keys if getattr(self, key) is not None]
        lacking = [key for key in STIFFNESSES if key not in given]
        if not (welded and self.seed is None and lacking):
            return
        if given:
            raise wrong(
                f"simulation.reality.{given[0]}", found=f"{' and '.join(given)} without {' and '.join(lacking)}",
                expected="both stiffnesses where the cell's grasps are welded",
                remedy=f"give {' and '.join(lacking)} as well, or add [simulation.grasp], or leave all of these out",
            )  # fmt: skip
        own = [f"arms.{name}.{key}" for name, arm in self.arms.items() for key in STIFFNESSES if getattr(arm, key)]
        if own:
            raise wrong(
                f"simulation.reality.{own[0]}", found="grasps that are welded",
                expected="pads of the cell, of which this arm has others",
                remedy=f"give simulation.reality.{' and '.join(STIFFNESSES)} as well, or add [simulation.grasp]",
            )  # fmt: skip

    def require_delay(self, believed_s: float, tolerance: Tolerance, rate_hz: float) -> None:
        """Refuse a jitter larger than the delay, or with which torques overtake each other.

        believed_s: delay of the simulated cell where this says nothing.  Raises PydanticCustomError.
        """
        key, jitter_s = "simulation.reality.delay_jitter_s", self.delay_jitter_s
        refuse_overtaking(key, jitter_s, rate_hz)
        delay_s, which = believed_s, "that the cell is simulated with"
        if self.delay_s is not None:
            delay_s, which = self.delay_s, "of simulation.reality.delay_s"
        elif self.seed is not None:
            delay_s, which = believed_s * tolerance.delay[0], "the shortest that tolerance.delay lets the seed draw"
        if jitter_s > delay_s:
            raise wrong(
                key, found=f"{jitter_s:g} s", expected=f"at most the delay, {delay_s:g} s, {which}",
                remedy="lower it, or give a longer simulation.reality.delay_s",
            )  # fmt: skip

    def require_rubbing(self) -> None:
        """Refuse friction of joints that do not rub.  Raises PydanticCustomError."""
        for name, arm in self.arms.items():
            rubs = {
                "friction": arm.friction != 1.0,
                "joint_friction": any(times != 1.0 for times in arm.joint_friction),
                "breakaway_Nm": any(arm.breakaway_Nm),
                "stribeck_rad_per_s": arm.stribeck_rad_per_s is not None,
                "load_friction": any(arm.load_friction),
            }
            for key, found in rubs.items():
                if found:
                    raise wrong(
                        f"simulation.reality.arms.{name}.{key}", found="simulation.effects.friction = false",
                        expected="joints that rub", remedy="switch that on, or leave this out",
                    )  # fmt: skip

    def require_fit(self, joints: Mapping[str, int]) -> None:
        """Refuse arms and joints that are not there; joints: their number by arm.  Raises PydanticCustomError."""
        for name, arm in self.arms.items():
            where = f"simulation.reality.arms.{name}"
            if name not in joints:
                raise wrong(where, found=name, expected=" or ".join(joints), remedy="name an arm of the cell")
            for key in (key for key, field in ArmReality.model_fields.items() if field.default == ()):
                values = getattr(arm, key)
                if values and len(values) != joints[name]:
                    raise wrong(
                        f"{where}.{key}",
                        found=f"{len(values)} values",
                        expected=f"one per controlled joint, {joints[name]}",
                        remedy="give as many, or leave it out",
                    )
