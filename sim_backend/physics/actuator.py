"""What a servo adds between commanded and applied torque, and between true and reported motion.

Pure arithmetic; a torque that is not finite is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from drivers.interface import DriverError, Refusal, Vector

COULOMB_SPEED_RAD_S: Final = 0.01
FINEST_LSB: Final = 2.0**-60  # stands for "no grid": below the spacing of doubles above 0.004
NO_LSB: Final = 2.0**-900  # the same for a whole row: below the spacing of doubles above 1e-255

Numbers = float | Sequence[float] | Vector


class ActuatorError(Refusal):
    """The description of a servo cannot be right."""

    exit_code = 4


class TorqueCommandError(DriverError):
    """A torque command is not one finite number per joint; nothing was sent."""


@dataclass(frozen=True, eq=False)
class ActuatorSpec:
    """The servos of one arm; arrays are (n,), one entry per controlled joint.  Build it with `of`."""

    delay_s: float  # from the sample that a command answers to its torque, in the mean
    delay_jitter_s: float  # by which it differs from command to command, at most
    tau_max_Nm: Vector  # largest command; the driver clips to it
    torque_lsb_Nm: Vector  # resolution of the command; 0: exact
    torque_scale: Vector  # true over believed torque constant
    stall_Nm: Vector  # what the motor can give at rest …
    no_load_rad_s: Vector  # … falling to nothing at this speed (back-EMF)
    coulomb_Nm: Vector
    viscous_Nms_rad: Vector
    coulomb_speed_rad_s: Vector  # speed at which 71 % of the Coulomb torque is there
    position_lsb_rad: float  # 0: exact
    velocity_lsb_rad_s: float  # 0: exact
    zero_error_rad: Vector  # reported less true angle
    backlash_rad: Vector  # between motor and joint, from one end of the gap to the other

    @classmethod
    def of(
        cls,
        joint_count: int,
        *,
        delay_s: float = 0.0,
        delay_jitter_s: float = 0.0,
        tau_max_Nm: Numbers = math.inf,
        torque_lsb_Nm: Numbers = 0.0,
        torque_scale: Numbers = 1.0,
        stall_Nm: Numbers = math.inf,
        no_load_rad_s: Numbers = math.inf,
        coulomb_Nm: Numbers = 0.0,
        viscous_Nms_rad: Numbers = 0.0,
        coulomb_speed_rad_s: Numbers = COULOMB_SPEED_RAD_S,
        position_lsb_rad: float = 0.0,
        velocity_lsb_rad_s: float = 0.0,
        zero_error_rad: Numbers = 0.0,
        backlash_rad: Numbers = 0.0,
    ) -> ActuatorSpec:
        """Servos with the named effects; every default switches its effect off.  A scalar holds for all joints.

        Raises ActuatorError.
        """

        def spread(numbers: Numbers) -> Vector:
            return np.array(np.broadcast_to(np.asarray(numbers, dtype=np.float64), (joint_count,)))

        return cls(
            delay_s=delay_s,
            delay_jitter_s=delay_jitter_s,
            tau_max_Nm=spread(tau_max_Nm),
            torque_lsb_Nm=spread(torque_lsb_Nm),
            torque_scale=spread(torque_scale),
            stall_Nm=spread(stall_Nm),
            no_load_rad_s=spread(no_load_rad_s),
            coulomb_Nm=spread(coulomb_Nm),
            viscous_Nms_rad=spread(viscous_Nms_rad),
            coulomb_speed_rad_s=spread(coulomb_speed_rad_s),
            position_lsb_rad=position_lsb_rad,
            velocity_lsb_rad_s=velocity_lsb_rad_s,
            zero_error_rad=spread(zero_error_rad),
            backlash_rad=spread(backlash_rad),
        )

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = value.astype(np.float64)
                value.flags.writeable = False
                object.__setattr__(self, f.name, value)
            if f.name != "zero_error_rad":
                self._require(f.name, value, bool(np.all(np.asarray(value) >= 0)), "no negative number")
        for key in ("tau_max_Nm", "torque_scale", "stall_Nm", "no_load_rad_s", "coulomb_speed_rad_s"):
            value = getattr(self, key)
            self._require(key, value, bool(np.all(value > 0)), "positive numbers")
        self._require("delay_s", self.delay_s, math.isfinite(self.delay_s), "a finite time")
        jitter = self.delay_jitter_s
        self._require("delay_jitter_s", jitter, jitter <= self.delay_s, "at most the delay")
        gap = self.backlash_rad
        self._require("backlash_rad", gap, bool(np.all(np.isfinite(gap))), "finite angles")
        zero = self.zero_error_rad
        self._require("zero_error_rad", zero, bool(np.all(np.isfinite(zero))), "finite angles")
        curve = np.isfinite(self.stall_Nm) | ~np.isfinite(self.no_load_rad_s)
        self._require("stall_Nm", self.stall_Nm, bool(np.all(curve)), "a finite stall torque with a no-load speed")

    @staticmethod
    def _require(key: str, value: object, ok: bool, expected: str) -> None:
        if not ok:
            raise ActuatorError(key, found=value, expected=expected, remedy="correct the description of the servos")

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return len(self.tau_max_Nm)

    @property
    def tau_largest_Nm(self) -> Vector:
        """Largest command (n,) that is ever sent: the limit, rounded down to what the servo can express."""
        lsb = np.maximum(self.torque_lsb_Nm, FINEST_LSB)
        largest: Vector = np.floor(self.tau_max_Nm / lsb) * lsb
        return largest


class Grid:
    """Rounds values (k,), or rows (m, k), to whole multiples of their resolution; 0 leaves a value as it is."""

    def __init__(self, lsb: Vector) -> None:
        finest = np.where(lsb.any(axis=-1, keepdims=True), FINEST_LSB, NO_LSB)
        self._lsb = np.maximum(lsb, finest) if np.any(lsb) else None

    def __call__(self, values: Vector) -> Vector:
        """Return a new array of the same shape."""
        if self._lsb is None:
            return values.copy()
        counted = np.divide(values, self._lsb)
        np.rint(counted, counted)
        return np.multiply(counted, self._lsb, counted)


class TorqueCommand:
    """How a wish becomes a command: finite, bounded, on the servo's grid.  Driver and plant both use this one."""

    def __init__(self, tau_largest_Nm: Vector, torque_lsb_Nm: Vector) -> None:
        self._largest = np.array(tau_largest_Nm)
        self._lowest = -self._largest
        self._grid = Grid(torque_lsb_Nm)

    @classmethod
    def of(cls, spec: ActuatorSpec) -> TorqueCommand:
        """Build from the description of the servos."""
        return cls(spec.tau_largest_Nm, spec.torque_lsb_Nm)

    def __call__(self, tau_Nm: Vector) -> Vector:
        """Torques (n,) that the servos will be told.  Raises TorqueCommandError on NaN, infinity or a wrong length."""
        # A clip lets NaN through, so finiteness comes first.
        if tau_Nm.shape != self._largest.shape or not all(map(math.isfinite, tau_Nm.tolist())):
            raise TorqueCommandError(
                "torque command",
                found=tau_Nm.tolist(),
                expected=f"{len(self._largest)} finite numbers, N·m",
                remedy="find the first term of the control law that is not finite",
            )
        sent = self._grid(tau_Nm)
        np.minimum(sent, self._largest, out=sent)
        return np.maximum(sent, self._lowest, out=sent)


