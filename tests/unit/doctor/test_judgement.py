"""One judgement of a servo: connect, setup and doctor agree on each rule, on emulated servos."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from agent.doctor.servos import SECTIONS, VERDICTS
from agent.motors.setup import apply_setup, plan_setup
from agent.verify.finding import Verdict
from drivers.dynamixel.arm_map import Mark, ServoSlot
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.servo import judge, table
from drivers.dynamixel.servo.codes import StatusError
from drivers.dynamixel.servo.found import Consequence, Rule, ServoFound
from drivers.dynamixel.servo.judge import RULES, broken
from drivers.dynamixel.servo.kept import KEPT_RAM
from drivers.dynamixel.servo.table import FIRMWARE_VERSION, Register
from drivers.dynamixel.servo.wanted import setup_values
from sim_backend.wire.faults import FaultKind
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ServoWiring, servo_eeprom
from tests.support.servos.dxl_rig import WX200, XL, Rig, at, build
from tests.support.servos.tool_rig import LOOKING, bus_of, codes, eeprom, examined, servo_rig, torque_is_off

SLOTS = {slot.servo_id: slot for slot in WX200.slots}
WIRE = BusTiming()
REFUSING = {Consequence.NO_CONNECTION, Consequence.NO_TORQUE, Consequence.MOVE_FIRST}
WRITTEN = {Consequence.MENDED, Consequence.ROUTINE}


@dataclass(frozen=True)
class Break:
    """How a servo of an emulated arm comes to break a rule."""

    servo_id: int
    happens: Callable[[Rig], None]
    rig: Callable[[], Rig] = lambda: build(timing=WIRE)
    register: Register | None = None  # the EEPROM register that is wrong, and its value
    value: int = 0

    def broken_rig(self) -> Rig:
        """A rig whose servo breaks the rule."""
        rig = self.rig()
        self.happens(rig)
        return rig


def put(servo_id: int, register: Register, value: int) -> Break:
    return Break(servo_id, lambda rig: rig.put(servo_id, register, value), register=register, value=value)


def fault(servo_id: int, kind: FaultKind, **more: float) -> Break:
    def begin(rig: Rig) -> None:
        rig.fault(kind, servo_id, **more)
        rig.clock.sleep_until(rig.clock.now_ns() + 20_000_000)

    return Break(servo_id, begin)


def other_model() -> Rig:
    joints = tuple(replace(j, servo=XL, tau_max_Nm=1.0) if j.name == "elbow" else j for j in WX200.joints)
    return build(emulated=at(WX200, joints=joints), timing=WIRE)


def as_built(_: Rig) -> None:
    pass


def old_firmware(rig: Rig) -> None:
    rig.servo(4).firmware.version = 37
    rig.put(4, FIRMWARE_VERSION, 37)


def displaced(rig: Rig) -> None:
    rig.servo(4).firmware.body.encoder_offset_ticks = 600


def run_before() -> Rig:
    """Servos whose modes are the arm's already, as from the second start on."""
    rig = build(timing=WIRE)
    for servo_id, slot in SLOTS.items():
        rig.put(servo_id, table.OPERATING_MODE, int(slot.joint.mode))
    return rig


MARKED = at(WX200, mark=Mark("left", 1, ((2, "right"),)))
RESTING = at(WX200, joints=tuple(replace(joint, at_rest=True) for joint in WX200.joints))

