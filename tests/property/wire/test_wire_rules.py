"""The control table as a state machine: any sequence of instructions against a small model of the manual's rules."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import SHUTDOWN_DEFAULT, HardwareError, Instruction, OperatingMode
from drivers.dynamixel.servo.table import Register
from tests.support.servos.wire_bench import MS, Bench, xm430

OK, RANGE, LIMIT, ACCESS, ALERT = 0, 4, 6, 7, 0x80
EEPROM = (
    table.RETURN_DELAY_TIME,
    table.HOMING_OFFSET,
    table.TEMPERATURE_LIMIT,
    table.CURRENT_LIMIT,
    table.PWM_LIMIT,
    table.VELOCITY_LIMIT,
    table.MIN_POSITION_LIMIT,
    table.MAX_POSITION_LIMIT,
)
GOALS = {
    table.GOAL_CURRENT: table.CURRENT_LIMIT,
    table.GOAL_PWM: table.PWM_LIMIT,
    table.GOAL_VELOCITY: table.VELOCITY_LIMIT,
}
PLAIN = (table.LED, table.PROFILE_ACCELERATION, table.PROFILE_VELOCITY, table.POSITION_P_GAIN)
KT_PER_COUNT = 2.69e-3 * 4.1 / 2.3


def value_of(register: Register) -> st.SearchStrategy[int]:
    """Values around the range of a register, mostly inside."""
    assert register.minimum is not None
    assert register.maximum is not None
    bits = 8 * register.length
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if register.signed else (0, 2**bits - 1)
    inside = st.integers(register.minimum, register.maximum)
    near = st.sampled_from([register.minimum - 1, register.maximum + 1]).map(lambda v: max(low, min(high, v)))
    return st.one_of(inside, inside, near)


class ControlTable(RuleBasedStateMachine):
    """What the manual says, beside what the servo does."""

    def __init__(self) -> None:
        super().__init__()
        self.servo = xm430()
        self.bench = Bench(self.servo)
        self.model = {r.name: r.default for r in (*EEPROM, *PLAIN)}
        self.mode = OperatingMode.POSITION
        self.torque = False
        self.watchdog = 0
        self.errors = 0
        self.goals: dict[str, int] = {}
        self.goals_to_limits()

    def goals_to_limits(self) -> None:
        self.goals = {
            table.GOAL_CURRENT.name: self.model[table.CURRENT_LIMIT.name] or 0,
            table.GOAL_PWM.name: self.model[table.PWM_LIMIT.name] or 0,
            table.GOAL_VELOCITY.name: 0,
        }

    def alert(self, error: int) -> int:
        return error | (ALERT if self.errors else 0)

    @rule(data=st.data(), register=st.sampled_from(EEPROM))
    def write_eeprom(self, data: st.DataObject, register: Register) -> None:
        value = data.draw(value_of(register))
        assert register.minimum is not None
        assert register.maximum is not None
        expected = ACCESS if self.torque else OK if register.minimum <= value <= register.maximum else RANGE
        assert self.bench.write(1, register, value) == self.alert(expected)
        if expected == OK:
            self.model[register.name] = value

    @rule(data=st.data(), register=st.sampled_from(PLAIN))
    def write_plain(self, data: st.DataObject, register: Register) -> None:
        value = data.draw(value_of(register))
        assert register.minimum is not None
        assert register.maximum is not None
        expected = OK if register.minimum <= value <= register.maximum else RANGE
        assert self.bench.write(1, register, value) == self.alert(expected)
        if expected == OK:
            self.model[register.name] = value

    @rule(data=st.data(), register=st.sampled_from(sorted(GOALS, key=lambda r: r.address)))
    def write_goal(self, data: st.DataObject, register: Register) -> None:
        value = data.draw(value_of(register))
        limit = self.model[GOALS[register].name]
        assert limit is not None
        assert register.minimum is not None
        assert register.maximum is not None
        if self.watchdog < 0 or not register.minimum <= value <= register.maximum:
            expected = RANGE
        else:
            expected = OK if abs(value) <= limit else LIMIT
        assert self.bench.write(1, register, value) == self.alert(expected)
        if expected == OK:
            self.goals[register.name] = value

    @rule(mode=st.sampled_from([*OperatingMode, 2]))
    def change_mode(self, mode: int) -> None:
        expected = ACCESS if self.torque else OK if mode != 2 else RANGE
        data = bytes((table.OPERATING_MODE.address, 0, mode))
        assert self.bench.one(1, Instruction.WRITE, data).error == self.alert(expected)
        if expected == OK:
            self.mode = OperatingMode(mode)
            self.goals_to_limits()
            for register in (table.PROFILE_ACCELERATION, table.PROFILE_VELOCITY, table.POSITION_P_GAIN):
                self.model[register.name] = register.default

    @rule(on=st.booleans())
    def switch_torque(self, on: bool) -> None:
        assert self.bench.write(1, table.TORQUE_ENABLE, on) == self.alert(OK)
        self.torque = on and not self.errors & SHUTDOWN_DEFAULT

    @rule(period=st.integers(1, 127))
    def arm_watchdog(self, period: int) -> None:
        expected = RANGE if self.watchdog < 0 else OK
        assert self.bench.write(1, table.BUS_WATCHDOG, period) == self.alert(expected)
        if expected == OK:
            self.watchdog = period

    @rule()
    def clear_watchdog(self) -> None:
        assert self.bench.write(1, table.BUS_WATCHDOG, 0) == self.alert(OK)
        self.watchdog = 0

    @rule(silence_ms=st.integers(0, 3000))
    def keep_silent(self, silence_ms: int) -> None:
        self.bench.now_ns += silence_ms * MS
        self.bench.bus.tick(self.bench.now_ns)
        if self.torque and 0 < self.watchdog * 20 < silence_ms:
            self.watchdog = -1

    @rule(error=st.sampled_from(list(HardwareError)))
    def fail(self, error: HardwareError) -> None:
        self.servo.firmware.raise_error(error)
        self.errors |= error
        if self.errors & SHUTDOWN_DEFAULT:
            self.torque = False

    @precondition(lambda self: self.errors or self.watchdog < 0)
    @rule()
    def reboot(self) -> None:
        assert self.bench.one(1, Instruction.REBOOT).error == self.alert(OK)
        self.bench.now_ns += 301 * MS
        self.errors = self.watchdog = 0
        self.torque = False
        self.goals_to_limits()
        self.model |= {r.name: r.default for r in PLAIN}

    @rule(position_rad=st.floats(-20.0, 20.0), velocity=st.floats(-5.0, 5.0))
    def move(self, position_rad: float, velocity: float) -> None:
        horn = self.servo.firmware.body.horn
        horn.position_rad, horn.velocity_rad_per_s = position_rad, velocity

    @invariant()
    def registers_read_what_the_model_says(self) -> None:
        for register in (*EEPROM, *PLAIN):
            assert self.bench.read(1, register) == self.model[register.name], register.name
        for register in GOALS:
            assert self.bench.read(1, register) == self.goals[register.name], register.name
        assert self.bench.read(1, table.OPERATING_MODE) == self.mode
        assert self.bench.read(1, table.TORQUE_ENABLE) == self.torque
        assert self.bench.read(1, table.BUS_WATCHDOG) == self.watchdog
        assert self.bench.read(1, table.HARDWARE_ERROR_STATUS) == self.errors
        assert self.bench.one(1, Instruction.PING).error == self.alert(OK)

    @invariant()
    def torque_obeys_its_bounds(self) -> None:
        body = self.servo.firmware.body
        torque_Nm = body.step(1e-4, alive=True)
        if not self.torque:
            assert torque_Nm == 0.0
        elif self.mode is OperatingMode.CURRENT and body.horn.velocity_rad_per_s == 0.0:
            limit = self.model[table.CURRENT_LIMIT.name] or 0
            assert abs(torque_Nm) <= KT_PER_COUNT * min(abs(self.goals[table.GOAL_CURRENT.name]), limit) + 1e-9
        if self.torque and self.watchdog < 0 and self.mode in (OperatingMode.CURRENT, OperatingMode.PWM):
            assert torque_Nm == 0.0, "limp is what the switch says"


ControlTable.TestCase.settings = settings(max_examples=40, stateful_step_count=25, deadline=None)
TestControlTable = ControlTable.TestCase
