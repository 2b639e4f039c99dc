"""One emulated arm: servos on a bus, mounted on joints; servos that share a joint add their torques.

Packets, ports and clocks are outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.dynamixel.servo.counts import TICK_CENTRE, TICK_RAD
from drivers.dynamixel.servo.models import SERVOS
from sim_backend.wire.bus import DEFAULTS, Bus
from sim_backend.wire.finger import FingerJoint
from sim_backend.wire.options import BusOptions, ServoOptions
from sim_backend.wire.servo import FACTORY, Servo
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring
from sim_backend.wire.world import FreeJoint

SUPERVISE_S = 0.005  # how often servos look at their own heat and supply


@dataclass(slots=True)
class Mount:
    """One servo on one joint: horn angle = sign * (q + offset)."""

    servo: Servo
    sign: float
    offset_rad: float


@dataclass(slots=True)
class MountedJoint:
    """One joint with its servos; `free` moves it when no plant does."""

    name: str
    mounts: list[Mount]
    index: int | None
    free: FreeJoint | None


class EmulatedArm:
    """Servos of one arm and where they sit.  Joints without a plant are simulated here, each by itself."""

    def __init__(
        self,
        wiring: ArmWiring,
        *,
        timing: BusTiming | None = None,
        servo_options: ServoOptions = FACTORY,
        bus_options: BusOptions = DEFAULTS,
    ) -> None:
        self.name = wiring.name
        self.plant_arm = wiring.plant_arm
        self.joints: list[MountedJoint] = []
        servos: list[Servo] = []
        for joint in wiring.joints:
            mounts = []
            for wired in joint.servos:
                servo = Servo(
                    SERVOS[wired.model],
                    wired.servo_id,
                    firmware=wired.firmware,
                    eeprom=wired.eeprom,
                    options=servo_options,
                )
                offset_rad = (wired.zero_tick - TICK_CENTRE) * TICK_RAD
                mounts.append(Mount(servo, -1.0 if wired.reversed_mount else 1.0, offset_rad))
                servos.append(servo)
            free = None
            if joint.index is None or wiring.plant_arm is None:
                start = joint.start_rad, 0.0, joint.inertia_kg_m2, joint.coulomb_Nm, joint.viscous_Nm_s_per_rad
                free = FreeJoint(*start) if joint.fingers is None else FingerJoint(*start, fingers=joint.fingers)
            self.joints.append(MountedJoint(joint.name, mounts, joint.index, free))
        self._moved = [  # what `sense` needs of each joint, which is asked a thousand times a second
            (
                -1 if joint.index is None else joint.index,
                joint.free,
                [(m, m.servo.firmware.body.horn) for m in joint.mounts],
            )
            for joint in self.joints
        ]
        self.bus = Bus(servos, timing, bus_options)
        self._since_supervised_s = 0.0
        self._count = 1 + max((j.index for j in self.joints if j.index is not None and j.free is None), default=-1)

    @property
    def gripper(self) -> FingerJoint | None:
        """The joint of its gripper, where that is described."""
        return next((j.free for j in self.joints if isinstance(j.free, FingerJoint)), None)

    def servo(self, servo_id: int) -> Servo:
        """The servo with this ID now.  Raises KeyError."""
        for servo in self.bus.servos:
            if servo.id == servo_id:
                return servo
        raise KeyError(servo_id)

    def power_up(self, q_rad: Sequence[float]) -> None:
        """Start all servos where the joints are: plant's joints at q_rad, the others where they stand."""
        self.sense(q_rad, [0.0] * len(q_rad), 0.0)
        for servo in self.bus.servos:
            servo.firmware.start(0, 0)

    def sense(self, q_rad: Sequence[float], dq_rad_per_s: Sequence[float], lead_s: float) -> None:
        """Turn the horns to joints that are at q_rad and have moved on for `lead_s` since."""
        for index, free, mounts in self._moved:
            if free is not None:
                q, dq = free.q_rad, free.dq_rad_per_s
            else:
                q, dq = q_rad[index], dq_rad_per_s[index]
            q += dq * lead_s
            for mount, horn in mounts:
                sign = mount.sign
                horn.position_rad = sign * (q + mount.offset_rad)
                horn.velocity_rad_per_s = sign * dq

    def actuate(self, dt_s: float, now_ns: int) -> list[float]:
        """Run all servos for `dt_s`; return the torques of the plant's joints, N*m."""
        torques = [0.0] * self._count
        self._since_supervised_s += dt_s
        since_s = self._since_supervised_s
        supervising = since_s >= SUPERVISE_S
        if supervising:
            self._since_supervised_s = 0.0
        for joint in self.joints:
            tau_Nm = 0.0
            for mount in joint.mounts:
                firmware = mount.servo.firmware
                alive = firmware.alive(now_ns)
                tau_Nm += mount.sign * firmware.body.step(dt_s, alive=alive)
                if supervising and alive:
                    firmware.supervise(since_s)
            if joint.free is not None:
                joint.free.step(tau_Nm, dt_s)
            else:
                assert joint.index is not None
                torques[joint.index] += tau_Nm
        return torques