BREAKS: dict[Rule, Break] = {
    judge.MARK: replace(put(4, table.MOVING_THRESHOLD, 2), rig=lambda: build(MARKED, timing=WIRE)),
    judge.MODEL: Break(4, as_built, other_model),
    judge.FIRMWARE: Break(4, old_firmware),
    judge.FAST_READ: Break(4, as_built, lambda: build(firmware=44, timing=WIRE)),
    judge.HARDWARE: fault(4, FaultKind.OVERLOAD),
    judge.SUPPLY: fault(4, FaultKind.VOLTAGE, voltage_V=8.0),
    judge.RATED_SUPPLY: fault(4, FaultKind.VOLTAGE, voltage_V=10.6),
    judge.HEAT: fault(4, FaultKind.OVERHEAT, temperature_C=80.0),  # at its limit, and not above it: no error yet
    judge.WARMTH: fault(4, FaultKind.OVERHEAT, temperature_C=76.0),
    judge.WATCHDOG: put(4, table.BUS_WATCHDOG, -1),
    judge.RETURN_LEVEL: put(4, table.STATUS_RETURN_LEVEL, 1),
    judge.TORQUE: put(4, table.TORQUE_ENABLE, 1),
    judge.POSE: Break(4, displaced),
    judge.REST: Break(4, displaced, lambda: build(RESTING, timing=WIRE)),
    judge.DIRECTION: put(4, table.DRIVE_MODE, 0),
    judge.DRIVE_BITS: put(1, table.DRIVE_MODE, 4),
    judge.SECONDARY: put(3, table.SECONDARY_ID, 255),
    judge.HOMING: put(2, table.HOMING_OFFSET, 12),
    judge.STARTUP: put(1, table.STARTUP_CONFIGURATION, 2),
    judge.CURRENT_LIMIT: put(3, table.CURRENT_LIMIT, 50),  # of a shadow: it would ignore its leader's goals
    judge.PWM_NEEDED: put(4, table.PWM_LIMIT, 40),  # current mode too: it would be limp with its torque on
    judge.MODE: put(4, table.OPERATING_MODE, 4),
    judge.RETURN_DELAY: put(4, table.RETURN_DELAY_TIME, 1),
    judge.PWM_LIMIT: put(6, table.PWM_LIMIT, 400),
    judge.LOW_LIMIT: put(2, table.MIN_POSITION_LIMIT, 0),
    judge.HIGH_LIMIT: put(2, table.MAX_POSITION_LIMIT, 4095),
    judge.SHUTDOWN: put(1, table.SHUTDOWN, 0),
    judge.HEAT_LIMIT: put(4, table.TEMPERATURE_LIMIT, 81),
    **{rule: replace(put(1, rule.registers[0], 7), rig=run_before) for rule in KEPT_RAM},
}
EXPECTED = {
    Consequence.NO_CONNECTION: {
        judge.MODEL, judge.MARK, judge.FIRMWARE, judge.HARDWARE, judge.SUPPLY, judge.HEAT, judge.DIRECTION,
        judge.SECONDARY, judge.HOMING, judge.STARTUP, judge.CURRENT_LIMIT, judge.PWM_NEEDED,
    },
    Consequence.NO_TORQUE: {judge.TORQUE},
    Consequence.MOVE_FIRST: {judge.POSE, judge.REST},
    Consequence.MENDED: {judge.WATCHDOG, judge.RETURN_LEVEL, judge.DRIVE_BITS, judge.RETURN_DELAY, *KEPT_RAM},
    Consequence.ROUTINE: {judge.MODE},
    Consequence.TOLERATED: {
        judge.FAST_READ, judge.RATED_SUPPLY, judge.WARMTH, judge.PWM_LIMIT, judge.LOW_LIMIT, judge.HIGH_LIMIT,
        judge.SHUTDOWN, judge.HEAT_LIMIT,
    },
}  # fmt: skip
NAMES = {rule: f"{rule.name}, {rule.consequence.name.lower()}".replace(" ", "_") for rule in RULES}


@pytest.fixture(autouse=True)
def _few_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    """How the bus keeps its time is asked in tests/unit/doctor/test_doctor.py."""
    monkeypatch.setattr("agent.doctor.cycle.READS", 10)


@pytest.fixture(params=RULES, ids=NAMES.get)
def rule(request: pytest.FixtureRequest) -> Rule:
    return request.param


def as_it_is(rig: Rig, servo_id: int) -> ServoFound:
    """A servo past the bus, as a survey would find it."""
    slot, servo = next(s for s in rig.arm.slots if s.servo_id == servo_id), rig.servo(servo_id)
    servo.firmware.refresh(rig.clock.now_ns())
    memory = servo.firmware.memory
    values = {r.name: memory.get(r) for r in judge.registers(slot.model) if memory.has(r)}
    return ServoFound(slot, memory.get(table.MODEL_NUMBER), servo.firmware.version, values)


def refusal_of(rig: Rig, *, connected: bool) -> IdentityError | None:
    """What connect (or enable after it) refuses."""
    try:
        rig.driver.connect()
        if connected:
            rig.driver.enable()
    except IdentityError as error:
        return error
    return None


def test_each_rule_has_a_way_to_be_broken_and_a_place_in_the_doctor() -> None:
    assert set(BREAKS) == set(RULES)
    shown = [rule for section in SECTIONS for rule in section.rules]
    assert sorted(map(id, shown)) == sorted(map(id, RULES))
    assert set(VERDICTS) == set(Consequence)
    assert {c: {rule for rule in RULES if rule.consequence is c} for c in Consequence} == EXPECTED
    assert not {VERDICTS[consequence] for consequence in REFUSING} & {Verdict.OK}


def test_a_servo_that_breaks_a_rule_is_seen_to_break_it_and_no_healthy_one_is(rule: Rule) -> None:
    servo_id = BREAKS[rule].servo_id
    assert broken(rule, as_it_is(BREAKS[rule].broken_rig(), servo_id)) is not None
    healthy = build(timing=WIRE)
    assert rule is judge.MODE or all(broken(rule, as_it_is(healthy, i)) is None for i in SLOTS)


def test_connect_and_enable_do_what_the_rule_says_will_follow(rule: Rule) -> None:
    rig = BREAKS[rule].broken_rig()
    servo_id = BREAKS[rule].servo_id
    at_connect = refusal_of(rig, connected=False)
    assert (at_connect is not None) == (rule.consequence is Consequence.NO_CONNECTION)
    refusal = refusal_of(rig, connected=True)
    assert (refusal is not None) == (rule.consequence in REFUSING)
    if refusal is not None:
        assert (refusal.servo_id, refusal.what) == (servo_id, f"{SLOTS[servo_id].title}: {rule.name}")
        assert torque_is_off(rig) or rule is judge.TORQUE
    else:
        still = broken(rule, as_it_is(rig, servo_id))
        assert (still is None) == (rule.consequence in WRITTEN)


