"""What a simulated cell is made of: frozen, checked data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Final

import numpy as np
import pinocchio as pin

from drivers.interface import Refusal, Vector
from drivers.pads import DAMPING_RATIO
from drivers.substeps import BAUMGARTE_D_PER_S, LONGEST_S, MAX_BAUMGARTE_STEP, damps
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.calendar import Happening, Push
from sim_backend.physics.friction import FrictionSpec

QUATERNION_TOLERANCE: Final = 1e-9
WHOLE_SUBSTEPS_TOLERANCE: Final = 1e-9


class PlantError(Refusal):
    """The simulated cell cannot be built as described, or cannot go on."""

    exit_code = 4


def diverged(what: str, t_s: float) -> PlantError:
    """Of a motion that is no longer finite at this time of the plant."""
    return PlantError(
        what,
        found=f"no finite number at t = {t_s:.4f} s",
        expected="finite velocities",
        remedy="the control loop is unstable or substep_s is too long",
    )


class GraspError(PlantError):
    """An arm's start pose does not put its end effector on its grasp."""

    def __init__(self, arm: str, gap_m: float, gap_rad: float, *, tolerance_m: float, tolerance_rad: float) -> None:
        self.arm = arm
        self.gap_m = gap_m
        self.gap_rad = gap_rad
        super().__init__(
            f"arm {arm}: the end effector is not on its grasp at the start pose",
            found=f"{gap_m * 1e3:.4g} mm and {gap_rad * 1e3:.4g} mrad apart",
            expected=f"at most {tolerance_m * 1e3:.4g} mm and {tolerance_rad * 1e3:.4g} mrad",
            remedy="correct q_start, T_world_base, T_object_ee or the object's pose (solve_grasp finds q_start)",
        )


