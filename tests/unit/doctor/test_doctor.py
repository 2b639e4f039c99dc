"""What the doctor finds: each defect named with what was found, what is wanted and what to do, and nothing touched."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.session import rest_joints
from agent.doctor.doctor import Diagnosis, maps_of
from agent.verify.finding import Finding, Verdict
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.servo.table import (
    BUS_WATCHDOG,
    CURRENT_LIMIT,
    DRIVE_MODE,
    FIRMWARE_VERSION,
    HOMING_OFFSET,
    ID,
    MIN_POSITION_LIMIT,
    PWM_LIMIT,
    RETURN_DELAY_TIME,
    SECONDARY_ID,
    SHUTDOWN,
    STARTUP_CONFIGURATION,
    STATUS_RETURN_LEVEL,
    TORQUE_ENABLE,
    Register,
)
from drivers.interface import DriverError
from sim_backend.wire.faults import FaultKind
from sim_backend.wire.timing import BusTiming, UsbTiming
from tests.support.few import long
from tests.support.servos.dxl_rig import WX200, XL, Rig, at, build
from tests.support.servos.tool_rig import examined, lines

TWO_WX200 = configs.CELLS_DIR / "two_wx200.toml"
WIRE = BusTiming()
SLOW_USB = BusTiming(usb=UsbTiming(latency_ns=16_000_000))


def findings(diagnosis: Diagnosis, verdict: Verdict) -> list[Finding]:
    return [f for f in diagnosis.findings if f.verdict is verdict]


def test_a_healthy_arm_has_nothing_but_ok() -> None:
    diagnosis = examined(build(timing=WIRE))
    assert list(lines(diagnosis)) == []
    assert diagnosis.exit_code == 0
    whats = {f.what for f in diagnosis.findings}
    assert {
        "USB latency timer", "servos", "firmware", "supply", "temperature", "hardware errors", "torque", "EEPROM",
        "start pose", "read of all servos, measured", "read in its period", "cycle, computed worst", "replies",
    } <= whats  # fmt: skip


# --- each defect -----------------------------------------------------------------------------------------------------


def register(servo_id: int, which: Register, value: int) -> Callable[[Rig], None]:
    return lambda rig: rig.put(servo_id, which, value)


def fault(kind: FaultKind, servo: int | None = None, **more: float) -> Callable[[Rig], None]:
    def begin(rig: Rig) -> None:
        rig.fault(kind, servo, **more)
        rig.clock.sleep_until(rig.clock.now_ns() + 20_000_000)

    return begin


def old_firmware(rig: Rig) -> None:
    """The elbow's servo says so; one that really is so old has no Drive Mode register to be set up with."""
    rig.servo(4).firmware.version = 37
    rig.put(4, FIRMWARE_VERSION, 37)


def slow_timer(rig: Rig) -> None:
    rig.port.latency_timer_ms = 16


def other(name: str, **change: object) -> ArmMap:
    """The arm that is really there: one joint is another."""
    return at(WX200, joints=tuple(replace(j, **change) if j.name == name else j for j in WX200.joints))


def away(rig: Rig) -> None:
    """The elbow hangs elsewhere: its servo reports a position 600 ticks off."""
    rig.servo(4).firmware.body.encoder_offset_ticks = 600


ANOTHER_ARM = at(WX200, joints=tuple(replace(j, ids=tuple(i + 20 for i in j.ids)) for j in WX200.joints))
ONE_MORE = at(WX200, joints=(*WX200.joints, replace(WX200.joints[-1], name="extra", ids=(9,))))


class Defect:
    """What is done to a rig, what the doctor says of it, whether the driver refuses the arm for it."""

    def __init__(self, says: str, *, refused: bool, happens: Callable[[Rig], None] | None = None, **rig) -> None:
        self.says = says
        self.refused = refused
        self._happens = happens
        self._rig = {"timing": WIRE} | rig

    def rig(self) -> Rig:
        made = build(**self._rig)
        if self._happens is not None:
            self._happens(made)
        return made