def test_the_doctor_shows_what_the_rule_says_will_follow(rule: Rule) -> None:
    rig = BREAKS[rule].broken_rig()
    misfit = broken(rule, as_it_is(rig, BREAKS[rule].servo_id))
    assert misfit is not None
    diagnosis = examined(rig)
    verdict = VERDICTS[rule.consequence]
    shown = [f for f in diagnosis.findings if (f.found, f.wanted, f.remedy) == misfit.said]
    assert [f.verdict for f in shown] == ([verdict] if verdict is not Verdict.OK else [])
    assert all(f.what.endswith(f": {rule.name}") for f in shown)
    if rule.consequence in REFUSING:
        assert diagnosis.exit_code > 0
    if rule.consequence is Consequence.NO_CONNECTION:
        assert diagnosis.exit_code == 2


@pytest.mark.parametrize("rule", [r for r in RULES if BREAKS[r].register in setup_values(SLOTS[2])], ids=NAMES.get)
def test_what_setup_writes_no_rule_finds_fault_with(rule: Rule) -> None:
    slot, register = SLOTS[BREAKS[rule].servo_id], BREAKS[rule].register
    assert register is not None
    values = {**servo_eeprom(baud=WX200.baud), register.name: BREAKS[rule].value}
    rig = servo_rig(ServoWiring(slot.servo_id, slot.joint.servo, eeprom=values))
    bus = bus_of(rig)
    apply_setup(bus, plan_setup(bus, slot, WX200.baud, lambda _: None), WX200.baud)
    assert broken_by(slot, eeprom(rig)[slot.servo_id]) <= {judge.MODE}


def broken_by(slot: ServoSlot, values: dict[str, int]) -> set[Rule]:
    return {misfit.rule for misfit in judge.judge(ServoFound(slot, slot.model.model_number, 46, values))}


@pytest.mark.parametrize("slot", WX200.slots, ids=lambda slot: str(slot.servo_id))
def test_setup_writes_a_value_for_each_rule_about_eeprom_that_the_driver_does_not_write(slot: ServoSlot) -> None:
    written = {register.name for register in setup_values(slot)}
    kept = {table.HOMING_OFFSET.name} if slot.shadow else set()
    limits = (table.TEMPERATURE_LIMIT, table.MAX_VOLTAGE_LIMIT, table.MIN_VOLTAGE_LIMIT)  # the owner's, of what is read
    kept |= {table.MOVING_THRESHOLD.name}  # of a cell without marks; what `coop motors mark` writes elsewhere
    judged = {r.name for r in judge.registers(slot.model) if r.area is table.Area.EEPROM}
    assert judged - kept - {r.name for r in limits} - {table.OPERATING_MODE.name} <= written


@pytest.mark.parametrize("value", [1, 2, 3])
def test_a_servo_that_would_act_after_a_dip_of_the_supply_is_refused_in_words(value: int) -> None:
    rig = build()
    rig.put(5, table.STARTUP_CONFIGURATION, value)
    refusal = refusal_of(rig, connected=False)
    assert refusal is not None
    assert ("torque on" in str(refusal.found)) == bool(value & 1)
    assert ("registers from its backup" in str(refusal.found)) == bool(value & 2)


def test_a_register_that_a_servo_denies_is_a_refusal_unless_its_firmware_is_too_old_for_it() -> None:
    for register, refused in ((table.HOMING_OFFSET, True), (table.STARTUP_CONFIGURATION, False)):
        rig = build()
        servo = rig.servo(4)
        really = servo.read

        def deny(address, length, now_ns, *, really=really, register=register):
            return StatusError.ACCESS if address == register.address else really(address, length, now_ns)

        servo.read = deny
        refusal = refusal_of(rig, connected=False)
        assert (refusal is not None) == refused
        assert codes(rig) <= LOOKING
        assert refusal is None or "refused with ACCESS" in str(refusal.found)


def test_servos_of_a_held_pair_with_different_limits_hold_alike_and_one_that_cannot_is_refused() -> None:
    held = tuple(replace(j, role=WX200.joints[0].role) if j.name == "shoulder" else j for j in WX200.joints)
    rig = build(at(WX200, joints=held))
    rig.put(3, table.CURRENT_LIMIT, 500)
    rig.driver.connect()
    rig.driver.enable()
    assert rig.get(2, table.GOAL_CURRENT) == rig.get(3, table.GOAL_CURRENT) == round(0.4 * 2300 / 2.69)
    rig = build(at(WX200, joints=held))
    rig.put(3, table.CURRENT_LIMIT, 341)
    with pytest.raises(IdentityError, match=r"servo 3 .*Current Limit: found 341, expected at least 342"):
        rig.driver.connect()
