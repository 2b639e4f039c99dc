"""The plant process: the simulated cell that all arms are part of, and the truth of it for the log."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Cell
from agent.host.ready_line import pairs
from agent.host.signals import StopFlag
from agent.process.befallen import require_done
from agent.process.common_start import CommonStart
from agent.process.pauses import Pauses
from agent.process.rehearse import require_wall_clock
from agent.process.simulated import plant_spec
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import MAX_JOINTS, PLANT_STATE
from agent.telemetry.row.topics import PLANT
from agent.verify.check import examine
from drivers.clock import LOCKSTEP_UTC_NS, MonotonicClock
from sim_backend.physics.build import AnyPlant, build_plant
from sim_backend.physics.snapshot import Observation
from sim_backend.served.options import LostArm, ServerOptions
from sim_backend.served.server import serve


def run_plant(
    cell: Cell, socket: Path, ring: Path, *, lockstep: bool, lost_arm: LostArm, stop: StopFlag,
    ready: Callable[[str], None], pauses: Pauses | None = None, common_start: Path | None = None,
    utc_offset_ns: int | None = None, stops: bool = False,
) -> str:  # fmt: skip
    """Serve the simulated cell at `socket` until its arms have left; returns one line about the run.

    lost_arm: what becomes of the run when an agent dies without a word; ready is called
    once the arms can connect; pauses: instants to wait at, in lockstep; common_start: where the run will say when the
    trajectory starts, at the wall clock's pace; utc_offset_ns: UTC minus CLOCK_MONOTONIC as the run has found it; None:
    as it is now; stops: whoever starts this has arms stopped that are to hold.  Raises Refusal.
    """
    require_wall_clock(cell, real_time=not lockstep)
    require_done(cell, stops=stops, alone=cell.file.looped)
    report = examine(cell)
    report.require()
    plant = build_plant(plant_spec(cell, report.q_start))
    utc_offset_ns = _utc_at_zero_ns() if lockstep else MonotonicClock(utc_offset_ns).utc_offset_ns
    start = CommonStart(common_start, plant, cell, utc_offset_ns)

    def stopped() -> bool:  # asked before every tick
        start.look(time.monotonic_ns())
        return stop()

    zero_ns = round(cell.file.simulation.ready_s * cell.file.rate_hz) * cell.period_ns

    def pause(stamp_ns: int) -> None:
        if pauses is not None:
            pauses.reached(stamp_ns - zero_ns)

    options = ServerOptions(
        socket_path=socket,
        rate_hz=cell.file.rate_hz,
        config_id=cell.config_id,
        lockstep=lockstep,
        lost_arm=lost_arm,
        utc_offset_ns=utc_offset_ns,
        observe_every=cell.file.observe_every,
        pause=pause,
        stop=stopped,
    )
    with RingWriter(ring, PLANT_STATE, PLANT) as rows:
        rows.asked = stop
        truth = Truth(rows, plant, cell, options.utc_offset_ns, lockstep=lockstep)
        try:
            summary = serve(
                plant, options, on_tick=truth.write, on_listening=lambda: ready(pairs(socket=socket, ring=ring))
            )
        finally:
            rows.finish()
    return (
        f"plant: {summary.ticks} ticks, {summary.sim_s:.2f} s simulated in {summary.wall_s:.2f} s, "
        f"{summary.real_time_factor:.1f} times real time, {summary.late_ticks} late"
        + "".join(f", {arm} lost and limp" for arm in summary.lost_arms)
    )


def _utc_at_zero_ns() -> int:
    """UTC at tick 0 of a lockstep run: the last whole second."""
    return time.time_ns() // LOCKSTEP_UTC_NS * LOCKSTEP_UTC_NS


class TruthLog(Protocol):
    """Where rows of the truth go; `RingWriter` is one."""

    @property
    def row(self) -> NDArray[np.void]:
        """The row to fill, always the same memory."""
        ...

    def commit(self) -> None:
        """Take the filled row."""
        ...

    def wait_for_space(self) -> None:
        """Lockstep: let time wait for the reader."""
        ...


class Truth:
    """Writes what the plant observes into its ring."""

    def __init__(self, ring: TruthLog, plant: AnyPlant, cell: Cell, utc_offset_ns: int, *, lockstep: bool) -> None:
        """utc_offset_ns: UTC minus the clock of the stamps; lockstep: wait for the ring's reader."""
        self._ring = ring
        self._lockstep = lockstep
        self._utc_offset_ns = utc_offset_ns
        row: Any = np.asarray(ring.row).reshape(1)
        row["config_id"] = cell.config_id
        row["arm_count"] = n = len(cell.arms)
        # views are taken once: by its name, a field takes longer to find than to fill
        self._sequence, self._stamp_ns, self._utc_ns = row["sequence"], row["stamp_ns"], row["utc_ns"]
        self._t, self._energy = row["t"], row["energy"]
        self._views = {
            "p_object": row["p_object"][0],
            "quat_object": row["quat_object"][0],
            "v_object": row["v_object"][0],
            "grasp_wrench": row["grasp_wrench"].reshape(-1, 6)[:n],
            "contact_error_m": row["contact_error_m"][0, :n],
            "contact_error_rad": row["contact_error_rad"][0, :n],
            "slip_m": row["slip_m"][0, :n],
            "slip_rad": row["slip_rad"][0, :n],
        }
        self._joint_views = {
            name: [
                (own[: part.stop - part.start], part)
                for own, part in zip(row[name].reshape(-1, MAX_JOINTS), plant.slices, strict=False)
            ]
            for name in ("q", "dq", "tau_applied", "tau_friction")
        }

    def write(self, sequence: int, stamp_ns: int, seen: Observation) -> None:
        """Append one row; in lockstep waits for its reader."""
        self._sequence[0], self._stamp_ns[0], self._utc_ns[0] = sequence, stamp_ns, self._utc_offset_ns + stamp_ns
        self._t[0], self._energy[0] = seen.t, seen.energy
        for name, view in self._views.items():
            view[:] = getattr(seen, name)
        for name, parts in self._joint_views.items():
            values = getattr(seen, name)
            for view, part in parts:
                view[:] = values[part]
        if self._lockstep:
            self._ring.wait_for_space()
        self._ring.commit()