DEFECTS = {
    "a servo is missing": Defect(
        r"refused: .*servo 5 \(wrist_angle\): found nothing .*wanted a XM430",
        refused=True, happens=fault(FaultKind.SILENT, 5),
    ),
    "no power": Defect(
        r"refused: .*servos on virtual: found none that answers, at any speed.*12 V supply",
        refused=True, happens=fault(FaultKind.POWER_LOSS),
    ),
    "wrong baud rate": Defect(
        r"refused: .*baud rate on virtual: found servo 1 answers at 57600 bit/s, wanted 1000000 bit/s; correct `baud`",
        refused=True, emulated=at(WX200, baud=57_600),
    ),
    "another arm": Defect(
        r"refused: .*found IDs 21, 22, .*another arm: check the port",
        refused=True, emulated=ANOTHER_ARM,
    ),
    "two servos share an ID": Defect(
        r"refused: .*servo 5 \(wrist_angle\): found damaged packets.*two servos may have this ID.*setup",
        refused=True, happens=register(6, ID, 5),
    ),
    "a servo too many": Defect(
        r"refused: .*servo 9 on virtual: found a XL430-W250 that the arm file does not know",
        refused=True, emulated=ONE_MORE,
    ),
    "wrong model": Defect(
        r"refused: .*servo 4 \(elbow\): model: found XL430-W250, wanted XM430-W350; .*another arm",
        refused=True, emulated=other("elbow", servo=XL, tau_max_Nm=1.0),
    ),
    "firmware too old": Defect(
        r"refused: .*servo 4 \(elbow\): firmware: found 37, wanted 38 or newer.*Wizard",
        refused=True, happens=old_firmware,
    ),
    "firmware without fast sync read": Defect(
        r"warning: .*servo 1, 2, 3, 4, 5, 6, 7: fast sync read: found firmware 44, wanted 45 or newer; every cycle",
        refused=False, firmware=44,
    ),
    "latency timer": Defect(
        r"refused: .*USB latency timer: found 16 ms, wanted 1 ms; install the udev rule",
        refused=True, happens=slow_timer,
    ),
    "latency timer that nobody tells": Defect(
        r"refused: .*read in its period: found 1\d\.\d\d ms .*latency timer",
        refused=True, timing=SLOW_USB,
    ),
    "return delay": Defect(
        r"warning: .*Return Delay Time: found 250, wanted 0; the agent sets it",
        refused=False, eeprom={"Return_Delay_Time": 250},
    ),
    "direction": Defect(
        r"refused: .*Drive Mode, direction: found normal .*, wanted reverse .*; check how .*setup",
        refused=True, happens=register(4, DRIVE_MODE, 0),
    ),
    "time-based profile": Defect(
        r"warning: .*Drive Mode: found bits 0x4, wanted no bit but reverse",
        refused=False, happens=register(1, DRIVE_MODE, 4),
    ),
    "a shadow that follows nobody": Defect(
        r"refused: .*servo 3 \(shoulder shadow\): Secondary ID: found 255, wanted 2;",
        refused=True, happens=register(3, SECONDARY_ID, 255),
    ),
    "homing offset": Defect(
        r"refused: .*Homing Offset: found 12, wanted 0;",
        refused=True, happens=register(2, HOMING_OFFSET, 12),
    ),
    "position limit": Defect(
        r"warning: .*Min Position Limit: found 0, wanted 819; .*setup",
        refused=False, happens=register(2, MIN_POSITION_LIMIT, 0),
    ),
    "current limit": Defect(
        r"refused: .*Current Limit: found 50, wanted at least 4\d\d",
        refused=True, happens=register(4, CURRENT_LIMIT, 50),
    ),
    "pwm limit": Defect(
        r"warning: .*PWM Limit: found 400, wanted 885",
        refused=False, happens=register(6, PWM_LIMIT, 400),
    ),
    "shutdown": Defect(
        r"warning: .*Shutdown: found 0, wanted 52",
        refused=False, happens=register(1, SHUTDOWN, 0),
    ),
    "torque when power comes": Defect(
        r"refused: .*Startup Configuration: found 1: torque on when power comes, wanted 0; .*dip of the supply",
        refused=True, happens=register(1, STARTUP_CONFIGURATION, 1),
    ),
    "torque is on": Defect(
        r"refused: .*servo 4 \(elbow\): torque: found on already, wanted off; another program",
        refused=True, happens=register(4, TORQUE_ENABLE, 1),
    ),
    "hardware error": Defect(
        r"refused: .*servo 4 \(elbow\): hardware error: found OVERLOAD, wanted none",
        refused=True, happens=fault(FaultKind.OVERLOAD, 4),
    ),
    "hot": Defect(
        r"warning: .*servo 4 \(elbow\): temperature: found 78 °C, wanted below 75 °C; let it cool",
        refused=False, happens=fault(FaultKind.OVERHEAT, 4, temperature_C=78.0),
    ),
    "supply far too low": Defect(
        r"refused: .*servo 4 \(elbow\): supply: found 8.0 V, wanted 9.5",
        refused=True, happens=fault(FaultKind.VOLTAGE, 4, voltage_V=8.0),
    ),
    "supply low": Defect(
        r"warning: .*servo 4 \(elbow\): supply: found 10.6 V, wanted 11.0 to 13.0 V",
        refused=False, happens=fault(FaultKind.VOLTAGE, 4, voltage_V=10.6),
    ),
    "watchdog fired": Defect(
        r"warning: .*servo 4 \(elbow\): bus watchdog: found fired",
        refused=False, happens=register(4, BUS_WATCHDOG, -1),
    ),
    "not at the start pose": Defect(
        r"warning: .*servo 4 \(elbow\): start pose: found -?\d\.\d+ rad, wanted 0.550 to 0.850 rad; move the arm",
        refused=True, happens=away,
    ),
    "no answers to reads": Defect(
        r"refused: .*servo 4 \(elbow\): found nothing .*though it answers pings",
        refused=False, happens=register(4, STATUS_RETURN_LEVEL, 0),
    ),
    "babble": Defect(
        r"refused: .*port virtual: found bytes that nobody asked for",
        refused=False, happens=fault(FaultKind.BABBLE),
    ),
    "a bad cable": Defect(
        r"warning: .*replies: found \d+ of 200",
        refused=False, happens=fault(FaultKind.CORRUPT, 7, probability=0.02),
    ),
}  # fmt: skip


