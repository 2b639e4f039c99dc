"""The plant process: the only place where the arms meet, and the source of the truth in the log."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.config.cell import Cell
from agent.host.signals import StopFlag
from agent.process.simulated import plant_spec
from agent.telemetry.ring.ring import RingWriter
from agent.telemetry.row.sample import MAX_JOINTS, PLANT_STATE
from agent.verify.check import examine
from drivers.interface import Vector
from sim_backend.physics.plant import Observation, Plant
from sim_backend.served.server import ServerOptions, serve

RING_NAME = "plant"


@dataclass(frozen=True)
class PlantOptions:
    """How the plant is started."""

    socket: Path
    ring: Path
    lockstep: bool


def run_plant(cell: Cell, options: PlantOptions, stop: StopFlag, ready: Callable[[str], None]) -> str:
    """Serve the simulated cell until its arms have left; returns one line about the run.

    ready is called once the arms can connect.  Raises Refusal.
    """
    report = examine(cell)
    report.require()
    plant = Plant(plant_spec(cell, report.q_start))
    with RingWriter(options.ring, PLANT_STATE, RING_NAME) as ring:
        try:
            summary = serve(
                plant,
                ServerOptions(
                    socket_path=options.socket,
                    rate_hz=cell.file.rate_hz,
                    config_id=cell.config_id,
                    lockstep=options.lockstep,
                    observe_every=max(1, round(cell.file.rate_hz / cell.file.simulation.observe_rate_hz)),
                    stop=stop,
                ),
                on_tick=Truth(ring, plant, cell, options.lockstep),
                on_listening=lambda: ready(f"socket={options.socket} ring={options.ring}"),
            )
        finally:
            ring.finish()
    return (
        f"plant: {summary.ticks} ticks, {summary.sim_s:.2f} s simulated in {summary.wall_s:.2f} s, "
        f"{summary.real_time_factor:.1f} times real time, {summary.late_ticks} late"
    )


class Truth:
    """Writes what the plant observes into its ring."""

    def __init__(self, ring: RingWriter, plant: Plant, cell: Cell, lockstep: bool) -> None:
        self._ring = ring
        self._lockstep = lockstep
        self._slices = plant.slices
        row: Any = np.asarray(ring.row).reshape(())
        row["config_id"] = cell.config_id
        row["arm_count"] = len(cell.arms)
        self._row = row
        self._joint_views = {
            name: row[name].reshape(-1, MAX_JOINTS) for name in ("q", "dq", "tau_applied", "tau_friction")
        }
        self._period_ns = cell.period_ns
        self._zero_utc_ns = 0

    def __call__(self, tick: int, t: float, seen: Observation) -> None:
        """Append one row of the simulated clock; in lockstep waits for its reader."""
        del t  # the observation has its own
        if tick == 0:
            self._zero_utc_ns = time.time_ns()
        stamp_ns = tick * self._period_ns
        self.write(tick, stamp_ns, self._zero_utc_ns + stamp_ns, seen)

    def write(self, sequence: int, stamp_ns: int, utc_ns: int, seen: Observation) -> None:
        """Append one row."""
        row, n = self._row, len(seen.contact_error_m)
        row["sequence"] = sequence
        row["stamp_ns"] = stamp_ns
        row["utc_ns"] = utc_ns
        row["t"] = seen.t
        row["p_object"], row["quat_object"], row["v_object"] = seen.p_object, seen.quat_object, seen.v_object
        row["grasp_wrench"][: 6 * n] = seen.grasp_wrench.ravel()
        row["contact_error_m"][:n] = seen.contact_error_m
        row["contact_error_rad"][:n] = seen.contact_error_rad
        row["energy"] = seen.energy
        self._put("q", seen.q)
        self._put("dq", seen.dq)
        self._put("tau_applied", seen.tau_applied)
        self._put("tau_friction", seen.tau_friction)
        if self._lockstep:
            self._ring.wait_for_space()
        self._ring.commit()

    def _put(self, name: str, values: Vector) -> None:
        view = self._joint_views[name]
        for i, part in enumerate(self._slices):
            view[i, : part.stop - part.start] = values[part]
