"""What is wrong with a cell's arms, buses and host?  Looks and measures; `move_arm` alone switches torque."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.servo_map import arm_map
from agent.config.session import rest_joints
from agent.doctor import cycle, host, servos
from agent.doctor.certificates import FOLDER, certificates
from agent.doctor.cycle import CycleFigures
from agent.doctor.move import first_motion, map_of
from agent.doctor.port import before_opening, latency_timer
from agent.host.info import versions
from agent.motors.line import refuse_noise
from agent.telemetry.row.sample import AGENT_STATE
from agent.verify.check import examine
from agent.verify.finding import Finding, Verdict, exit_code, from_refusal, refused, warning, worst
from drivers.clock import MonotonicClock
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.line.bus import Bus, DxlCounters
from drivers.dynamixel.line.port import Port, SerialPort
from drivers.interface import Clock, DriverError, Refusal, Vector

SCHEMA = 1
LOG_MARGIN = 1.2  # messages and indices of a log beside its rows

Tell = Callable[[str], None]


class MoveError(Refusal):
    """A first motion that is not asked for as it must be."""


@dataclass(frozen=True)
class DoctorOptions:
    """What to look at."""

    arms: Sequence[str]  # empty: all of the cell
    ports: Path | None = None  # folder with a port per arm, as `coop emulate` makes; None: the cell's
    logs: Path = Path("runs")


@dataclass
class Diagnosis:
    """All findings, and the figures behind those about timing."""

    cell: str
    fingerprint: str
    findings: list[Finding] = field(default_factory=list)
    cycles: dict[str, CycleFigures] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """0: all ok; 1: warnings; 2: problems."""
        return exit_code(self.findings)

    def document(self) -> dict[str, Any]:
        """The whole for scripts; `schema` grows when a key changes its meaning."""
        return {
            "schema": SCHEMA,
            "cell": self.cell,
            "fingerprint": self.fingerprint,
            "verdict": worst(self.findings).value,
            "findings": [finding.document() for finding in self.findings],
            "cycles": {arm: _figures(figures) for arm, figures in self.cycles.items()},
        }


def diagnose(cell: Cell, options: DoctorOptions, tell: Tell) -> Diagnosis:
    """Look at the host, the cell file and each arm.  Raises ConfigError for an arm the cell does not have."""
    arms = [cell.arm(name) for name in options.arms] or list(cell.arms)
    out = Diagnosis(cell.file.name, cell.fingerprint)
    tell("looking at the host and the cell file")
    facts = host.read_facts(options.logs, ", ".join(f"{name} {v}" for name, v in versions().items()))
    out.findings += host.judge(facts, len(arms), _log_bytes(cell), cell.file.rate_hz)
    out.findings += certificates(FOLDER, datetime.now(UTC))
    starts = _examine_cell(cell, out)
    for arm in arms:
        tell(f"looking at arm {arm.name}")
        _examine_arm(cell, arm, starts.get(arm.name), options.ports, out)
    return out


def _examine_cell(cell: Cell, out: Diagnosis) -> dict[str, Vector]:
    """What `coop check` says, and the start configurations if there are any."""
    try:
        report = examine(cell, wired=True)
    except Refusal as error:
        out.findings.append(from_refusal(error, "cell"))
        return {}
    wrong = [
        replace(f, what=f"{f.what} ({f.where})", where="cell") for f in report.findings if f.verdict is not Verdict.OK
    ]
    fine = Finding("coop check", "cell", f"{len(report.findings)} checks", "no refusal")
    out.findings += wrong or [fine]
    return {arm.name: q for arm, q in zip(cell.arms, report.q_start, strict=True)}


def _examine_arm(cell: Cell, arm: Arm, q_start: Vector | None, ports: Path | None, out: Diagnosis) -> None:
    path = port_path(arm, ports)
    if path is None:
        remedy = 'add dynamixel = { port = "…" } to the arm in the cell file, or give --ports'
        out.findings.append(refused("port", arm.name, "none in the cell file", "the port of its servos", remedy))
        return
    q = q_start if q_start is not None else np.array(arm.entry.q_near_rad)
    try:
        found_map, started = maps_of(cell, arm, path, q)
    except DriverError as error:
        out.findings.append(from_refusal(error, arm.name))
        return
    found = before_opening(path, arm.name)
    out.findings += found
    if all(f.verdict is not Verdict.REFUSED for f in found):
        clock = MonotonicClock()
        examine_line(found_map, SerialPort(path, found_map.baud, clock), clock, out, started)


def maps_of(cell: Cell, arm: Arm, path: str, q_start: Vector) -> tuple[ArmMap, ArmMap]:
    """The arm as its first start expects it, at rest where the cell has a session, and as one at q_start (n,) does.

    Raises MapError.  Where nothing says how an arm of a session rests, `coop check` refuses the cell.
    """
    started = arm_map(cell, arm, path, q_start)
    rests = cell.file.session is not None and arm.rest_rad.keys() >= set(arm.entry.controlled)
    return arm_map(cell, arm, path, rest_joints(arm)) if rests else started, started


def port_path(arm: Arm, ports: Path | None) -> str | None:
    """Where the arm's servos are: in a folder of ports, or where the cell has them; None where it does not say."""
    if ports is not None:
        return str(ports / arm.name)
    return arm.entry.dynamixel.port if arm.entry.dynamixel else None


