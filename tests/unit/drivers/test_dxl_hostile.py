"""Adapters and lines that garble, echo, repeat: the right words at connect, the right cause in the cycle, no old state.

A servo that restarts belongs here too: it is silent while it boots, and what it is afterwards must be said.
"""

from __future__ import annotations

import numpy as np
import pytest

from drivers.dynamixel.errors import DxlServoFault, FaultCause, Heard, NoReplyError, StaleJointsError
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.line import codec
from drivers.dynamixel.servo import table
from sim_backend.wire.bus import Tampered
from sim_backend.wire.faults import FaultKind
from sim_backend.wire.options import ServoOptions
from sim_backend.wire.timing import BusTiming
from tests.support.servos.dxl_rig import WX200, Rig, VirtualPort, build, driver_on
from tests.support.servos.tool_rig import bus_of, examined, lines

WIRE = BusTiming()
NO_POWER = "12 V supply"
REST = np.zeros(4)


class HostilePort(VirtualPort):
    """A port whose adapter echoes what is sent, or gives one old reply for whatever is sent."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig.line, rig.arm.baud)
        self.echoes = False
        self.repeats: bytes | None = None
        self.last = b""  # what the host has read since it wrote last
        self._queued = b""

    def write(self, data: bytes, deadline_ns: int) -> None:
        self.last = b""
        super().write(data, deadline_ns)
        if self.echoes:
            self._queued += data
        if self.repeats is not None:
            self._queued += self.repeats

    def read_now(self) -> bytes:
        data, queued, self._queued = super().read_now(), self._queued, b""
        if self.repeats is not None:
            return queued
        self.last += data
        return queued + data


def hostile(**more) -> tuple[Rig, HostilePort]:
    rig = build(timing=WIRE, **more)
    rig.port = HostilePort(rig)
    rig.driver = driver_on(rig, rig.port)
    return rig, rig.port


def spoil_checksums(rig: Rig, servo_id: int | None = None) -> None:
    """From now on every reply, or those of one servo, has a wrong checksum."""

    def tamper(sender: int, data: bytes) -> list[Tampered]:
        bad = data[:-1] + bytes((data[-1] ^ 0x55,))
        return [Tampered(bad if servo_id in (None, sender) else data, 0)]

    rig.bus.tamper = tamper


def refused(rig: Rig) -> IdentityError:
    with pytest.raises(IdentityError) as caught:
        rig.driver.connect()
    return caught.value


def cycles(rig: Rig, count: int) -> list[Exception | None]:
    """Errors of some cycles at the rate of the arm."""
    errors: list[Exception | None] = []
    start_ns = rig.clock.now_ns() + rig.arm.period_ns
    for k in range(count):
        rig.clock.sleep_until(start_ns + k * rig.arm.period_ns)
        try:
            rig.driver.read()
            errors.append(None)
        except (StaleJointsError, DxlServoFault) as error:
            errors.append(error)
        rig.driver.write(REST)
    return errors


def running(**more) -> tuple[Rig, HostilePort]:
    rig, port = hostile(**more)
    rig.driver.connect()
    rig.driver.enable()
    assert cycles(rig, 20) == [None] * 20
    return rig, port


# --- at connect ------------------------------------------------------------------------------------------------------


def test_wrong_checksums_are_called_so_and_not_a_missing_supply() -> None:
    rig = build(timing=WIRE)
    spoil_checksums(rig)
    error = refused(rig)
    assert error.servo_id is None
    assert "damaged packets, at 1000000 bit/s" in str(error.found)
    assert "cable" in error.remedy
    assert NO_POWER not in error.remedy
    assert rig.port.baud == WX200.baud
    said = list(lines(examined(rig)))
    assert any("servos on virtual: found damaged packets" in line for line in said)
    assert not any(NO_POWER in line for line in said)


def test_wrong_checksums_of_one_servo_may_be_a_shared_id() -> None:
    rig = build(timing=WIRE)
    spoil_checksums(rig, 5)
    error = refused(rig)
    assert error.servo_id == 5
    assert "damaged packets" in str(error.found)
    assert "two servos may have this ID" in error.remedy
    assert "if not, check its cable" in error.remedy


def test_two_answers_to_one_ping_may_be_a_shared_id() -> None:
    rig = build(timing=WIRE)
    rig.fault(FaultKind.DUPLICATE, 5)
    error = refused(rig)
    assert (error.servo_id, error.found) == (5, "2 answers to one ping")
    assert "two servos may have this ID" in error.remedy


def test_an_echo_with_nobody_behind_it_is_named_beside_the_missing_supply() -> None:
    rig, port = hostile()
    rig.fault(FaultKind.POWER_LOSS)
    port.echoes = True
    error = refused(rig)
    assert "none that answers, at any speed; only an echo of the request" in str(error.found)
    assert NO_POWER in error.remedy


def test_an_echo_with_servos_behind_it_does_no_harm() -> None:
    rig, port = hostile()
    port.echoes = True
    rig.driver.connect()
    rig.driver.enable()
    assert cycles(rig, 50) == [None] * 50


@pytest.mark.parametrize("reply", [codec.status(4, 0, b"\x01"), codec.status(200, 0, bytes(3))], ids=["read", "ping"])
def test_a_port_that_repeats_one_old_reply_is_called_that(reply: bytes) -> None:
    rig, port = hostile()
    port.repeats = reply
    error = refused(rig)
    assert "does not answer" not in str(error)
    if reply[4] == 4:  # of a servo of the arm
        assert "only answers to other requests" in str(error.found)
        assert "unplug and plug" in error.remedy
        assert NO_POWER not in error.remedy
    else:
        assert "IDs 200" in str(error.found)


def test_a_ping_reply_repeated_for_ever_is_not_taken_for_the_others() -> None:
    rig, port = hostile()
    port.repeats = codec.status(4, 0, (1020).to_bytes(2, "little") + b"\x2e")
    refused(rig)
    by_servo = {problem.servo_id: problem for problem in rig.driver.problems}
    assert set(by_servo) == {1, 2, 3, 4, 5, 6, 7}
    assert all("only answers to other requests" in str(problem.found) for problem in by_servo.values())


@pytest.mark.parametrize(
    ("garbage", "heard"),
    [
        (b"", Heard.NOTHING), (b"\x00\x55\xaa" * 5, Heard.NOISE), (codec.ping(4), Heard.ECHO),
        (codec.status(5, 0, bytes(3)), Heard.OTHER), (codec.status(4, 0, bytes(7)), Heard.OTHER),
        (codec.status(4, 0, bytes(3))[:-1] + b"\x99", Heard.DAMAGED),
        (codec.status(4, 0, bytes(3))[:-3], Heard.DAMAGED),
    ],
    ids=["nothing", "noise", "echo", "another servo's", "of another length", "checksum", "cut short"],
)  # fmt: skip
def test_what_came_instead_of_an_answer_is_told_apart(garbage: bytes, heard: Heard) -> None:
    rig, port = hostile()
    bus = bus_of(rig)
    port.repeats = garbage
    with pytest.raises(NoReplyError) as caught:
        bus.ping(4, attempts=2)
    assert caught.value.heard is heard
    assert caught.value.damaged == (heard is Heard.DAMAGED)
    assert str(caught.value.found) == f"{heard.value} in 2 attempts"


# --- in the cycle ----------------------------------------------------------------------------------------------------


def test_a_line_that_garbles_every_reply_is_that_and_not_silence() -> None:
    rig, _ = running()
    spoil_checksums(rig)
    error = cycles(rig, 12)[-1]
    assert isinstance(error, DxlServoFault)
    assert error.cause is FaultCause.GARBLED
    assert "damaged packets in each" in str(error.found)
    assert "plugs" in error.remedy


def test_a_servo_that_falls_silent_after_some_damage_is_called_silent() -> None:
    rig, _ = running()
    spoil_checksums(rig, 5)
    cycles(rig, 3)
    rig.bus.tamper = None
    rig.fault(FaultKind.MUTE, 5)
    error = cycles(rig, 12)[-1]
    assert isinstance(error, DxlServoFault)
    assert (error.cause, error.servo_id) == (FaultCause.SILENT, 5)


def test_one_servo_whose_replies_are_garbled_is_not_called_silent() -> None:
    rig, _ = running()
    spoil_checksums(rig, 5)
    error = cycles(rig, 12)[-1]
    assert isinstance(error, DxlServoFault)
    assert (error.cause, error.servo_id) == (FaultCause.GARBLED, 5)


@pytest.mark.parametrize("age", [0, 10])  # of the reply, cycles; requests are marked alike every 14
def test_a_port_that_repeats_an_old_reply_is_outdated_and_never_a_state(age: int) -> None:
    rig, port = running()
    rig.driver.read()
    old = port.last
    cycles(rig, age)
    port.repeats = old
    errors = cycles(rig, 60)
    assert None not in errors
    last = errors[-1]
    assert isinstance(last, DxlServoFault)
    assert last.cause is FaultCause.OUTDATED
    assert "old answers in the last" in str(last.found)
    assert "unplug and plug" in last.remedy
    states = [e.state for e in errors if isinstance(e, DxlServoFault)]
    assert len(states) > 40
    assert all(np.isnan(state.q).all() for state in states if state is not None)


@pytest.mark.parametrize("firmware", [44, 46])
@pytest.mark.parametrize(
    ("delay_ms", "servo_id"), [(5.0, None), (10.0, None), (16.0, None), (20.0, None), (5.0, 4), (10.0, 4), (16.0, 4)]
)
def test_an_adapter_that_holds_answers_back_is_named_before_its_servos(
    delay_ms: float, servo_id: int | None, firmware: int
) -> None:
    rig = build(firmware=firmware, timing=BusTiming())
    rig.driver.connect()
    rig.driver.enable()
    cycles(rig, 20)
    rig.fault(FaultKind.DELAY, servo_id, delay_ms=delay_ms)
    first = next(error for error in cycles(rig, 12) if isinstance(error, DxlServoFault))
    assert first.cause is FaultCause.OUTDATED
    assert "unplug and plug" in first.remedy


@pytest.mark.parametrize(("delay_ms", "servo_id"), [(45.0, None), (20.0, 4)])
def test_an_answer_so_late_that_its_servo_was_called_silent_explains_that_later(
    delay_ms: float, servo_id: int | None
) -> None:
    rig = build(timing=BusTiming())
    rig.driver.connect()
    rig.driver.enable()
    cycles(rig, 20)
    rig.fault(FaultKind.DELAY, servo_id, delay_ms=delay_ms)
    causes = [error.cause for error in cycles(rig, 20) if isinstance(error, DxlServoFault)]
    assert (causes[0], causes[-1]) == (FaultCause.SILENT, FaultCause.OUTDATED)
    assert "no answer of this cycle comes from it; it looked like: does not answer" in [e.text for e in rig.events]


@pytest.mark.parametrize("firmware", [44, 46])
@pytest.mark.parametrize("servo_id", [None, 1, 4, 7])
def test_a_servo_that_is_silent_is_not_put_down_to_the_adapter(servo_id: int | None, firmware: int) -> None:
    rig = build(firmware=firmware, timing=BusTiming())
    rig.driver.connect()
    rig.driver.enable()
    cycles(rig, 20)
    rig.fault(FaultKind.SILENT, servo_id)
    assert {error.cause for error in cycles(rig, 60) if isinstance(error, DxlServoFault)} == {FaultCause.SILENT}


def test_a_port_that_works_again_after_repeating_gives_fresh_states() -> None:
    rig, port = running()
    rig.driver.read()
    port.repeats = port.last
    assert None not in cycles(rig, 5)
    port.repeats = None
    assert cycles(rig, 10)[1:] == [None] * 9


# --- a servo that restarts ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("servo_id", [1, 2, 3, 6])
def test_a_servo_that_restarts_is_silent_while_it_boots_and_restarted_from_then_on(servo_id: int) -> None:
    rig, _ = running(servo_options=ServoOptions(boot_ns=100_000_000))
    rig.fault(FaultKind.REBOOT, servo_id)
    errors = cycles(rig, 60)
    causes = [error.cause for error in errors if isinstance(error, DxlServoFault)]
    assert causes[0] is FaultCause.SILENT
    assert causes[-1] is FaultCause.REBOOTED
    last = errors[-1]
    assert isinstance(last, DxlServoFault)
    assert last.servo_id == servo_id
    assert NO_POWER in last.remedy
    assert [fault.cause for fault in rig.driver.faults] == [FaultCause.REBOOTED]
    explained = [event for event in rig.events if event.kind.name == "EXPLAINED"]
    assert [(event.servo_id, event.text) for event in explained] == [
        (servo_id, "rebooted: its RAM registers are back at their defaults; it looked like: does not answer")
    ]


@pytest.mark.fault("S4")
def test_a_dip_of_the_supply_ends_in_restarted_for_every_servo() -> None:
    rig, _ = running(servo_options=ServoOptions(boot_ns=100_000_000))
    rig.fault(FaultKind.POWER_LOSS, duration_s=0.02)
    errors = cycles(rig, 80)
    assert isinstance(errors[-1], DxlServoFault)
    assert {fault.cause for fault in rig.driver.faults} == {FaultCause.REBOOTED}
    assert sorted(fault.servo_id for fault in rig.driver.faults) == [1, 2, 3, 4, 5, 6, 7]
    assert [rig.get(i, table.TORQUE_ENABLE) for i in range(1, 8)] == [0] * 7


def test_a_servo_that_stays_silent_stays_called_so() -> None:
    rig, _ = running()
    rig.fault(FaultKind.SILENT, 5)
    errors = cycles(rig, 60)
    assert isinstance(errors[-1], DxlServoFault)
    assert [(fault.cause, fault.servo_id) for fault in rig.driver.faults] == [(FaultCause.SILENT, 5)]


def test_a_fault_explains_only_what_happened_to_the_same_servo() -> None:
    def fault(cause: FaultCause, servo_id: int = 1) -> DxlServoFault:
        return DxlServoFault(cause, servo_id=servo_id, joint="j", found="", expected="")

    assert fault(FaultCause.REBOOTED).explains(fault(FaultCause.SILENT))
    assert not fault(FaultCause.REBOOTED).explains(fault(FaultCause.SILENT, 2))
    assert not fault(FaultCause.SILENT).explains(fault(FaultCause.REBOOTED))
    assert fault(FaultCause.HARDWARE_ERROR).explains(fault(FaultCause.TORQUE_LOST))
    assert not fault(FaultCause.REBOOTED).explains(fault(FaultCause.HARDWARE_ERROR))
    known = [fault(c, i) for c, i in ((FaultCause.SILENT, 2), (FaultCause.SILENT, 1), (FaultCause.NO_EFFECT, 3))]
    known.append(fault(FaultCause.NO_EFFECT, 1))
    merged, explained = fault(FaultCause.REBOOTED, 1).among(known)
    assert [(f.cause, f.servo_id) for f in merged] == [
        (FaultCause.SILENT, 2), (FaultCause.REBOOTED, 1), (FaultCause.NO_EFFECT, 3),
    ]  # fmt: skip
    assert explained == [known[1], known[3]]
    assert fault(FaultCause.REBOOTED, 4).among(known)[0][-1].servo_id == 4
    assert len(fault(FaultCause.REBOOTED, 4).among(known)[0]) == 5


@pytest.mark.parametrize("startup", [1, 3])
def test_a_servo_that_comes_back_with_torque_of_its_own_is_still_seen_to_have_restarted(startup: int) -> None:
    """Connect refuses such a servo; this one was changed behind its back, and its backup has the driver's mapping."""
    rig, _ = running(servo_options=ServoOptions(boot_ns=100_000_000))
    rig.put(4, table.STARTUP_CONFIGURATION, startup)
    firmware = rig.servo(4).firmware
    firmware.backup.store(firmware.memory)
    rig.fault(FaultKind.POWER_LOSS, 4, duration_s=0.02)
    errors = cycles(rig, 80)
    assert rig.get(4, table.TORQUE_ENABLE) == 1
    assert isinstance(errors[-1], DxlServoFault)
    assert [(fault.cause, fault.servo_id) for fault in rig.driver.faults] == [(FaultCause.REBOOTED, 4)]
