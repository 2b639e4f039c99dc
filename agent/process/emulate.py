"""Emulated servos on pseudo terminals, moved by the plant of the cell: what the real driver runs against in tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from agent.config.cell import Arm, Cell
from agent.config.servo_map import resting_joints
from agent.host.signals import StopFlag
from agent.process.plant import RING_NAME, Truth
from agent.process.simulated import plant_spec
from agent.telemetry.ring.ring import RingWriter
from agent.telemetry.row.sample import PLANT_STATE
from agent.verify.check import examine
from drivers.interface import Refusal
from sim_backend.wire.plant_world import emulate
from sim_backend.wire.serve import ServeOptions, serve
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring, wire_arm


class EmulateError(Refusal):
    """Ports, faults or control socket of the emulated servos cannot be used."""


@dataclass(frozen=True)
class EmulateOptions:
    """How the emulated cell is served."""

    ports: Mapping[str, Path]  # arm -> path of its port
    ring: Path
    faults_file: Path | None
    control_socket: Path | None
    seed: int
    timing: bool  # False: every reply is available at once


def wiring(arm: Arm, index: int, baud: int) -> ArmWiring:
    """The servos of an arm as its file describes them."""
    joints = resting_joints(arm.file)
    return wire_arm(
        arm.name, joints, arm.entry.controlled, baud=baud, plant_arm=index, start_rad=dict(arm.entry.locked_rad)
    )


def run_emulate(cell: Cell, options: EmulateOptions, stop: StopFlag, ready: Callable[[str], None]) -> str:
    """Serve the emulated arms until a stop; returns one line about the run.  Raises Refusal."""
    report = examine(cell)
    report.require()
    arms = [wiring(arm, i, arm.baud) for i, arm in enumerate(cell.arms)]
    emulated, world = emulate(plant_spec(cell, report.q_start), arms, timing=BusTiming() if options.timing else None)
    with RingWriter(options.ring, PLANT_STATE, RING_NAME) as ring:
        truth = Truth(ring, world.plant, cell, lockstep=False)
        offset_ns = time.time_ns() - time.monotonic_ns()
        every_ns = round(1e9 / cell.file.simulation.observe_rate_hz)
        rows = 0

        def on_tick(now_ns: int) -> None:
            nonlocal rows
            truth.write(rows, now_ns, now_ns + offset_ns, world.observe())
            rows += 1

        try:
            ready(f"ring={options.ring}")
            server = serve(
                emulated,
                ServeOptions(
                    ports=options.ports,
                    faults_file=options.faults_file,
                    control_socket=options.control_socket,
                    seed=options.seed,
                    on_tick=on_tick,
                    tick_ns=every_ns,
                ),
                _Stop(stop),
            )
        except (OSError, UnicodeDecodeError) as error:
            raise EmulateError(
                "ports, faults file or control socket of the emulated servos",
                found=error,
                expected="a folder for the ports, and files that can be used",
                remedy="name others with --ports, --faults or --control",
            ) from error
        finally:
            ring.finish()
    return f"emulator: {server.laps} laps, {rows} observations"


class _Stop:
    """The stop flag as the server asks for it."""

    def __init__(self, stop: StopFlag) -> None:
        self._stop = stop

    def is_set(self) -> bool:
        """Whether a stop was asked for."""
        return self._stop()
