"""What `coop check` says of the monitors: the bounds that the agents keep, and those that a cell switches off."""

from __future__ import annotations

from pathlib import Path

from agent.config.cell import Cell, load_cell
from agent.config.monitors import bounds, bounds_of_all
from agent.monitors.bounds import Name
from agent.verify import watched as module
from agent.verify.check import examine
from agent.verify.finding import Finding, Verdict

CELL = Path("two_wx200")


def watched(cell: Cell) -> list[Finding]:
    return module.watched(cell, bounds_of_all(cell))


def found_in(findings: list[Finding], name: Name, where: str = "cell") -> str:
    (found,) = (f for f in findings if f.what == f"a monitor holds an arm: {name.value}" and f.where == where)
    assert found.verdict is Verdict.OK
    return found.found


def test_every_monitor_is_there_with_the_bounds_that_the_agents_keep() -> None:
    cell = load_cell(CELL, ["safety.monitors.speed_share=0.3", "safety.monitors.load_time_s=12.0"])
    findings, own = watched(cell), bounds(cell, cell.arms[1])
    assert {f.what.partition(": ")[2] for f in findings} == {name.value for name in Name}
    speeds = ", ".join(f"{j} {x:.2g}" for j, x in zip(own.joints, own.speed_rad_per_s, strict=True))
    assert found_in(findings, Name.SPEED, "right") == f"above {speeds} rad/s"
    powers = ", ".join(f"{j} {x:.2g}" for j, x in zip(own.joints, own.power_W, strict=True))
    assert found_in(findings, Name.POWER, "left") == f"above {powers} W"
    assert found_in(findings, Name.POSITION, "left").startswith("beyond shoulder -1.86 to 1.95, elbow ")
    assert "0.02 rad of motion, at shoulder 0.6" in found_in(findings, Name.FROZEN, "left")
    assert found_in(findings, Name.START) == "before the motion, object more than 20 mm or 100 mrad off"
    assert found_in(findings, Name.WORKSPACE) == "object outside x 0.075 to 0.375, y -0.1 to 0.1, z 0.15 to 0.35 m"
    assert found_in(findings, Name.SATURATED) == "torque at its limit in more than 50 of 100 cycles"
    assert found_in(findings, Name.RATE_LIMITED).startswith("torque step at its limit in more than 50")
    assert found_in(findings, Name.LOAD) == "above 45% of stall in the mean of 12 s"
    assert found_in(findings, Name.SERVO_LOAD).startswith("servo's current above 45% of stall")
    x, _, _, _, turn, _ = own.gravity
    assert found_in(findings, Name.GRAVITY).startswith(f"at rest above {x:.2g}, ")
    assert f" {turn:.2g}, " in found_in(findings, Name.GRAVITY)
    assert found_in(findings, Name.TEMPERATURE).startswith("less than 2 °C below")
    assert found_in(findings, Name.VOLTAGE).startswith("less than 0.2 V within")


def test_what_a_cell_switches_off_is_warned_of() -> None:
    findings = watched(load_cell(CELL, ["safety.monitors.off=['load', 'speed']"]))
    (off,) = (f for f in findings if f.verdict is Verdict.WARNING)
    assert (off.what, off.found) == ("monitors switched off", "speed, load")
    assert not [f for f in findings if f.what.endswith((": speed", ": load"))]


def test_a_thorough_check_has_them() -> None:
    cell = load_cell(CELL)
    told = {f.what for f in examine(cell, thorough=True).findings}
    assert {f.what for f in watched(cell)} <= told
    assert not [f for f in examine(cell).findings if f.what.startswith("a monitor holds")]