def move_arm(cell: Cell, options: DoctorOptions, ask: Callable[[str], bool], out: Diagnosis) -> None:
    """The first motion of the one arm that is asked for; nothing where something is wrong already.

    Raises MoveError where it is not one arm.
    """
    if len(options.arms) != 1:
        raise MoveError(
            "--move", found=f"{len(options.arms)} arms", expected="one: --arm NAME", remedy="one arm after the other"
        )
    arm = cell.arm(options.arms[0])
    path = port_path(arm, options.ports)
    if path is None or worst(out.findings) is Verdict.REFUSED:
        remedy = "put right what is refused above, then try again"
        out.findings.append(warning("first motion", arm.name, "not tried", "a sound arm", remedy))
        return
    clock = MonotonicClock()
    driver = DynamixelDriver(map_of(cell, arm, path), clock)
    out.findings += first_motion(cell, arm, driver, clock, ask)


def examine_line(arm: ArmMap, port: Port, clock: Clock, out: Diagnosis, started: ArmMap | None = None) -> None:
    """Open the port of an arm and look at everything behind it; the port is closed at the end.

    started: the arm where a start without its session expects it.
    """
    before_ms = port.latency_timer_ms
    try:
        port.open()
        out.findings.append(latency_timer(before_ms, port.latency_timer_ms, arm.arm))
        bus = Bus(port, clock, DxlCounters())
        refuse_noise(bus, arm.port, clock)
        _examine_servos(arm, bus, clock, out, started)
    except DriverError as error:
        out.findings.append(from_refusal(error, arm.arm))
    finally:
        port.close()


def _examine_servos(arm: ArmMap, bus: Bus, clock: Clock, out: Diagnosis, started: ArmMap | None) -> None:
    present, found = servos.look(bus, arm)
    out.findings += present
    out.findings += servos.judge(arm, found, started)
    if len(found) < len(arm.slots):
        remedy = "put right what is above, then run the doctor again"
        what, wanted = "cycle time", f"measured with all {len(arm.slots)} servos"
        out.findings.append(warning(what, arm.arm, f"not measured: {len(found)} servos can be read", wanted, remedy))
        return
    figures = cycle.measure(bus, arm, found, clock, bus.port.latency_timer_ms)
    out.cycles[arm.arm] = figures
    out.findings += cycle.judge(arm, figures)


def _figures(figures: CycleFigures) -> dict[str, Any]:
    budget = figures.budget
    return {
        "computed": {
            "request_s": budget.request_s, "reply_s": budget.reply_s, "usb_worst_s": budget.usb_worst_s,
            "read_quick_s": figures.computed_quick_s,
            "write_s": budget.write_s, "health_s": budget.health_s, "step_s": budget.step_s,
            "read_mean_s": budget.read_mean_s, "read_worst_s": budget.read_worst_s, "cycle_s": budget.cycle_s,
            "rate_max_hz": budget.rate_max_hz,
        },
        "measured": {
            "overhead_s": figures.overhead_s, "read_quick_s": figures.read_quick_s,
            "read_median_s": figures.read_median_s, "read_p99_s": figures.read_p99_s,
            "missed": figures.missed, "reads": figures.reads,
        },
        "fast_sync_read": figures.fast,
        "deviation": figures.deviation,
    }  # fmt: skip


def _log_bytes(cell: Cell) -> float:
    rows = cell.file.rate_hz * cell.file.duration_s * len(cell.arms)
    return LOG_MARGIN * rows * AGENT_STATE.dtype.itemsize
