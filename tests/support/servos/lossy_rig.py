"""One arm with the real driver, loop and guard's steps on emulated servos, met by the loss of one packet of a phase.

`Witness` looks at the servos behind every write and every millisecond, past the bus.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

import configs
from agent.around import Beginning, Schedule, Surroundings
from agent.config.cell import Cell, load_cell
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line
from agent.guard.takeover import go_on
from agent.loop import Agent
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.process.emulate import wiring
from agent.process.schedule import schedule_of
from agent.process.simulated import lone_spec
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.arm_map import ArmMap, JointRole
from drivers.dynamixel.bringup import effort_register, efforts_at_rest
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED
from drivers.dynamixel.servo.torque import torque_drive
from drivers.dynamixel.standby import Handover, StandbyDriver
from sim_backend.wire.injector import Injector
from sim_backend.wire.lone_world import emulate_alone
from sim_backend.wire.servo import Servo
from sim_backend.wire.timing import BusTiming
from tests.support.runner_rig import Log
from tests.support.servos.dxl_rig import VirtualClock
from tests.support.servos.guarded_rig import HOST_NS
from tests.support.servos.lossy_line import Loss, LossyPort
from tests.support.starts import start_joints

MS = 1_000_000


class Over(BaseException):
    """The test has seen enough of this loop."""


@cache
def cell() -> Cell:
    """Arms with servos of current and of voltage, and a joint of two; with torque steps that a jump is seen beside."""
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", ["safety.tau_step_max_fraction=0.1"])


@cache
def starts() -> Any:
    return start_joints(cell())


@cache
def mapped() -> ArmMap:
    return arm_map(cell(), cell().arms[0], "virtual", starts()[0])


@cache
def agent() -> Agent:
    return build_agent(cell(), cell().arms[0])


@cache
def schedule() -> Schedule:
    return schedule_of(cell(), hold=True, shared=False)


@dataclass
class Look:
    """What one servo was like at one instant."""

    torque: bool
    watchdog: int  # register, -1 once it has fired
    goal: int  # of its effort
    acts: bool  # its goal moves it: it has torque, and has not stopped by itself


class Witness:
    """What the servos were seen to do that they must not; `broken` has the first of each kind, in words.

    Rules that hold throughout:

    - torque comes on with the goals of rest alone: no effort of what is controlled, the present place of what is held;
    - a servo has torque and a cleared watchdog for less than `unarmed_max_ns`: 0 for not at all;
    - the goal by which a controlled servo moves changes by at most `steps` of the loop's torque steps from one write to
      the next, but to zero, and begins at zero where torque comes on or comes back.
    """

    unarmed_max_ns = 0

    def __init__(self, rig: OneArm) -> None:
        self.broken: list[str] = []
        self.unarmed_ns = 0  # longest
        self.steps = 1.0
        self._rig = rig
        self._since: dict[int, int] = {}
        self._kinds: set[str] = set()
        self._limit = {
            i: step for joint, step in zip(rig.arm.controlled, _step_counts(rig.arm), strict=True) for i in joint.ids
        }
        self._last = {servo.id: look(servo, rig.effort(servo.id)) for servo in rig.servos}

    def note(self, kind: str, text: str) -> None:
        if kind not in self._kinds:
            self._kinds.add(kind)
            self.broken.append(f"{(self._rig.clock._ns - self._rig.begin_ns) / MS:.1f} ms: {kind}: {text}")

    def see(self) -> None:
        """Look at all of them."""
        now_ns = self._rig.clock._ns
        for servo in self._rig.servos:
            i = servo.id
            before, now = self._last[i], look(servo, self._rig.effort(i))
            if now.torque and not before.torque:
                self._came_on(servo, now)
            if now.torque and now.watchdog == 0:
                since = self._since.setdefault(i, now_ns)
                self.unarmed_ns = max(self.unarmed_ns, now_ns - since)
                if now_ns - since >= self.unarmed_max_ns:
                    self.note("torque without a watchdog", f"servo {i} for {(now_ns - since) / MS:.0f} ms")
            else:
                self._since.pop(i, None)
            if i in self._limit and now.acts and now.goal:
                step = abs(now.goal - (before.goal if before.acts else 0))
                if step > self.steps * self._limit[i] + 1:
                    was = before.goal if before.acts else "nothing"
                    self.note("torque step", f"servo {i} from {was} to {now.goal}, {self._limit[i]} allowed")
            self._last[i] = now

    def _came_on(self, servo: Servo, now: Look) -> None:
        slot = next(slot for slot in self._rig.arm.slots if slot.servo_id == servo.id)
        rest = self._rig.rest[servo.id]
        if now.goal != rest:
            self.note("torque on with a goal", f"servo {servo.id}: {now.goal}, at rest {rest}")
        if slot.joint.role is not JointRole.CONTROLLED:
            off = servo.firmware.memory.get(table.GOAL_POSITION) - servo.firmware.body.position_tick()
            if abs(off) > 5:
                self.note("torque on with a place", f"servo {servo.id}: {off} ticks away")
        mode = servo.firmware.memory.get(table.OPERATING_MODE)
        if mode != slot.joint.mode:
            self.note("torque on in a mode", f"servo {servo.id}: {mode}, wanted {slot.joint.mode}")


def look(servo: Servo, effort: Any) -> Look:
    memory, drive = servo.firmware.memory, servo.firmware.body.drive
    watchdog = memory.get(table.BUS_WATCHDOG)
    acts = drive.torque_on and watchdog != WATCHDOG_TRIPPED and drive.stop is None
    return Look(drive.torque_on, watchdog, memory.get(effort), acts)


def _step_counts(arm: ArmMap) -> list[int]:
    steps = agent().limits.tau_step_max_Nm
    return [torque_drive(joint).command(step, 0.0, 12.0)[0] for joint, step in zip(arm.controlled, steps, strict=True)]


class WatchedClock(VirtualClock):
    """A clock whose steps are looked at."""

    passed: Callable[[], None] = staticmethod(lambda: None)

    def sleep_until(self, deadline_ns: int) -> None:
        while self._ns < deadline_ns:
            super().sleep_until(min(deadline_ns, self._ns + MS))
            self.passed()


@dataclass
class Told:
    """What the loops told."""

    modes: list[Mode] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)
    busy: int = 0


class OneArm:
    """The rig: `start`, `carry`, `guard` and `end` are what the processes of an arm do, one after the other."""

    def __init__(self) -> None:
        self.arm = mapped()
        wired = wiring(cell().arms[0], 0, self.arm.baud)
        self.emulated, self.world = emulate_alone(lone_spec(cell(), starts()), [(0, wired)], timing=BusTiming())
        self.injector = Injector(self.emulated.arms[0], None, seed=1)
        self.clock = WatchedClock(self.emulated, self.injector)
        self.begin_ns = self.clock._ns
        self.line = Line(self.emulated, 0, self.injector, self.clock)
        self.events: list[Any] = []
        self.told = Told()
        self.log = Log()
        self.row = AgentRow(self.log.message, cell().arms[0].n, cell().config_id)
        self.efforts = {slot.servo_id: effort_register(slot) for slot in self.arm.slots}
        self.rest: dict[int, int] = {}
        self.witness = Witness(self)
        self.clock.passed = self.witness.see
        self.port = LossyPort(self.line, self.arm.baud, self.witness.see)
        self.driver = DynamixelDriver(
            self.arm, self.clock, on_event=self.events.append, scan_s=0.02, port=self.port
        )  # fmt: skip
        self.handover: Handover | None = None

    # --- servos, past the bus -------------------------------------------------------------------------------------

    @property
    def servos(self) -> tuple[Servo, ...]:
        return self.emulated.arms[0].bus.servos

    @property
    def gripper(self) -> Servo:
        return self.servos[-1]

    def effort(self, servo_id: int) -> Any:
        return self.efforts[servo_id]

    def torques(self) -> list[int]:
        return [servo.firmware.memory.get(table.TORQUE_ENABLE) for servo in self.servos]

    def rest_goals(self) -> None:
        """The goals with which they have no torque."""
        for servo in self.servos:
            servo.firmware.set_and_mirror(self.effort(servo.id), self.rest[servo.id])

    def registers(self) -> list[list[int]]:
        """All that a host writes, of each servo; what it goes on counting and measuring is not among it."""
        return [list(servo.firmware.memory.bytes[:120] + servo.firmware.memory.bytes[147:]) for servo in self.servos]

    def watchdogs(self) -> list[int]:
        return [servo.firmware.memory.get(table.BUS_WATCHDOG) for servo in self.servos]

    def put_back(self) -> None:
        """Somebody lays the arm on its support again, where it starts."""
        arm = self.world.arms[0]
        arm.q, arm.dq = starts()[0].copy(), 0.0 * arm.dq
        self.world._idle.add(0)

    def left_behind(self, *, torque: bool) -> None:
        """As another session has left them: modes of this cell, goals of then, watchdogs that have fired."""
        for slot, servo in zip(self.arm.slots, self.servos, strict=True):
            firmware = servo.firmware
            for register, value in ((table.OPERATING_MODE, slot.joint.mode), (table.RETURN_DELAY_TIME, 0)):
                firmware.accept(register, int(value))
            firmware.set_and_mirror(self.effort(servo.id), 150)
            firmware.set_and_mirror(table.GOAL_POSITION, firmware.body.position_tick() + 200)
            if torque:
                firmware.memory.put(table.TORQUE_ENABLE, 1)
                firmware.body.drive.torque_on = True
            firmware.memory.put(table.BUS_WATCHDOG, WATCHDOG_TRIPPED)
            firmware.memory.put(table.LED, 1)
        self.witness = Witness(self)
        self.clock.passed = self.port._after = self.witness.see

    # --- what processes do ----------------------------------------------------------------------------------------

    def start(self) -> None:
        """Connect, if it has not, and enable.  Raises DriverError."""
        if not self.port.is_open:
            self.driver.connect()
        self.rest = efforts_at_rest(self.driver.found)
        self.driver.enable()
        self.handover = Handover.of(self.driver)

    def around(self, each: Callable[[int], None]) -> Surroundings:
        cycles = 0

        def beat() -> None:
            nonlocal cycles
            cycles += 1
            each(cycles)

        def busy() -> None:
            self.told.busy += 1

        return Surroundings(
            wall_ns=lambda: self.clock._ns, operator=lambda: Event.NONE, start_ns=lambda: None, heartbeat=beat,
            mode_changed=self.told.modes.append, trouble=self.told.troubles.append, busy=busy,
        )  # fmt: skip

    def carry(self, each: Callable[[int], None]) -> Any:
        """The agent's loop; each: is called behind each cycle with its number.  Ends by what that raises."""
        runner = Runner(agent(), self.driver, self.clock, schedule(), self.row, self.log, self.around(each))
        try:
            return runner.run()
        except Over:
            return None

    def guard(self, loss: Loss | None, each: Callable[[int], None], late_ns: int = HOST_NS) -> Any:
        """What the guard does once the agent is dead; its packets count from its first on.  Raises DriverError."""
        assert self.handover is not None
        port = LossyPort(self.line, self.arm.baud, self.witness.see)
        self.line.user = None
        port.open()
        self.port = port
        self.driver = driver = StandbyDriver(self.arm, self.clock, on_event=self.events.append, port=port)
        driver.prepare(self.handover)
        self.clock.sleep_until(self.clock._ns + late_ns)
        port.count(loss)
        rows = np.array(self.log.rows[-64:], AGENT_STATE.dtype)
        begun: Beginning = go_on(agent(), driver, self.clock, rows, schedule(), "the agent has died")
        held = replace(schedule(), hold_at_end=True)
        around = self.around(each)
        runner = Runner(agent(), driver, self.clock, held, self.row, self.log, around, beginning=begun)
        try:
            return runner.run()
        except Over:
            return None

    def end(self) -> None:
        """What a process does last."""
        self.driver.disable()
        self.driver.close()

    def pass_time(self, seconds: float) -> None:
        self.clock.sleep_until(self.clock._ns + round(seconds * 1e9))
