"""What bring-up writes to which servo, register by register, and what it believes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.dynamixel.bringup import efforts_at_rest, goal_limits
from drivers.dynamixel.errors import DxlServoFault, FaultCause
from drivers.dynamixel.events import EventKind
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.line import codec
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import HardwareError, Instruction, StatusError
from drivers.dynamixel.servo.table import Register
from sim_backend.wire.faults import FaultKind
from tests.support.servos.dxl_rig import WX200, Rig, at, build, enabled

MODE, TORQUE, LED, WATCHDOG, PWM, CURRENT, POSITION, MAPPED = 11, 64, 65, 98, 100, 102, 116, 168
SHADOW = 3
COMMANDED = (1, 2, 4, 5, 6, 7)
ARMED = 10  # of 20 ms
HELD, GRIPPER_PWM = round(0.4 * 2300 / 2.69), round(0.4 * 885)
Write = tuple[int, dict[int, int]]  # address, and what is written there by servo


def written(rig: Rig) -> list[Write]:
    """In order, and what has been asked of here is forgotten."""
    found = []
    for packet in b"".join(rig.port.writes).split(codec.HEADER)[1:]:
        servo_id, code, body = packet[0], packet[3], packet[4:-2]
        if code == Instruction.WRITE:
            values = {servo_id: body[2:]}
        elif code == Instruction.SYNC_WRITE:
            size = 1 + int.from_bytes(body[2:4], "little")
            values = {body[k]: body[k + 1 : k + size] for k in range(4, len(body), size)}
        else:
            continue
        found.append((int.from_bytes(body[:2], "little"), {i: _number(data) for i, data in values.items()}))
    rig.port.writes.clear()
    return found


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little", signed=True)


def to_all(value: int) -> dict[int, int]:
    return dict.fromkeys(COMMANDED, value)


def goals(*, blind: bool = False) -> list[Write]:
    """Of an arm at rest: zero of what is controlled, a limited effort and the present place of what is held."""
    here = [(POSITION, {1: 2048}), (POSITION, {7: 2178})]
    if blind:
        efforts = [(CURRENT, {1: HELD, 2: 0, 4: 0, 5: 0}), (PWM, {6: 0, 7: GRIPPER_PWM})]
        return [*efforts, (POSITION, here[0][1] | here[1][1])]
    return [
        (CURRENT, {1: HELD}), here[0], (CURRENT, {2: 0}), (CURRENT, {4: 0}), (CURRENT, {5: 0}), (PWM, {6: 0}),
        (PWM, {7: GRIPPER_PWM}), here[1],
    ]  # fmt: skip


def mapped(servo_id: int) -> list[Write]:
    """What is read of a servo in one piece: torque, LED, hardware error, watchdog and both bytes of its effort."""
    effort = PWM if servo_id in (6, 7) else CURRENT
    sources = (TORQUE, LED, 70, WATCHDOG, effort, effort + 1)
    return [(MAPPED + 2 * place, {servo_id: source}) for place, source in enumerate(sources)]


def test_modes_then_marks_then_goals_then_watchdogs_then_torque() -> None:
    modes = {1: 5, 2: 0, 3: 0, 4: 0, 5: 0, 6: 16}  # the gripper has its own from the factory
    assert written(enabled()) == [
        *((MODE, {i: mode}) for i, mode in modes.items()),
        *(write for i in range(1, 8) for write in ((WATCHDOG, {i: 0}), *mapped(i), (LED, {i: 1}))),
        *goals(),
        *((WATCHDOG, {i: ARMED}) for i in COMMANDED),
        (TORQUE, to_all(1)),
    ]


def forgets_its_watchdog(rig: Rig, servo_id: int, when: Register) -> None:
    """As often as something is written to a register of this servo."""
    memory = rig.servo(servo_id).firmware.memory
    really = memory.put

    def put(register: Register, value: int) -> None:
        really(register, value)
        if register is when and value > 0:
            really(table.BUS_WATCHDOG, 0)

    memory.put = put  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("servo_id", "when", "torque"), [(SHADOW, table.BUS_WATCHDOG, []), (4, table.TORQUE_ENABLE, [1])]
)
@pytest.mark.fault("P8")
def test_a_servo_without_its_watchdog_gets_no_torque_or_keeps_none(
    servo_id: int, when: Register, torque: list[int]
) -> None:
    """A shadow answers no write; and one that loses it behind the look before torque is seen by the look behind it."""
    rig = build()
    rig.driver.connect()
    forgets_its_watchdog(rig, servo_id, when)
    written(rig)
    with pytest.raises(DxlServoFault, match=f"servo {servo_id} .*Bus Watchdog"):
        rig.driver.enable()
    given = [values[4] for address, values in written(rig) if address == TORQUE and values.get(4)]
    assert given == torque
    assert not any(rig.get(i, table.TORQUE_ENABLE) for i in range(1, 8))


def test_arming_again_goes_out_in_one_piece_with_the_goals() -> None:
    """A process that is killed in it leaves no servo without a watchdog; nor do two of its packets that are lost."""
    rig = enabled()
    written(rig)
    rig.driver.rearm()
    (piece,) = [data for data in rig.port.writes if data[7] == Instruction.SYNC_WRITE]
    rig.port.writes[:] = [piece]
    armed = (WATCHDOG, to_all(ARMED))
    assert written(rig) == [(WATCHDOG, to_all(0)), armed, *goals(blind=True), armed, armed]


def test_arming_again_writes_no_register_that_carries_no_torque_of_this_arm() -> None:
    rig = enabled(at(WX200, joints=WX200.joints[:-2]))
    written(rig)
    rig.driver.rearm()
    assert [address for address, _ in written(rig)] == [WATCHDOG, WATCHDOG, CURRENT, POSITION, WATCHDOG, WATCHDOG]


def test_arming_an_arm_again_that_holds_no_joint_writes_no_place() -> None:
    rig = enabled(at(WX200, joints=WX200.controlled))
    written(rig)
    rig.driver.rearm()
    assert [address for address, _ in written(rig)] == [WATCHDOG, WATCHDOG, CURRENT, PWM, WATCHDOG, WATCHDOG]


def test_torque_goes_off_twice_with_silence_between() -> None:
    rig = enabled()
    written(rig)
    begin_ns = rig.clock.now_ns()
    rig.driver.disable()
    assert rig.clock.now_ns() - begin_ns > 25_000_000
    assert written(rig) == [(TORQUE, to_all(0)), (TORQUE, to_all(0)), (WATCHDOG, to_all(0)), (LED, to_all(0))]


@pytest.mark.parametrize(("lost", "torque", "watchdog"), [(2, 0, ARMED), (3, 1, -1)])
def test_a_servo_that_has_not_heard_that_its_torque_is_off_keeps_its_watchdog(
    lost: int, torque: int, watchdog: int
) -> None:
    """Two packets lost: the third one reaches it; all of them: it stops by itself."""
    rig = enabled()
    really, dropped = rig.port.write, []

    def write(data: bytes, deadline_ns: int) -> None:
        if data[7] == Instruction.SYNC_WRITE and data[8] == TORQUE and len(dropped) < lost:
            dropped.append(data)
        else:
            really(data, deadline_ns)

    rig.port.write = write  # type: ignore[method-assign]
    rig.driver.disable()
    assert [rig.get(i, table.BUS_WATCHDOG) for i in COMMANDED] == [ARMED] * len(COMMANDED)
    rig.driver.close()
    rig.clock.sleep_until(rig.clock.now_ns() + 150_000_000)
    assert [rig.get(i, table.TORQUE_ENABLE) for i in COMMANDED] == [torque] * len(COMMANDED)
    rig.clock.sleep_until(rig.clock.now_ns() + 150_000_000)
    assert torque == 0 or [rig.get(i, table.BUS_WATCHDOG) for i in COMMANDED] == [watchdog] * len(COMMANDED)


def test_a_shadow_that_has_not_heard_that_its_torque_is_off_keeps_its_watchdog_too() -> None:
    """It takes what is written to the servo that it follows, which has heard it: else it would go on for ever."""
    rig = enabled()
    rig.driver.write(np.array([1.0, 0.0, 0.0, 0.0]))
    written(rig)
    shadow = rig.servo(SHADOW)
    really, missed = shadow.write, []

    def write(address: int, data: bytes, *, secondary: bool = False) -> StatusError:
        if address == TORQUE and len(missed) < 2:
            missed.append(data)
            return StatusError.NONE
        return really(address, data, secondary=secondary)

    shadow.write = write  # type: ignore[method-assign]
    rig.driver.disable()
    assert [rig.get(i, table.TORQUE_ENABLE) for i in range(1, 8)] == [0] * 7, "the third one reached it"
    assert [rig.get(i, table.BUS_WATCHDOG) for i in (2, SHADOW, 4)] == [ARMED, ARMED, 0]


def test_what_was_written_to_eeprom_is_told_once_and_not_written_again() -> None:
    rig = enabled()
    assert rig.events[0].kind is EventKind.EEPROM_WRITTEN
    assert (rig.events[0].servo_id, rig.events[0].joint) == (1, "waist")
    rig.driver.disable()
    rig.events.clear()
    written(rig)
    rig.driver.enable()
    assert min(address for address, _ in written(rig)) == TORQUE
    assert rig.events == []


LEFT = [
    (4, table.GOAL_PWM, 60), (SHADOW, table.GOAL_PWM, 0), (2, table.GOAL_PWM, -885), (1, table.GOAL_PWM, 0),
    (1, table.POSITION_P_GAIN, 0), (7, table.POSITION_D_GAIN, 9000), (1, table.POSITION_I_GAIN, 200),
    (1, table.FEEDFORWARD_1ST_GAIN, 50), (7, table.FEEDFORWARD_2ND_GAIN, 50), (1, table.PROFILE_VELOCITY, 3),
    (7, table.PROFILE_ACCELERATION, 3),
]  # fmt: skip


@pytest.mark.parametrize(("servo_id", "register", "left"), LEFT)
def test_what_another_program_left_in_ram_is_set_before_torque_and_told(
    servo_id: int, register: Register, left: int
) -> None:
    rig = enabled()
    rig.driver.disable()
    rig.put(servo_id, register, left)
    rig.events.clear()
    written(rig)
    rig.driver.enable()
    slot = next(slot for slot in WX200.slots if slot.servo_id == servo_id)
    wanted = 885 if register is table.GOAL_PWM else slot.model.default(register)
    assert rig.get(servo_id, register) == wanted
    writes = written(rig)
    assert writes.index((register.address, {servo_id: wanted})) < writes.index((TORQUE, to_all(1)))
    told = [(event.kind, event.servo_id, event.text) for event in rig.events]
    assert told == [(EventKind.RAM_WRITTEN, servo_id, f"{register.name} {left} → {wanted}")]


@pytest.mark.parametrize("servo_id", [4, SHADOW])
def test_a_servo_that_has_switched_itself_off_since_it_was_found_is_told_with_its_cause(servo_id: int) -> None:
    rig = build()
    rig.driver.connect()
    rig.fault(FaultKind.OVERLOAD, servo_id)
    rig.clock.sleep_until(rig.clock.now_ns() + 20_000_000)
    with pytest.raises(IdentityError, match=r"hardware error: found OVERLOAD.*switch its supply off and on"):
        rig.driver.enable()
    assert [rig.get(i, table.TORQUE_ENABLE) for i in range(1, 8)] == [0] * 7


@pytest.mark.parametrize(
    ("servo_id", "register", "cause"),
    [(4, table.GOAL_PWM, FaultCause.GOAL_IGNORED), (1, table.POSITION_P_GAIN, FaultCause.NOT_KEPT)],
)
def test_a_servo_that_keeps_what_another_program_left_gets_no_torque(
    servo_id: int, register: Register, cause: FaultCause
) -> None:
    rig = enabled()
    rig.driver.disable()
    rig.put(servo_id, register, 60)
    written(rig)
    memory = rig.servo(servo_id).firmware.memory
    really = memory.put
    memory.put = lambda into, value: None if into.name == register.name else really(into, value)
    with pytest.raises(DxlServoFault, match=f"found {register.name} 60, expected") as caught:
        rig.driver.enable()
    assert (caught.value.servo_id, caught.value.cause) == (servo_id, cause)
    assert (TORQUE, to_all(1)) not in written(rig)


def test_of_a_pair_each_servo_has_its_own_limit_of_voltage_again() -> None:
    """What is written to the one that is followed its shadow takes, too, as far as its own limit lets it."""
    rig = build()
    rig.put(SHADOW, table.PWM_LIMIT, 800)
    rig.driver.connect()
    rig.driver.enable()
    rig.driver.disable()
    for servo_id in (2, SHADOW):
        rig.put(servo_id, table.GOAL_PWM, 60)
    rig.driver.enable()
    assert [rig.get(i, table.GOAL_PWM) for i in (2, SHADOW)] == [885, 800]


def test_a_joint_that_another_program_starved_of_voltage_follows_its_torque() -> None:
    def torques(left: int | None) -> list[float]:
        rig = enabled()
        if left is not None:
            rig.driver.disable()
            rig.servo(4).firmware.accept(table.GOAL_PWM, left)
            rig.driver.enable()
        found = []
        for _ in range(5):
            rig.driver.write(np.array([0.0, 1.0, 0.0, 0.0]))
            rig.clock.sleep_until(rig.clock.now_ns() + 5_000_000)
            found.append(float(rig.driver.read().tau[1]))
        return found

    healthy = torques(None)
    assert max(healthy) > 0.8
    assert torques(60) == pytest.approx(healthy, abs=0.1)


@pytest.mark.parametrize(("register", "left"), [(table.POSITION_P_GAIN, 0), (table.GOAL_PWM, 0)])
def test_a_held_joint_that_another_program_left_weak_stays_where_it_is(register: Register, left: int) -> None:
    rig = enabled()
    rig.driver.disable()
    rig.servo(1).firmware.accept(register, left)
    waist = next(joint.free for joint in rig.cell.arms[0].joints if joint.name == "waist")
    waist.q_rad, waist.dq_rad_per_s = 0.1, 0.0
    rig.driver.enable()
    waist.gravity_Nm = -5.0  # 0.5 N·m where it stands, and more the further it goes
    for _ in range(100):
        rig.driver.write(np.zeros(4))
        rig.clock.sleep_until(rig.clock.now_ns() + 5_000_000)
        rig.driver.read()
    assert waist.q_rad == pytest.approx(0.1, abs=0.05)


def test_the_goals_of_a_pair_are_bounded_by_its_weaker_servo() -> None:
    rig = build()
    rig.driver.connect()
    limits = {2: 900, 3: 800, 1: 700}
    found = [
        replace(servo, values={**servo.values, "Current Limit": limits.get(servo.slot.servo_id, 1193)})
        for servo in rig.driver.found
    ]
    assert goal_limits(found) == {1: 700, 2: 800, 3: 800, 4: 1193, 5: 1193, 6: 885, 7: 885}
    assert efforts_at_rest(found) == {1: 342, **dict.fromkeys(range(2, 7), 0), 7: 354}, "shares of what there is"
    weak = [replace(servo, values={**servo.values, "Current Limit": 300, "PWM Limit": 200}) for servo in found]
    assert efforts_at_rest(weak) == {1: 300, **dict.fromkeys(range(2, 7), 0), 7: 200}, "and no more than a servo takes"


@pytest.mark.parametrize(("low", "high", "goal"), [(0, 4095, 2178), (0, 2100, 2100), (2200, 4095, 2200)])
def test_a_servo_in_position_mode_is_sent_to_no_place_beyond_its_limits(low: int, high: int, goal: int) -> None:
    """It would refuse it.  One held by current takes any place, and gets the one where it is."""
    rig = build()
    for servo_id in (1, 7):
        rig.put(servo_id, table.MIN_POSITION_LIMIT, low)
        rig.put(servo_id, table.MAX_POSITION_LIMIT, high)
    rig.driver.connect()
    rig.driver.enable()
    assert [values for address, values in written(rig) if address == POSITION] == [{1: 2048}, {7: goal}]


def deaf_to(rig: Rig, servo_id: int, register: Register, value: int) -> None:
    """Its register keeps what it has when this value is written, and the servo says that all is well."""
    memory = rig.servo(servo_id).firmware.memory
    really = memory.put

    def put(generic: Register, new: int) -> None:
        if generic.name != register.name or new != value:
            really(generic, new)

    memory.put = put  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("servo_id", "register", "value", "cause", "again"),
    [
        (SHADOW, table.GOAL_CURRENT, 0, FaultCause.GOAL_IGNORED, False),
        (6, table.GOAL_PWM, 0, FaultCause.GOAL_IGNORED, False),
        (SHADOW, table.BUS_WATCHDOG, ARMED, FaultCause.NOT_KEPT, False),
        (SHADOW, table.GOAL_CURRENT, 0, FaultCause.GOAL_IGNORED, True),
        (5, table.BUS_WATCHDOG, ARMED, FaultCause.NOT_KEPT, True),
    ],
)
def test_a_servo_that_does_not_take_its_goal_or_watchdog_is_named(
    servo_id: int, register: Register, value: int, cause: FaultCause, again: bool
) -> None:
    """At first no torque stays on; armed again, it is the loop that decides."""
    rig = enabled() if again else build()
    if again:
        rig.driver.write(np.array([1.0, 0.0, 0.0, 0.0]))
    else:
        rig.driver.connect()
    deaf_to(rig, servo_id, register, value)
    with pytest.raises(DxlServoFault, match=rf"found {register.name} \d+, expected {value}") as caught:
        rig.driver.rearm() if again else rig.driver.enable()
    assert (caught.value.cause, caught.value.servo_id) == (cause, servo_id)
    torque_on = [rig.get(i, table.TORQUE_ENABLE) for i in range(1, 8)]
    assert torque_on == [int(again)] * 7


def test_a_servo_that_switches_itself_off_right_before_its_torque_is_told_with_its_cause() -> None:
    rig = build()
    rig.driver.connect()
    really = rig.driver._bus.write_blind

    def late(register: Register, values: dict[int, int]) -> None:
        if register is table.TORQUE_ENABLE and 1 in values.values():
            rig.servo(4).firmware.raise_error(HardwareError.OVERLOAD)
        really(register, values)

    rig.driver._bus.write_blind = late  # type: ignore[method-assign]
    with pytest.raises(IdentityError, match=r"servo 4 \(elbow\): hardware error: found OVERLOAD.*supply off and on"):
        rig.driver.enable()
    assert [rig.get(i, table.TORQUE_ENABLE) for i in range(1, 8)] == [0] * 7
