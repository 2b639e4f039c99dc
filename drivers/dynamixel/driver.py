"""The driver of one arm of Dynamixel servos: N·m and radians on one side, packets on the other.

It never gives an old value as new, never commands a shadow servo, and never switches torque on but in `enable`.
"""

from __future__ import annotations

import contextlib
import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.bringup import BringUp, torque_off
from drivers.dynamixel.budget import LinkTiming
from drivers.dynamixel.connected import all_fast, arm_info, opened
from drivers.dynamixel.errors import (
    DxlServoFault,
    NotEnabledError,
    PortLostError,
    RearmError,
    TorqueError,
    WriteTimeoutError,
)
from drivers.dynamixel.events import DriverEvent, EventKind, EventSink, ignore
from drivers.dynamixel.grip import no_gripper
from drivers.dynamixel.identify import IdentityError, identify
from drivers.dynamixel.line.bus import Bus, DxlCounters
from drivers.dynamixel.line.port import Port, SerialPort
from drivers.dynamixel.pace import SHARE, check_latency_timer, check_rate, check_read
from drivers.dynamixel.recovery import limp, make_sure, only_tripped, open_again, without_trips
from drivers.dynamixel.running import Running
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.stale import stale, unasked
from drivers.interface import ArmInfo, Clock, DriverError, GripState, JointState, ServoHealth, Vector

RECOVERY_S = 0.25  # of bringing an arm back, after which nothing is asked twice: it ends within 0.6 s


class Phase(enum.Enum):
    """What the driver may be asked."""

    CLOSED = "no connection"
    CONNECTED = "a connection"  # may be read
    ENABLED = "torque on"  # may be commanded


@dataclass(slots=True)
class CycleTimes:
    """Where the last cycle's time went, ns."""

    exchange: int = 0  # request sent, answer waited for and parsed
    interpret: int = 0
    write: int = 0