class Servos:
    """The servos of all arms side by side, (J,) = all controlled joints, arm after arm.

    Called in every substep, so it keeps its own buffers: a returned array is valid until the next call.
    """

    def __init__(self, specs: Sequence[ActuatorSpec]) -> None:
        def join(key: str) -> Vector:
            rows = [np.broadcast_to(getattr(s, key), (s.joint_count,)) for s in specs]
            return np.concatenate(rows) if rows else np.zeros(0)

        self._scale = join("torque_scale")
        self._stall = join("stall_Nm")
        self._slope = np.where(np.isfinite(self._stall), self._stall, 0.0) / join("no_load_rad_s")
        self._limited = bool(np.any(np.isfinite(self._stall)))
        self._coulomb = join("coulomb_Nm")
        self._viscous = join("viscous_Nms_rad")
        self._coulomb_speed = join("coulomb_speed_rad_s")
        self.has_friction = bool(np.any(self._coulomb) or np.any(self._viscous))
        self._zero_error = join("zero_error_rad")
        self._reported = Grid(np.stack([join("position_lsb_rad"), join("velocity_lsb_rad_s"), join("torque_lsb_Nm")]))
        self._zeros, self._low, self._high, self._signed_stall, self._motor, self._friction = np.zeros(
            (6, len(self._scale))
        )

    def command(self, tau_Nm: Vector) -> None:
        """Set the commands (J,) that hold from now on."""
        np.multiply(tau_Nm, self._scale, self._motor)
        if self._limited:
            np.minimum(self._motor, self._zeros, out=self._low)
            np.maximum(self._motor, self._zeros, out=self._high)
            np.copysign(self._stall, self._motor, self._signed_stall)

    def motor_torque(self, dq: Vector) -> Vector:
        """Torque (J,) of the motors at speeds dq: |τ| ≤ max(0, τ_stall (1 − sign(τ) dq / dq_no_load))."""
        motor = self._motor
        if self._limited:  # between zero and the command, on the line sign(τ) τ_stall − τ_stall dq / dq_no_load
            np.multiply(self._slope, dq, motor)
            np.subtract(self._signed_stall, motor, motor)
            np.maximum(motor, self._low, out=motor)
            np.minimum(motor, self._high, out=motor)
        return motor

    def friction_coefficient(self, dq: Vector) -> Vector:
        """D (J,) ≥ 0 with friction torque −D(dq) dq, D = F_c / √(dq² + dq_s²) + F_v.

        The smooth sign is dq / √(dq² + dq_s²).  Written as a coefficient it can be integrated implicitly,
        which keeps it dissipative at any step, inertia and speed scale (see plant.py).
        """
        out = self._friction
        np.hypot(dq, self._coulomb_speed, out)
        np.divide(self._coulomb, out, out)
        return np.add(out, self._viscous, out)

    def set_viscous(self, joints: slice, viscous_Nms_rad: float | Vector) -> None:
        """Change the viscous friction of some joints (a seized gear)."""
        self._viscous[joints] = viscous_Nms_rad
        self.has_friction = bool(np.any(self._coulomb) or np.any(self._viscous))

    def reported(self, q: Vector, dq: Vector, tau_motor_Nm: Vector) -> Vector:
        """What the servos say of true angles, velocities and torques, (J,) each: a new array (3, J).

        Angles are counted from where the encoders believe zero to be; torques are estimated from current, with the
        believed torque constant and not the true one.
        """
        said = np.empty((3, len(self._scale)))
        np.add(q, self._zero_error, said[0])
        said[1] = dq
        np.divide(tau_motor_Nm, self._scale, said[2])
        return self._reported(said)
