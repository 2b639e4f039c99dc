"""Judge the servos of an arm: who is on the line and what does not fit them, by the rules that connect refuses by.

`look` pings and reads; `judge` computes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from agent.motors.find import listen_s
from agent.verify.finding import Finding, Verdict, from_refusal
from drivers.dynamixel.arm_map import ArmMap, JointRole
from drivers.dynamixel.identify import survey
from drivers.dynamixel.line.bus import Bus
from drivers.dynamixel.servo import judge as rules
from drivers.dynamixel.servo.found import Consequence, Misfit, Rule, ServoFound
from drivers.dynamixel.servo.kept import KEPT_RAM
from drivers.dynamixel.servo.table import MOVING_THRESHOLD, PRESENT_INPUT_VOLTAGE, PRESENT_POSITION, PRESENT_TEMPERATURE
from drivers.dynamixel.servo.units import AngleScale, volts

VERDICTS = {
    Consequence.NO_CONNECTION: Verdict.REFUSED,
    Consequence.NO_TORQUE: Verdict.REFUSED,
    Consequence.MOVE_FIRST: Verdict.WARNING,  # a state, which a hand puts right, and no defect
    Consequence.MENDED: Verdict.WARNING,
    Consequence.ROUTINE: Verdict.OK,
    Consequence.TOLERATED: Verdict.WARNING,
}
Servos = Sequence[ServoFound]


@dataclass(frozen=True, slots=True)
class Section:
    """Rules that share one line while all of them hold; `found` and `wanted` are that line's."""

    title: str
    rules: tuple[Rule, ...]
    found: Callable[[Servos], str]
    wanted: Callable[[Servos], str]


def look(bus: Bus, arm: ArmMap) -> tuple[list[Finding], Servos]:
    """Find the arm's servos and all others; findings about who is there, and the servos that could be read."""
    line = survey(bus, arm, listen_s(arm.baud))
    findings = [from_refusal(problem, arm.arm) for problem in line.problems]
    if not findings:
        ids = ", ".join(str(slot.servo_id) for slot in arm.slots)
        findings.append(Finding("servos", arm.arm, f"{len(line.servos)}, IDs {ids}", "those of the arm file"))
    return findings, line.servos


def judge(arm: ArmMap, servos: Servos, started: ArmMap | None = None) -> list[Finding]:
    """All findings about the servos themselves; a section without any is one line that says how they are.

    started: the same arm as a start without its session expects it, a pose that will do as well.
    """
    if not servos:
        return []
    misfits = [misfit for servo in servos for misfit in rules.judge(servo)]
    if started is not None and any(misfit.rule is rules.REST for misfit in misfits):
        elsewhere = _expected_by(started, servos)
        if all(rules.broken(rules.POSE, servo) is None for servo in elsewhere):
            return judge(started, elsewhere)
        misfits = [_naming(started, misfit) for misfit in misfits]
    findings = []
    unasked = rules.POSE if any(servo.slot.joint.at_rest for servo in servos) else rules.REST
    for section in SECTIONS:
        if unasked in section.rules:
            continue
        wrong = _findings(arm, [m for m in misfits if m.rule in section.rules])
        fine = Finding(section.title, arm.arm, section.found(servos), section.wanted(servos))
        findings += wrong or [fine]
    return findings


def _expected_by(arm: ArmMap, servos: Servos) -> Servos:
    slots = {slot.servo_id: slot for slot in arm.slots}
    return [replace(servo, slot=slots[servo.slot.servo_id]) for servo in servos]


def _naming(started: ArmMap, misfit: Misfit) -> Misfit:
    """Where the joint is not at its rest, with the other place at which it may be."""
    if misfit.rule is not rules.REST:
        return misfit
    joint = next(joint for joint in started.joints if joint.name == misfit.slot.joint.name)
    low, high = rules.pose_range_rad(joint)
    remedy = f"{misfit.said.remedy}, or, where that is without --whole, to {low:.3f} to {high:.3f} rad, the start pose"
    return replace(misfit, said=misfit.said._replace(remedy=remedy))


