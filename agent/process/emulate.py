"""Emulated servos on pseudo terminals, moved by the plant of the cell: what the real driver runs against in tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from agent.config.cell import Arm, Cell
from agent.config.servo_map import GRIPPER, fingers_of, resting_joints
from agent.config.session import grip_width
from agent.host.ready_line import pairs
from agent.host.signals import StopFlag
from agent.process.befallen import require_done
from agent.process.common_start import CommonStart
from agent.process.plant import Truth
from agent.process.rehearse import in_the_loop
from agent.process.simulated import lone_spec, plant_spec
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import PLANT_STATE
from agent.telemetry.row.topics import PLANT
from agent.verify.check import examine
from drivers.clock import MonotonicClock
from drivers.fingers import Fingers
from drivers.interface import Refusal, Vector
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.faults import read_lines
from sim_backend.wire.lone_world import emulate_alone
from sim_backend.wire.plant_world import PlantWorld, emulate
from sim_backend.wire.serve import ServeOptions, Server, serve
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.whole_world import WholeWorld
from sim_backend.wire.wiring import ArmWiring, wire_arm

Begin = Callable[
    [Cell, Sequence[Vector], BusTiming | None], tuple[EmulatedCell, PlantWorld] | tuple[EmulatedCell, WholeWorld]
]


class EmulateError(Refusal):
    """Ports, faults or control socket of the emulated servos cannot be used."""


def wiring(arm: Arm, index: int, baud: int) -> ArmWiring:
    """The servos of an arm as its file describes them, with the mark that the cell gives it."""
    joints = resting_joints(arm.file)
    return wire_arm(
        arm.name, joints, arm.entry.controlled, baud=baud, plant_arm=index, start_rad=dict(arm.entry.locked_rad),
        mark=arm.entry.mark,
    )  # fmt: skip


def require_faults(path: Path, arms: Sequence[Arm]) -> None:
    """Raise FaultError unless the file can be read and is about servos of these arms."""
    joints = {arm.name: wiring(arm, 0, arm.baud).joints for arm in arms}
    read_lines(
        path, {name: {wired.servo_id for joint in each for wired in joint.servos} for name, each in joints.items()}
    )


def run_emulate_alone(
    cell: Cell, options: ServeOptions, *, timing: bool, stop: StopFlag, ready: Callable[[str], None]
) -> str:
    """Serve the arms that [hil] or [floating] names, each on its own and holding nothing.

    Arguments and errors as of `run_emulate`.
    """
    report = examine(cell)
    report.require()
    floating = cell.file.floating.arms if cell.file.floating is not None else ()
    chosen = [(i, a) for i, a in enumerate(cell.arms) if in_the_loop(cell, a.name) or a.name in floating]
    require_done(cell, stops=True, alone=[arm.name for _, arm in chosen])
    arms = [(i, wiring(arm, place, arm.baud)) for place, (i, arm) in enumerate(chosen)]
    emulated, _ = emulate_alone(lone_spec(cell, report.q_start), arms, timing=BusTiming() if timing else None)
    ports = {arm.name: options.ports[arm.name] for _, arm in chosen}
    server = _served(emulated, replace(options, ports=ports), stop, lambda: ready(pairs(arms=",".join(ports))))
    return f"emulator: {server.laps} laps, arms on their own"


def gripping(cell: Cell, q_start: Sequence[Vector], timing: BusTiming | None) -> tuple[EmulatedCell, PlantWorld]:
    """Emulated arms that begin with the object in their grippers.  Raises PlantError."""
    arms = [wiring(arm, i, arm.baud) for i, arm in enumerate(cell.arms)]
    return emulate(plant_spec(cell, q_start), arms, timing=timing)


def about_the_object(
    cell: Cell, q_start: Sequence[Vector], timing: BusTiming | None
) -> tuple[EmulatedCell, PlantWorld]:
    """The same, with grippers that stand open about the object and can close on it: of arms that float with it.

    Raises ConfigError, PlantError.
    """
    arms = [_about(arm, wiring(arm, i, arm.baud)) for i, arm in enumerate(cell.arms)]
    emulated, world = emulate(plant_spec(cell, q_start), arms, timing=timing)
    for arm, hand in zip(cell.arms, (one.gripper for one in emulated.arms), strict=True):
        if hand is not None and hand.fingers is not None:
            hand.blocked_rad = hand.fingers.angle(grip_width(cell, arm))
    return emulated, world


def with_fingers(wired: ArmWiring, fingers: Fingers, start_rad: float = 0.0) -> ArmWiring:
    """The same arm with a gripper that closes on things; start_rad: angle of its horn when power comes."""
    joints = (replace(j, fingers=fingers, start_rad=start_rad) if j.name == GRIPPER else j for j in wired.joints)
    return replace(wired, joints=tuple(joints))


def _about(arm: Arm, wired: ArmWiring) -> ArmWiring:
    fingers = fingers_of(arm.file)
    return wired if fingers is None else with_fingers(wired, fingers, fingers.open_rad)


def run_emulate(
    cell: Cell,
    options: ServeOptions,
    ring: Path,
    *,
    timing: bool,
    stop: StopFlag,
    ready: Callable[[str], None],
    begin: Begin = gripping,
    common_start: Path | None = None,
    utc_offset_ns: int | None = None,
    stops: bool = False,
) -> str:
    """Serve the emulated arms until a stop; returns one line about the run.

    options: ports, faults and control socket; what becomes of a tick is added.  timing: False answers at once, not at
    the pace of the bus.  begin: how the arms begin.  common_start: where the run will say when the trajectory
    starts.  utc_offset_ns: UTC minus CLOCK_MONOTONIC as the run has found it;
    None: as it is now.  stops: as of `run_plant`.  ready: told once faults are read and ports are there.  Raises
    Refusal.
    """
    require_done(cell, stops=stops)
    report = examine(cell)
    report.require()
    emulated, world = begin(cell, report.q_start, BusTiming() if timing else None)
    with RingWriter(ring, PLANT_STATE, PLANT) as rows:
        offset_ns = MonotonicClock(utc_offset_ns).utc_offset_ns
        truth = Truth(rows, world.plant, cell, offset_ns, lockstep=False)
        start = CommonStart(common_start, world.plant, cell, offset_ns)

        def on_tick(now_ns: int) -> None:
            truth.write(rows.written, now_ns, world.observe())

        def stopped() -> bool:  # asked before every lap
            start.look(emulated.time_ns)
            return stop()

        every_ns = round(1e9 / cell.file.simulation.observe_rate_hz)
        try:
            ticking = replace(options, on_tick=on_tick, tick_ns=every_ns)
            server = _served(emulated, ticking, stopped, lambda: ready(pairs(ring=ring)))
        finally:
            rows.finish()
        return f"emulator: {server.laps} laps, {rows.written} observations"


def _served(
    emulated: EmulatedCell, options: ServeOptions, stop: Callable[[], bool], ready: Callable[[], None]
) -> Server:
    """Serve until a stop.  Raises EmulateError, FaultError, PortTakenError."""
    try:
        return serve(emulated, options, stop, ready)
    except (OSError, UnicodeDecodeError) as error:
        raise EmulateError(
            "ports, faults file or control socket of the emulated servos",
            found=error,
            expected="a folder for the ports, and files that can be used",
            remedy="name others with --ports, --faults or --control",
        ) from error
