"""From which values on the monitors of the arms hold them, as findings: per arm, and what all arms of a cell share."""

from __future__ import annotations

from collections.abc import Sequence

from agent.config.cell import Cell
from agent.monitors.body import LIMITED_TICKS
from agent.monitors.bounds import Bounds, Name
from agent.verify.finding import Finding, Verdict


def watched(cell: Cell, each: Sequence[Bounds]) -> list[Finding]:
    """Bounds of every monitor that is on, one set per arm, and the names of those that the cell switches off."""
    what = "a monitor holds an arm"
    found = [
        Finding(f"{what}: {name.value}", arm.name, text, "")
        for arm, bounds in zip(cell.arms, each, strict=True)
        for name, text in _own(bounds)
        if name in bounds.watched
    ]
    found += [Finding(f"{what}: {name.value}", "cell", text, "") for name, text in _shared(each[0])]
    off = [name.value for name in Name if name not in each[0].watched]
    if off:
        remedy = "shorten safety.monitors.off: nobody watches these"
        found.append(Finding("monitors switched off", "cell", ", ".join(off), "none", Verdict.WARNING, remedy))
    return found


def _own(b: Bounds) -> list[tuple[Name, str]]:
    """What differs from arm to arm."""
    ranges = zip(b.joints, b.position_rad, strict=True)
    position = ", ".join(f"{joint} {low:.2f} to {high:.2f}" for joint, (low, high) in ranges)
    return [
        (Name.SPEED, f"above {_each(b, b.speed_rad_per_s)} rad/s"),
        (Name.POWER, f"above {_each(b, b.power_W)} W"),
        (Name.POSITION, f"beyond {position} rad"),
        (Name.FROZEN, f"a reading that stays over {b.frozen_rad:g} rad of motion, at {_each(b, b.frozen_Nm)} N·m"),
    ]


def _shared(b: Bounds) -> list[tuple[Name, str]]:
    """What is the same for all arms of a cell."""
    box = ", ".join(f"{a} {low:.3g} to {high:.3g}" for a, (low, high) in zip("xyz", b.workspace_m, strict=True))
    limited = f"in more than {b.limited_share * LIMITED_TICKS:.0f} of {LIMITED_TICKS} cycles"
    load = f"above {b.load_share:.0%} of stall in the mean of {b.load_time_s:g} s"
    fx, fy, fz, mx, my, mz = (f"{x:.2g}" for x in b.gravity)
    every = [
        (Name.START, f"before the motion, object more than {b.start_m * 1e3:g} mm or {b.start_rad * 1e3:g} mrad off"),
        (Name.WORKSPACE, f"object outside {box} m"),
        (Name.SATURATED, f"torque at its limit {limited}"),
        (Name.RATE_LIMITED, f"torque step at its limit {limited}"),
        (Name.LOAD, load),
        (Name.GRAVITY, f"at rest above {fx}, {fy}, {fz} N, {mx}, {my}, {mz} N·m beside the files"),
        (Name.TEMPERATURE, f"less than {b.temperature_margin_C:g} °C below a servo's own limit"),
        (Name.VOLTAGE, f"less than {b.voltage_margin_V:g} V within a servo's own limits"),
        (Name.SERVO_LOAD, f"servo's current {load}"),
    ]
    return [(name, text) for name, text in every if name in b.watched]


def _each(b: Bounds, values: Sequence[float]) -> str:
    return ", ".join(f"{joint} {value:.2g}" for joint, value in zip(b.joints, values, strict=True))