def read_only(values: Sequence[float] | Vector) -> Vector:
    """Copy as a float64 array that nobody can write to; frozen objects hold no other kind."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def pose(p: Sequence[float] | Vector, quat_wxyz: Sequence[float] | Vector) -> pin.SE3:
    """Transform from a position (3,) m and a unit quaternion, scalar first.  Raises PlantError if it is not unit."""
    w, x, y, z = (float(c) for c in quat_wxyz)
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        raise PlantError("quaternion", found=f"norm {norm:.12g}", expected="1", remedy="normalise it in the cell file")
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(p, dtype=np.float64))


def substep_of(period_s: float) -> float:
    """Longest substep, not above a millisecond, of which a control period holds a whole number."""
    return period_s / math.ceil(period_s / 1e-3 - WHOLE_SUBSTEPS_TOLERANCE)


@dataclass(frozen=True, eq=False)
class ArmSpec:
    """One arm as the plant believes it to be; its wrong beliefs are the model error under test.

    `T_object_ee` is the grasp: the pose of the end-effector frame in the object's frame.
    Joints of the URDF that are not controlled are locked at `locked_rad` and must all be named there.
    """

    name: str
    urdf_xml: str
    controlled: tuple[str, ...]
    locked_rad: Mapping[str, float]
    T_world_base: pin.SE3
    ee_frame: str
    T_object_ee: pin.SE3
    q_start: Vector  # (n,) rad, controlled joints
    rotor_inertia: Vector  # (n,) kg·m², reflected to the joint
    actuator: ActuatorSpec
    friction: FrictionSpec | None = None  # with presliding, in place of the actuator's smooth friction
    # (n,), or one of all, of what each joint carries up to the next: times what the URDF says
    masses: Vector = field(default_factory=lambda: np.ones(1))
    pads: tuple[float | None, float | None] = (None, None)  # N/m, N·m/rad of its grasp; None: as the cell's
    skew_s: float = 0.0  # by which this arm's clock is ahead of the plant's

    def __post_init__(self) -> None:
        n = len(self.controlled)
        for key in ("q_start", "rotor_inertia"):
            values = read_only(getattr(self, key))
            if values.shape != (n,) or not np.all(np.isfinite(values)):
                raise PlantError(
                    f"arm {self.name}: {key}",
                    found=values.tolist(),
                    expected=f"{n} finite numbers, one per controlled joint",
                    remedy="give one value per name in `controlled`",
                )
            object.__setattr__(self, key, values)
        if np.any(self.rotor_inertia < 0):
            raise PlantError(
                f"arm {self.name}: rotor_inertia",
                found=self.rotor_inertia.tolist(),
                expected="no negative value",
                remedy="use 0 for a joint without reflected inertia",
            )
        if self.actuator.joint_count != n:
            raise PlantError(
                f"arm {self.name}: actuator",
                found=f"{self.actuator.joint_count} joints",
                expected=f"{n}",
                remedy="describe the servos of exactly the controlled joints",
            )
        if self.friction is not None and self.friction.coulomb_Nm.shape != (n,):
            raise PlantError(
                f"arm {self.name}: friction",
                found=f"{len(self.friction.coulomb_Nm)} joints",
                expected=f"{n}",
                remedy="describe the friction of exactly the controlled joints",
            )
        object.__setattr__(self, "masses", read_only(np.broadcast_to(self.masses, n)))
        if not (np.all(np.isfinite(self.masses) & (self.masses > 0.0)) and math.isfinite(self.skew_s)):
            raise PlantError(
                f"arm {self.name}: masses, skew_s",
                found=f"{self.masses.tolist()}, {self.skew_s:g}",
                expected="positive factors and a finite time",
                remedy="correct the arm's reality",
            )
        if not all(k is None or (math.isfinite(k) and k > 0.0) for k in self.pads):
            raise PlantError(
                f"arm {self.name}: pads", found=self.pads, expected="finite positive stiffnesses",
                remedy="correct the arm's reality",
            )  # fmt: skip
        object.__setattr__(self, "locked_rad", MappingProxyType(dict(self.locked_rad)))


@dataclass(frozen=True, eq=False)
class ObjectSpec:
    """The grasped rigid body."""

    mass_kg: float
    inertia: Vector  # (3, 3) kg·m² about the centre of mass, object axes
    p_world: Vector  # (3,) m, of its frame
    quat_world: Vector  # (4,) scalar first
    centre_m: Vector = field(default_factory=lambda: np.zeros(3))  # (3,) m, centre of mass in its frame

    def __post_init__(self) -> None:
        for key in ("inertia", "p_world", "quat_world", "centre_m"):
            object.__setattr__(self, key, read_only(getattr(self, key)))
        principal = np.linalg.eigvalsh(self.inertia) if self.inertia.shape == (3, 3) else np.array([-1.0])
        if not (self.mass_kg > 0 and np.allclose(self.inertia, self.inertia.T) and principal.min() > 0):
            raise PlantError(
                "object",
                found=f"mass {self.mass_kg} kg, inertia {self.inertia.tolist()}",
                expected="mass > 0 and a symmetric positive definite inertia (3, 3)",
                remedy="correct the object of the cell",
            )

    @property
    def T_world_object(self) -> pin.SE3:
        """Start pose.  Raises PlantError when the quaternion is not unit."""
        return pose(self.p_world, self.quat_world)


@dataclass(frozen=True)
class GraspSpec:
    """Finger pads: springs and dampers between end effector and object, for every arm that has none of its own.

    With `slip_N` or `slip_Nm` a spring gives way at that force or moment, and the grasp opens for good once it has
    slipped by `open_m`.
    """

    stiffness_N_per_m: float
    stiffness_Nm_per_rad: float
    damping_ratio: float = DAMPING_RATIO  # of the arm that swings on its pad
    slip_N: float | None = None
    slip_Nm: float | None = None
    open_m: float | None = None

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            least = 0.0 if f.name == "damping_ratio" else math.ulp(0.0)
            if value is not None and not (math.isfinite(value) and value >= least):
                raise PlantError(
                    f"grasp: {f.name}", found=value, expected="a finite positive number", remedy="correct the pads"
                )
        if self.open_m is not None and self.slip_N is None:
            raise PlantError(
                "grasp: open_m", found="no slip_N", expected="the force at which pads slip", remedy="give slip_N"
            )


@dataclass(frozen=True, eq=False)
class PlantSpec:
    """The whole cell and how it is integrated.

    `substep_s` of 1 ms and the two Baumgarte gains are what the figures in plant.py were measured with.
    """

    arms: tuple[ArmSpec, ...]
    object: ObjectSpec
    gravity: Vector  # (3,) m/s², world axes
    substep_s: float = 1e-3
    baumgarte_p_per_s2: float = 2000.0  # pulls a grasp that has drifted back to zero …
    baumgarte_d_per_s: float = BAUMGARTE_D_PER_S  # … critically damped: 2 √2000 = 89.4
    proximal_mu: float = 1e-3  # a smaller one lets rounding grow in the wrenches that planar arms leave undetermined
    proximal_accuracy: float = 1e-10
    proximal_iterations: int = 20
    start_tolerance_m: float = 1e-5
    start_tolerance_rad: float = 1e-4
    grasp: GraspSpec | None = None  # None: welded
    relinearise_s: float = 1e-2  # how long soft.py may go on with one linearisation
    happenings: tuple[Happening, ...] = ()
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "gravity", read_only(self.gravity))
        object.__setattr__(self, "names", tuple(arm.name for arm in self.arms))
        if self.gravity.shape != (3,) or not np.all(np.isfinite(self.gravity)):
            raise PlantError(
                "gravity",
                found=self.gravity.tolist(),
                expected="3 finite numbers, m/s²",
                remedy="correct the world of the cell",
            )
        if not 0 < self.substep_s <= LONGEST_S:
            raise PlantError(
                "substep_s",
                found=self.substep_s,
                expected=f"0 < substep_s <= {LONGEST_S:g}",
                remedy="use substep_of(1 / rate)",
            )
        if not damps(self.substep_s, self.baumgarte_d_per_s):
            raise PlantError(
                "baumgarte_d_per_s",
                found=f"{self.baumgarte_d_per_s:g} with substep_s {self.substep_s:g}",
                expected=f"a product of at most {MAX_BAUMGARTE_STEP}, above which the correction itself oscillates",
                remedy="shorten substep_s",
            )
        if len(set(self.names)) != len(self.names):
            raise PlantError("arms", found=self.names, expected="different names", remedy="rename one of the arms")
        struck = [one for one in self.happenings if not isinstance(one, Push) and one.arm not in self.names]
        if struck:
            what = type(struck[0]).__name__.lower()
            raise PlantError(what, found=f"arm {struck[0].arm}", expected=" or ".join(self.names), remedy="name an arm")
