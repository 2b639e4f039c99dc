"""The mark of an arm: written into all of its servos and nowhere else, torque off, whatever comes in between."""

from __future__ import annotations

import pytest

import configs
from agent.config.cell import ConfigError, load_cell
from agent.motors.eeprom import EepromError
from agent.motors.mark import MarkError, NoMarkError, apply_mark, lit, marked, plan_mark
from agent.verify.marks import marks
from drivers.dynamixel.arm_map import Mark
from drivers.dynamixel.errors import PortLostError
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.servo import table
from drivers.interface import DriverError
from sim_backend.wire.faults import FaultKind
from sim_backend.wire.timing import BusTiming
from tests.support.servos.dxl_rig import WX200, Rig, at, build, wiring
from tests.support.servos.tool_rig import (
    LOOKING,
    arm_rig,
    bus_of,
    codes,
    settings,
    torque_is_off,
    written_registers,
)

ARM = at(WX200, mark=Mark("left", 1, ((2, "right"),)))
IDS = [slot.servo_id for slot in ARM.slots]
TWO = configs.CELLS_DIR / "two_wx200.toml"
OWN = "arms.{}.dynamixel.mark={}"


def unmarked() -> Rig:
    """An arm as it is bought; its cable can be cut."""
    return arm_rig(ARM, wiring(WX200))


def of(rig: Rig) -> list[int]:
    return [rig.get(servo_id, table.MOVING_THRESHOLD) for servo_id in IDS]


def test_all_servos_get_the_mark_and_nothing_else_is_written() -> None:
    rig = unmarked()
    before, bus = settings(rig), bus_of(rig)
    plan = plan_mark(bus, ARM)
    assert codes(rig) <= LOOKING
    assert [change.line for change in plan] == [f"servo {i}: Moving Threshold: found 10, wanted 1" for i in IDS]
    apply_mark(bus, ARM, plan)
    assert of(rig) == [1] * len(IDS)
    assert written_registers(rig) == [table.MOVING_THRESHOLD.address] * len(IDS)
    after = settings(rig)
    assert [{**servo, table.MOVING_THRESHOLD.name: 10} for servo in after] == before
    assert torque_is_off(rig)
    rig.driver.connect()
    rig.driver.close()
    assert plan_mark(bus_of(rig), ARM) == []


def test_the_leds_say_which_arm_it_is_and_go_out_again() -> None:
    rig = unmarked()
    leds = []

    def asked(answer: str) -> None:
        with lit(bus_of(rig), ARM):
            leds.append([rig.get(i, table.LED) for i in IDS])
            rig.port.lost = answer == "pulled the cable"
            raise KeyboardInterrupt(answer)

    for answer in ("ctrl-c", "pulled the cable"):
        with pytest.raises(KeyboardInterrupt, match=answer):
            asked(answer)
        leds.append([rig.get(i, table.LED) for i in IDS])
    on, off = [1] * len(IDS), [0] * len(IDS)
    assert leds == [on, off, on, on]


@pytest.mark.parametrize("packets", [0, 2, 5])
def test_a_cable_pulled_half_way_is_told_with_the_servos_that_have_the_mark_and_the_next_time_completes_it(
    packets: int,
) -> None:
    rig = unmarked()
    bus = bus_of(rig)
    plan = plan_mark(bus, ARM)
    rig.port.lose_after(packets)
    with pytest.raises(MarkError) as told:
        apply_mark(bus, ARM, plan)
    proven = packets // 3  # torque read, mark written, mark read back
    have, rest = (", ".join(map(str, ids)) or "none" for ids in (IDS[:proven], IDS[proven:]))
    assert told.value.remedy.endswith(f"mark 1 is in servos {have}, not known of {rest}: give the same command again")
    assert isinstance(told.value.__cause__, PortLostError)
    assert of(rig)[:proven] == [1] * proven
    rig.port.lose_after(None)
    rig.port.lost = False
    rig.driver.close()
    again = bus_of(rig)
    apply_mark(again, ARM, plan_mark(again, ARM))
    assert of(rig) == [1] * len(IDS)