def _findings(arm: ArmMap, misfits: Sequence[Misfit]) -> list[Finding]:
    """One line per rule and what it says, whichever servos it says it of; nothing for what is in order."""
    said: dict[tuple[Rule, object], list[Misfit]] = {}
    for misfit in misfits:
        if VERDICTS[misfit.rule.consequence] is not Verdict.OK:
            said.setdefault((misfit.rule, misfit.said), []).append(misfit)
    findings = []
    for same in said.values():
        first = same[0]
        what = first.what if len(same) == 1 else f"servo {_ids(same)}: {first.rule.name}"
        verdict = VERDICTS[first.rule.consequence]
        findings.append(Finding(what, arm.arm, first.said.found, first.said.expected, verdict, first.said.remedy))
    return findings


def _ids(some: Sequence[Misfit] | Servos) -> str:
    return ", ".join(str(one.slot.servo_id) for one in some)


def _versions(servos: Servos) -> str:
    return ", ".join(str(version) for version in sorted({servo.firmware for servo in servos}))


def _least_firmware(servos: Servos) -> str:
    return f"{max(servo.slot.model.watchdog_min_firmware or 0 for servo in servos)} or newer"


def _supply(servos: Servos) -> str:
    supplies = [volts(servo.value(PRESENT_INPUT_VOLTAGE)) for servo in servos]
    return f"{min(supplies):.1f} to {max(supplies):.1f} V"


def _hottest(servos: Servos) -> str:
    hottest = max(servos, key=lambda servo: servo.value(PRESENT_TEMPERATURE))
    return f"{hottest.value(PRESENT_TEMPERATURE)} °C at most ({hottest.slot.title})"


def _eeprom(servos: Servos) -> str:
    others = [servo for servo in servos if rules.broken(rules.MODE, servo) is not None]
    return "as the arm needs it" + (f"; the agent will set Operating Mode of servo {_ids(others)}" if others else "")


def _pose(servos: Servos) -> str:
    slots = [s for s in servos if not s.slot.shadow and s.slot.joint.role is not JointRole.GRIPPER]
    angles = {s.slot.joint.name: AngleScale(s.slot.joint).angle_rad(s.value(PRESENT_POSITION)) for s in slots}
    return ", ".join(f"{name} {angle:.2f}" for name, angle in angles.items()) + " rad"


def _mark(servos: Servos) -> str:
    return ", ".join(str(mark) for mark in sorted({servo.value(MOVING_THRESHOLD) for servo in servos}))


def _wanted_mark(servos: Servos) -> str:
    mark = servos[0].slot.mark
    return mark.wanted if mark.known else "any: this cell has no marks"


def _text(words: str) -> Callable[[Servos], str]:
    return lambda _: words


SECTIONS = (
    Section("firmware", (rules.MODEL, rules.FIRMWARE, rules.FAST_READ), _versions, _least_firmware),
    Section("mark", (rules.MARK,), _mark, _wanted_mark),
    Section("supply", (rules.SUPPLY, rules.RATED_SUPPLY), _supply, _text("near 12 V and within the servos' limits")),
    Section("temperature", (rules.HEAT, rules.WARMTH), _hottest, _text("5 °C below the servo's limit")),
    Section("hardware errors", (rules.HARDWARE,), _text("none"), _text("none")),
    Section(
        "bus watchdog and answers", (rules.WATCHDOG, rules.RETURN_LEVEL),
        _text("not fired, everything answered"), _text("as after power-up"),
    ),
    Section("torque", (rules.TORQUE,), _text("off"), _text("off")),
    Section(
        "EEPROM",
        (
            rules.DIRECTION, rules.DRIVE_BITS, rules.SECONDARY, rules.HOMING, rules.STARTUP, rules.CURRENT_LIMIT,
            rules.PWM_NEEDED, rules.MODE, rules.RETURN_DELAY, rules.PWM_LIMIT, rules.LOW_LIMIT, rules.HIGH_LIMIT,
            rules.SHUTDOWN, rules.HEAT_LIMIT,
        ),
        _eeprom, _text("the arm file's directions, shadows and limits"),
    ),
    Section("RAM beside the goals", KEPT_RAM, _text("as a change of mode leaves it"), _text("the same")),
    Section("start pose", (rules.POSE,), _pose, _text("the cell's start pose")),
    Section("rest pose", (rules.REST,), _pose, _text("the cell's rest pose")),
)  # fmt: skip