@pytest.fixture(scope="module", params=DEFECTS, ids=lambda name: name.replace(" ", "_"))
def defect(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def seen(defect: str) -> tuple[Rig, Diagnosis]:
    """A rig with the defect, and what the doctor says of it; where it is not of replies, by a few of them."""
    rig = DEFECTS[defect].rig()
    with pytest.MonkeyPatch.context() as patch:
        if defect not in ("a bad cable", "latency timer that nobody tells"):
            patch.setattr("agent.doctor.cycle.READS", 20)
        return rig, examined(rig)


def test_each_defect_is_one_line_with_found_wanted_and_remedy(defect: str, seen: tuple[Rig, Diagnosis]) -> None:
    _, diagnosis = seen
    said = list(lines(diagnosis))
    assert any(re.search(DEFECTS[defect].says, line) for line in said), said
    for finding in diagnosis.findings:
        assert finding.where == "left"
        assert "\n" not in finding.line
        assert finding.found
        assert finding.wanted
        assert (finding.remedy == "") == (finding.verdict is Verdict.OK)


def test_what_the_driver_refuses_the_doctor_does_not_call_ok(defect: str, seen: tuple[Rig, Diagnosis]) -> None:
    rig, diagnosis = seen
    refusal: DriverError | None = None
    rig.port.baud = rig.arm.baud
    try:
        rig.driver.connect()
        rig.driver.enable()
    except DriverError as error:
        refusal = error
    assert (refusal is not None) == DEFECTS[defect].refused, refusal
    if refusal is not None:
        assert diagnosis.exit_code > 0
        pose_only = defect == "not at the start pose"  # a state, which a hand puts right, and no defect
        assert (diagnosis.exit_code == 2) != pose_only


def resting(**rest_rad: float) -> ArmMap:
    """The arm of a cell with a session: its rest is its start but for these joints."""
    joints = (replace(j, at_rest=True, start_rad=rest_rad.get(j.name, j.start_rad)) for j in WX200.joints)
    return at(WX200, joints=tuple(joints))


def pose_lines(diagnosis: Diagnosis) -> list[str]:
    return [line for line in lines(diagnosis, but_ok=False) if " pose: " in line]


def test_an_arm_of_a_session_may_lie_at_rest_or_stand_at_its_start_and_the_line_says_which(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("agent.doctor.cycle.READS", 10)
    far = at(WX200, joints=tuple(replace(j, start_rad=-1.0) if j.name == "elbow" else j for j in WX200.joints))
    (at_rest,) = pose_lines(examined(build(resting(), timing=WIRE), started=far))
    assert re.search(r"^ok: left: rest pose: waist 0.00, .*elbow 0.70, .*\(wanted the cell's rest pose\)", at_rest)
    (at_start,) = pose_lines(examined(build(resting(elbow=1.5), timing=WIRE), started=WX200))
    assert re.search(r"^ok: left: start pose: .*\(wanted the cell's start pose\)", at_start)
    (neither,) = pose_lines(examined(build(resting(elbow=1.5), timing=WIRE), started=far))
    assert re.search(
        r"^warning: left: servo 4 \(elbow\): rest pose: found 0.699 rad, wanted 1.350 to 1.\d+ rad; move the arm there "
        r"by hand before the agent is started, or, where that is without --whole, to -1.150 to -0.850 rad, the start",
        neither,
    )


def test_an_arm_halfway_between_rest_and_start_is_at_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.doctor.cycle.READS", 10)
    far = at(WX200, joints=tuple(replace(j, start_rad=-1.0) if j.name == "elbow" else j for j in WX200.joints))
    (said,) = pose_lines(examined(build(resting(wrist_angle=1.0), timing=WIRE), started=far))
    assert "(wrist_angle): rest pose: found 0.4" in said


def test_the_pose_that_is_looked_for_is_the_rest_where_the_cell_has_a_session() -> None:
    plain, session = load_cell(TWO_WX200), load_cell(TWO_WX200, ["session.lift_m=0.02"])
    q = np.array(plain.arms[0].entry.q_near_rad)
    found, started = maps_of(plain, plain.arms[0], "virtual", q)
    assert found is started
    assert not any(joint.at_rest for joint in found.joints)
    found, started = maps_of(session, session.arms[0], "virtual", q)
    assert [j.start_rad for j in started.controlled] == q.tolist()
    assert [j.start_rad for j in found.controlled] == rest_joints(session.arms[0]).tolist()
    assert [j.at_rest for j in (*found.joints[:-1], *started.joints)] == [True] * 5 + [False] * 6
    other = load_cell(TWO_WX200, ["session.lift_m=0.02", "arms.left.rest_rad={elbow=1.0}"]).arms[0]
    assert other.rest_rad == {**session.arms[0].file.sleep_rad, "elbow": 1.0}


def test_a_problem_with_one_servo_does_not_hide_another() -> None:
    rig = build(timing=WIRE)
    rig.fault(FaultKind.SILENT, 1)
    rig.put(4, HOMING_OFFSET, 7)
    rig.put(5, SECONDARY_ID, 2)
    said = "\n".join(lines(examined(rig)))
    for part in ("servo 1 (waist)", "servo 4 (elbow): Homing Offset", "servo 5 (wrist_angle): Secondary ID"):
        assert part in said


def test_a_port_that_vanishes_is_a_finding_and_no_crash() -> None:
    rig = build(timing=WIRE)
    rig.port.lost = True
    (finding,) = findings(examined(rig), Verdict.REFUSED)
    assert "closed" in finding.found


# --- the cycle -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("usb_ms", [1, long(2)])
@pytest.mark.parametrize("firmware", [44, 46])
@pytest.mark.parametrize(
    ("baud", "rate_hz"),
    [
        long((57_600, 15.0)),
        (1_000_000, 150.0),
        long((3_000_000, 250.0)),
        (4_000_000, 100.0),
    ],
)
def test_computed_and_measured_read_agree_within_15_percent(
    baud: int, rate_hz: float, firmware: int, usb_ms: int
) -> None:
    rig = build(
        at(WX200, baud=baud, rate_hz=rate_hz, watchdog_s=1.0), firmware=firmware,
        timing=BusTiming(usb=UsbTiming(latency_ns=usb_ms * 1_000_000)),
    )  # fmt: skip
    rig.port.latency_timer_ms = usb_ms
    figures = examined(rig).cycles["left"]
    assert abs(figures.deviation) < 0.15
    assert figures.missed == 0
    assert abs(figures.overhead_s) < 1e-4
    assert figures.fast == (firmware >= 45)


@pytest.mark.parametrize(
    ("firmware", "what"),
    [long((44, "read of all servos, measured")), (46, "overhead of each read")],
    ids=["plain", "fast"],
)
def test_servos_that_answer_slower_than_computed_are_noticed(firmware: int, what: str) -> None:
    """Where each servo sends its own packet the budget is wrong; where they share one, each read has more overhead."""
    diagnosis = examined(build(at(WX200, rate_hz=20.0), firmware=firmware, timing=BusTiming(turnaround_ns=2_000_000)))
    assert what in [f.what for f in findings(diagnosis, Verdict.WARNING)]


def test_return_delay_is_in_the_computed_time_and_not_held_against_the_rate() -> None:
    diagnosis = examined(build(timing=WIRE, eeprom={RETURN_DELAY_TIME.name.replace(" ", "_"): 250}))
    figures = diagnosis.cycles["left"]
    assert abs(figures.deviation) < 0.15
    assert figures.budget.rate_max_hz < WX200.rate_hz < figures.budget_set.rate_max_hz
    assert diagnosis.exit_code == 1


def test_a_rate_that_the_bus_cannot_carry_is_a_problem_with_the_highest_that_fits() -> None:
    highest = int(examined(build(timing=WIRE)).cycles["left"].budget_set.rate_max_hz)
    diagnosis = examined(build(at(WX200, rate_hz=highest + 1.0), timing=WIRE))
    (budget,) = (f for f in diagnosis.findings if f.what == "cycle, computed worst")
    assert budget.verdict is Verdict.REFUSED
    assert f"at most {highest} Hz" in budget.wanted
    assert f"lower rate_hz to {highest}" in budget.remedy