class DynamixelDriver:
    """`drivers.interface.Driver` on a serial bus.

    port: None for the serial port that the map names.  scan_s: how long `connect` waits for servos not in the map.
    read_share: part of the period that the read may take; a slower bus is refused.
    problems: everything `connect` found wrong, the first of which it raised.
    faults: servo faults since `enable`; while there is one, `read` raises it.
    """

    def __init__(
        self,
        arm: ArmMap,
        clock: Clock,
        *,
        on_event: EventSink = ignore,
        link: LinkTiming | None = None,
        scan_s: float = 0.8,
        port: Port | None = None,
        read_share: float = SHARE,
    ) -> None:
        self.arm = arm
        self.counters = DxlCounters()
        self.times = CycleTimes()
        self.problems: list[IdentityError] = []
        self.faults: list[DxlServoFault] = []
        self._clock = clock
        self._on_event = on_event
        self._link = link or LinkTiming()
        self._scan_s = scan_s
        self._read_share = read_share
        self._phase = Phase.CLOSED
        self._port_lost = False
        self._has_commanded = False
        self._port = port or SerialPort(arm.port, arm.baud, clock)
        self._bus = Bus(self._port, clock, self.counters)
        self._found: list[ServoFound] = []
        self._running: Running | None = None
        self._begin_ns = 0
        self._joint_count = len(arm.controlled)

    # --- coming and going -----------------------------------------------------------------------------------------

    def connect(self) -> ArmInfo:
        """Open the bus and check that this is the arm of the map; torque, modes and goals stay as they are.

        Raises PortError, IdentityError, PaceError (all ConnectError).  The port is closed again when it raises.
        """
        self.close()
        with contextlib.ExitStack() as undo, opened(self._port, self.arm.baud):
            undo.callback(self.close)
            info = self._connect()
            undo.pop_all()
        return info

    def _connect(self) -> ArmInfo:
        check_latency_timer(self._port, self.arm)
        self._found, self.problems = identify(self._bus, self.arm, self._scan_s)
        if self.problems:
            raise self.problems[0]
        fast = all_fast(self._found, self._on_event)
        check_rate(self.arm, fast=fast, link=self._link)
        times = None
        if not any(change for servo in self._found for change in servo.changes):  # else after they are made
            times = check_read(self._bus, self.arm, self._clock, fast=fast, link=self._link, share=self._read_share)
        self._running = Running(self._bus, self.arm, self._found, self._clock, self._on_event, self._link, fast=fast)
        self._phase = Phase.CONNECTED
        return arm_info(self.arm, self._found, fast, times)

    def enable(self) -> None:
        """Configure, zero the goals, check the pose, arm the watchdog, torque on; in this order.

        The watchdog runs from here on: a gap of `watchdog_s` without `read` or `write` stops the servos.
        Raises IdentityError (torque is on, and stays; wrong pose), PaceError, DxlServoFault; otherwise it is off then.
        """
        running = self._need(Phase.CONNECTED)
        if self._phase is Phase.ENABLED:
            return
        self.faults.clear()
        steps = BringUp(self._bus, self.arm, self._found, self._on_event)
        steps.configure()
        self._has_commanded = True
        steps.zero_goals()
        check_read(self._bus, self.arm, self._clock, fast=running.fast, link=self._link, share=self._read_share)
        steps.check_pose()
        steps.torque_on()
        self._running = running.again()
        self._phase = Phase.ENABLED

    def disable(self) -> None:
        """Torque off, where this driver switched it on.  Safe in any state, twice, and on a dead bus."""
        if self._has_commanded:
            with contextlib.suppress(DriverError):  # a dead bus, or closed port, has no torque to switch off from here
                torque_off(self._bus, self.arm)
        if self._phase is Phase.ENABLED:
            self._phase = Phase.CONNECTED

    def close(self) -> None:
        """Give the port back; torque stays as it is until the servos' watchdog fires.  Safe in any state and twice."""
        self._port.close()
        self._phase = Phase.CLOSED
        self._port_lost = False
        self._running = None

    def reopen(self) -> None:
        """After PortLostError: open the port again and make sure it is the same arm, without writing to it.

        Raises PortError, IdentityError.  Torque is as the servos have kept it; the next reads tell.
        """
        open_again(self._port, self._need(Phase.CONNECTED))
        self._port_lost = False
        self._on_event(DriverEvent(EventKind.PORT_REOPENED, self.arm.port))

    def rearm(self) -> None:
        """After WATCHDOG_TRIPPED: zero effort and arm the watchdogs again, with torque on all the time.

        For a loop that stopped and goes on in HOLD; it must command torque at once, for the arm has none now.
        Raises NotEnabledError, DxlServoFault, NoReplyError.
        """
        running = self._need(Phase.ENABLED)
        running.monitor.half_armed = True
        self._bus.settle()
        BringUp(self._bus, self.arm, self._found, self._on_event).rearm()
        self._running = running.again()
        self.faults = without_trips(self.faults)

    @property
    def lapsed(self) -> bool:
        """True while the port is gone, or watchdogs have fired and no servo has lost its torque otherwise."""
        return self._port_lost or only_tripped(self.faults)

    def recover(self) -> bool:
        """`drivers.interface.Recovering.recover`.

        Raises DxlServoFault for an arm without torque, of which a servo has lost its own; where it may be tried again
        PortError, IdentityError, StaleStateError, NoReplyError, RearmError.  A bus on which a servo is silent costs one
        period, one that cuts a servo off in between a few tenths of a second.
        """
        running = self._need(Phase.ENABLED)
        with self._bus.patient(RECOVERY_S):
            self.reopen() if self._port_lost else make_sure(running, self.arm, self._clock)
            arm = BringUp(self._bus, self.arm, self._found, self._on_event)
            if stopped := arm.has_stopped(half_armed=running.monitor.half_armed):
                try:
                    running.require_believed()  # one that is armed again believes the first angles that it reads
                    self.rearm()
                except DxlServoFault as fault:
                    raise RearmError.of(fault) from fault
                self._on_event(DriverEvent(EventKind.REARMED, "torque begins at zero"))
        running.forget_trips()
        self.faults = without_trips(self.faults)
        return stopped

    def _need(self, phase: Phase) -> Running:
        running = self._running
        if running is None or (phase is Phase.ENABLED and self._phase is not Phase.ENABLED):
            raise NotEnabledError(
                f"arm {self.arm.arm}",
                found=self._phase.value,
                expected=phase.value,
                remedy="call connect() and, for torque, enable() first",
            )
        return running

    @property
    def found(self) -> Sequence[ServoFound]:
        """The servos as `connect` read them."""
        return self._found

    # --- the cycle ------------------------------------------------------------------------------------------------

    def read(self) -> JointState:
        """Fresh state of the controlled joints.

        Raises:
            StaleJointsError: a controlled joint has no fresh value; `partial` has the others.
            DxlServoFault: a servo does not do its part; raised every cycle from then on, with the state in `state`, or
                without one once no servo of the arm has torque any more.
            PortLostError: the adapter is gone, a StaleStateError too; see `reopen`.

        """
        try:
            return self._read(self._need(Phase.CONNECTED))
        except PortLostError:
            self._port_lost = True
            raise

    def _read(self, running: Running) -> JointState:
        clock = self._clock
        begin_ns = self._begin_ns = clock.now_ns()
        running.hear_health()
        try:
            cycle = running.reader.read()
        except WriteTimeoutError as error:
            raise unasked(self.arm) from error
        answered_ns = clock.now_ns()
        self._port_lost = False
        reading = running.interpret(cycle, answered_ns)
        self.times.exchange = answered_ns - begin_ns
        if self._phase is Phase.ENABLED:
            self.faults = running.faults(reading, self.faults)
        self.counters.health_misses = running.monitor.misses
        self.times.interpret = clock.now_ns() - answered_ns
        if self.faults:
            raise limp(self.arm, self.faults) or self.faults[0].with_state(reading.state)
        if reading.stale:
            raise stale(self.arm, cycle, reading)
        return reading.state

    def write(self, tau_Nm: Vector) -> Vector:
        """Command joint torques (n,); returns those that the sent counts stand for.

        Raises TorqueError for a torque that is no number (nothing is sent then), NotEnabledError, PortLostError,
        WriteTimeoutError.
        """
        running = self._need(Phase.ENABLED)
        begin_ns = self._clock.now_ns()
        wanted = tau_Nm.tolist()
        if len(wanted) != self._joint_count or not all(map(math.isfinite, wanted)):
            raise TorqueError.of(self.arm.arm, wanted, self._joint_count)
        try:
            sent = running.write(wanted, self._begin_ns)
        except PortLostError:
            self._port_lost = True
            raise
        self.times.write = self._clock.now_ns() - begin_ns
        return np.array(sent)

    def grip(self, width_m: float) -> None:
        """Send the fingers to this width with the next `write`.  Raises NotEnabledError, NoGripperError."""
        control = self._need(Phase.ENABLED).grip
        if control is None:
            raise no_gripper(self.arm)
        control.go_to(width_m)

    def grip_state(self) -> GripState | None:
        """What the gripper said in the last cycle; never touches the bus."""
        return self._need(Phase.CONNECTED).grip_state(self._clock.now_ns())

    def health(self) -> ServoHealth:
        """Latest slow quantities of each servo, and its current or load of the last cycle; never touches the bus."""
        return self._need(Phase.CONNECTED).health(self._clock.now_ns())
