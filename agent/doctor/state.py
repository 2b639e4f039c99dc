"""Judge what servos said of themselves: firmware, supply, heat, errors, torque, EEPROM, pose.  Pure; asks no bus."""

from __future__ import annotations

from collections.abc import Sequence

from agent.doctor.servos import ServoState
from agent.motors.wanted import misfits
from agent.verify.finding import Finding, Verdict, judged, refused, warning
from drivers.dynamixel.arm_map import ArmMap, JointRole
from drivers.dynamixel.errors import hardware_names
from drivers.dynamixel.servo.table import (
    BUS_WATCHDOG,
    HARDWARE_ERROR_STATUS,
    MAX_VOLTAGE_LIMIT,
    MIN_VOLTAGE_LIMIT,
    OPERATING_MODE,
    PRESENT_INPUT_VOLTAGE,
    PRESENT_POSITION,
    PRESENT_TEMPERATURE,
    RATED_VOLTAGE_V,
    TEMPERATURE_LIMIT,
    TORQUE_ENABLE,
    VOLTAGE_UNIT_V,
    WATCHDOG_TRIPPED,
    HardwareError,
    Register,
)
from drivers.dynamixel.servo.thermal import MARGIN_C
from drivers.dynamixel.servo.units import AngleScale

SUPPLY_TOLERANCE = 0.08  # of the 12 V that torque constants are rated at


def judge(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    """All findings about the servos' own state."""
    if not states:
        return []
    findings = [*_firmware(arm, states), *_supply(arm, states), *_heat(arm, states), *_errors(arm, states)]
    return [*findings, *_torque(arm, states), *_eeprom(arm, states), *_pose(arm, states)]


def _value(state: ServoState, register: Register) -> int:
    return state.values.get(register.name, 0)


def _firmware(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    findings = []
    for state in states:
        least = max(arm.firmware_min, state.slot.model.watchdog_min_firmware or 0)
        if state.firmware < least:
            wanted, remedy = f"{least} or newer (bus watchdog)", "update it with DYNAMIXEL Wizard 2.0"
            findings.append(refused(f"{state.name}: firmware", arm.arm, str(state.firmware), wanted, remedy))
    if findings:
        return findings
    slow = [s for s in states if (fast := s.slot.model.fast_sync_min_firmware) is not None and s.firmware < fast]
    if slow:
        found = "older than fast sync read in servo " + ", ".join(str(s.slot.servo_id) for s in slow)
        remedy = "every cycle takes longer, see below; update them with DYNAMIXEL Wizard 2.0"
        return [warning("firmware", arm.arm, found, "45 or newer", remedy)]
    versions = ", ".join(str(v) for v in sorted({s.firmware for s in states}))
    return [Finding("firmware", arm.arm, versions, f"{arm.firmware_min} or newer")]


def _supply(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    findings = []
    volts = [_value(s, PRESENT_INPUT_VOLTAGE) * VOLTAGE_UNIT_V for s in states]
    for state, now in zip(states, volts, strict=True):
        low, high = (_value(state, r) * VOLTAGE_UNIT_V for r in (MIN_VOLTAGE_LIMIT, MAX_VOLTAGE_LIMIT))
        if not low <= now <= high:
            wanted, remedy = f"{low:.1f} to {high:.1f} V, its own limits", "check the 12 V supply and its cable"
            findings.append(refused(f"{state.name}: supply", arm.arm, f"{now:.1f} V", wanted, remedy))
    if findings:
        return findings
    near, far = (RATED_VOLTAGE_V * (1.0 + sign * SUPPLY_TOLERANCE) for sign in (-1.0, 1.0))
    return [
        judged(
            "supply", arm.arm, f"{min(volts):.1f} to {max(volts):.1f} V", f"{near:.1f} to {far:.1f} V",
            holds=near <= min(volts) and max(volts) <= far, otherwise=Verdict.WARNING,
            remedy="torques are rated at 12 V: check the supply, and the cable where one servo has less than the rest",
        )
    ]  # fmt: skip


def _heat(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    hottest = max(states, key=lambda s: _value(s, PRESENT_TEMPERATURE) - _value(s, TEMPERATURE_LIMIT))
    now, limit = (_value(hottest, r) for r in (PRESENT_TEMPERATURE, TEMPERATURE_LIMIT))
    return [
        judged(
            "temperature", arm.arm, f"{now} °C at most ({hottest.name})", f"below {limit - MARGIN_C:g} °C",
            holds=now < limit - MARGIN_C, remedy=f"let it cool down: it switches itself off at {limit} °C",
            otherwise=Verdict.REFUSED if now >= limit else Verdict.WARNING,
        )
    ]  # fmt: skip


def _errors(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    findings = []
    for state in states:
        bits = HardwareError(_value(state, HARDWARE_ERROR_STATUS))
        if bits:
            what, remedy = f"{state.name}: hardware error", "remove the cause, then switch its supply off and on"
            findings.append(refused(what, arm.arm, hardware_names(bits), "none", remedy))
        if _value(state, BUS_WATCHDOG) in (WATCHDOG_TRIPPED, WATCHDOG_TRIPPED & 0xFF):
            what, remedy = f"{state.name}: bus watchdog", "the agent clears it before torque comes on"
            found = "fired: the last program did not end as it should"
            findings.append(warning(what, arm.arm, found, "not fired", remedy))
    return findings or [Finding("hardware errors", arm.arm, "none", "none")]


def _torque(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    on = ", ".join(str(s.slot.servo_id) for s in states if _value(s, TORQUE_ENABLE))
    return [
        judged(
            "torque", arm.arm, f"on in servo {on}" if on else "off", "off", holds=not on,
            remedy="another program may hold this arm: support it, stop that program, switch the supply off and on",
        )
    ]  # fmt: skip


def _eeprom(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    findings = [
        Finding(f"{s.name}: {m.register.name}", arm.arm, m.found, m.wanted, m.verdict, m.remedy)
        for s in states
        for m in misfits(s.slot, s.values)
    ]
    modes = [s for s in states if _value(s, OPERATING_MODE) != s.slot.joint.mode]
    text = "as the arm needs it"
    if modes:
        text += f"; the agent will set Operating Mode of servo {', '.join(str(s.slot.servo_id) for s in modes)}"
    return findings or [Finding("EEPROM", arm.arm, text, "the arm file's directions, shadows and limits")]


def _pose(arm: ArmMap, states: Sequence[ServoState]) -> list[Finding]:
    jointed = [s for s in states if not s.slot.shadow and s.slot.joint.role is not JointRole.GRIPPER]
    findings, found = [], []
    for state in jointed:
        joint = state.slot.joint
        angle = AngleScale(joint).angle_rad(_value(state, PRESENT_POSITION))
        low, high = joint.limits_rad
        if joint.start_rad is not None:
            low = max(low, joint.start_rad - joint.start_tolerance_rad)
            high = min(high, joint.start_rad + joint.start_tolerance_rad)
        found.append(f"{joint.name} {angle:.2f}")
        if not low <= angle <= high:
            wanted, remedy = f"{low:.3f} to {high:.3f} rad", "move the arm there by hand before the agent is started"
            findings.append(warning(f"start pose, {joint.name}", arm.arm, f"{angle:.3f} rad", wanted, remedy))
    return findings or [Finding("start pose", arm.arm, ", ".join(found) + " rad", "the cell's start pose")]