def test_a_servo_that_falls_silent_half_way_is_named_and_the_others_keep_what_they_have() -> None:
    rig = unmarked()
    bus = bus_of(rig)
    plan = plan_mark(bus, ARM)
    rig.fault(FaultKind.SILENT, 4)
    with pytest.raises(MarkError, match=r"^servo 4: .* found nothing .*mark 1 is in servos 1, 2, 3, not known of 4, 5"):
        apply_mark(bus, ARM, plan)
    assert of(rig) == [1, 1, 1, 10, 10, 10, 10]


def silent(rig: Rig) -> None:
    rig.fault(FaultKind.SILENT, 6)


def holding(rig: Rig) -> None:
    rig.put(7, table.TORQUE_ENABLE, 1)


def of_right(rig: Rig) -> None:
    for servo_id in IDS:
        rig.put(servo_id, table.MOVING_THRESHOLD, 2)


@pytest.mark.parametrize(
    ("happens", "error", "match"),
    [
        (silent, IdentityError, r"servo 6 \(wrist_rotate\): found nothing"),
        (holding, EepromError, "servo 7: torque: found on, expected off"),
        (of_right, MarkError, "mark on virtual: found 2, arm right's, expected that of no other arm, or 1; .* swapped"),
    ],
)
def test_what_cannot_be_marked_is_refused_and_nothing_is_written(happens, error: type[DriverError], match: str) -> None:
    rig = unmarked()
    happens(rig)
    before = settings(rig)
    with pytest.raises(error, match=match):
        plan_mark(bus_of(rig), ARM)
    assert codes(rig) <= LOOKING
    assert settings(rig) == before


def test_the_mark_of_another_arm_is_replaced_where_a_person_says_so() -> None:
    rig = unmarked()
    of_right(rig)
    bus = bus_of(rig)
    apply_mark(bus, ARM, plan_mark(bus, ARM, replace=True))
    assert of(rig) == [1] * len(IDS)


def test_a_servo_that_comes_from_the_other_arm_gets_the_mark_of_its_new_one() -> None:
    rig = build(ARM, timing=BusTiming())
    rig.put(1, table.MOVING_THRESHOLD, 2)
    assert [change.line for change in plan_mark(bus_of(rig), ARM)] == ["servo 1: Moving Threshold: found 2, wanted 1"]


def test_an_arm_without_a_mark_in_its_cell_is_refused_and_a_folder_of_ports_is_taken() -> None:
    cell = load_cell(TWO, [OWN.format("right", 2)])
    with pytest.raises(NoMarkError, match="arm left: mark: found none in the cell, expected a number beside its port"):
        marked(cell, cell.arm("left"), None)
    assert [marked(cell, cell.arm("right"), folder).port for folder in (None, configs.CELLS_DIR)] == [
        "/dev/coop/right", str(configs.CELLS_DIR / "right"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("marks_of", "match"),
    [
        ({"left": 0}, "mark.*found 0, expected"),
        ({"left": 1024}, "mark.*found 1024, expected"),
        ({"left": '"1"'}, "mark.*found '1', expected"),
        ({"left": 10}, "mark.*found 10, expected a number with which no servo leaves the factory; .*10 or 20"),
        ({"left": 20}, "mark.*found 20, "),
        ({"left": 7, "right": 7}, "arms in .*: found mark 7 of left and of right, expected a mark of its own for each"),
    ],
)
def test_a_mark_that_tells_nothing_is_refused_with_the_cell(marks_of: dict[str, object], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        load_cell(TWO, [OWN.format(arm, mark) for arm, mark in marks_of.items()])


@pytest.mark.parametrize(
    ("cell", "changes", "wired", "alike"),
    [
        ("two_wx200", [], True, ["left, right"]),
        ("two_wx200", [], False, []),
        ("two_wx200", [OWN.format("right", 1023)], True, []),
        ("four_wx250s", [OWN.format("back", 1)], True, ["left, right, front"]),
        ("two_models", [], True, []),
    ],
)
def test_arms_that_only_their_cables_tell_apart_are_named_in_one_line(
    cell: str, changes: list[str], wired: bool, alike: list[str]
) -> None:
    loaded = load_cell(configs.CELLS_DIR / f"{cell}.toml", changes)
    found = marks(loaded, wired=wired)
    assert [(finding.where, finding.verdict) for finding in found] == [(names, "warning") for names in alike]
    assert all("`coop motors mark CELL --arm NAME`" in finding.remedy for finding in found)
