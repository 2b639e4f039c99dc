"""A rehearsal with faults in it, in virtual time: arms of [hil] on emulated servos of their own, the rest simulated.

Bridges, loops and schedule are those of real arms.  A plant whose agent of a simulated arm is gone ends, as it does
beside real arms; the twin of an arm whose agent is gone goes limp with the arm's servos.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from agent.around import LoopLog
from agent.config.cell import Arm
from agent.config.schema.reality import Reality
from agent.faults.bench import ArmRun, Bench, Rows
from agent.faults.looped import PHASE_NS, Physics, VirtualPlant, VirtualSim, VirtualTwin
from agent.faults.plan import Injection, Kind, Target
from agent.faults.tampered import AgentClock
from agent.process.emulate import wiring
from agent.process.rehearse import BridgedRows, bridge
from agent.process.simulated import lone_spec
from agent.telemetry.row.fill import AgentRow
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.interface import Driver
from sim_backend.hil.driver import BridgeDriver
from sim_backend.physics.calendar import SEIZED_Nms_RAD
from sim_backend.physics.snapshot import Observation
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.lone_world import emulate_alone
from sim_backend.wire.timing import BusTiming

READY_NS: Final = 1_500_000_000  # grippers are looked at, arms and twins are coupled


class LoopBench(Bench):
    """The same for a cell with [hil]; what is true of an arm in the loop is so of the real one, not of its twin."""

    start_after_ns = READY_NS

    def _build(self, reality: Reality | None) -> EmulatedCell:
        cell = self.cell
        chosen = [i for i, arm in enumerate(cell.arms) if arm.name in cell.file.looped]
        wired = [(i, wiring(cell.arms[i], place, cell.arms[i].baud)) for place, i in enumerate(chosen)]
        emulated, lone = emulate_alone(lone_spec(cell, self._q_start), wired, timing=BusTiming())
        self._lone = {arm.name: arm for arm in lone.arms}
        self._cell_plant = VirtualPlant(cell, self._q_start, PHASE_NS, reality)
        self._time = Physics(emulated, self._cell_plant)
        self._plant, self._observe = self._cell_plant.physics, self._seen
        return emulated

    def _seen(self) -> Observation:
        """The plant's truth, with the real arms' motion in the place of their twins'."""
        plant = self._cell_plant
        seen = plant.observe()
        q, dq = seen.q.copy(), seen.dq.copy()
        for name, lone in self._lone.items():
            part = plant.seats[name].part
            q[part], dq[part] = lone.q, lone.dq
        return replace(seen, q=q, dq=dq)

    def _own_plan(self, fault: Injection) -> tuple[Callable[[], None], Callable[[], None]] | None:
        plant, lone = self._cell_plant, self._lone.get(str(fault.arm))
        if fault.target is Target.PLANT:
            what = "gone" if fault.kind is Kind.OFF else "killed"
            return lambda: setattr(plant, what, True), lambda: setattr(plant, what, False)
        if fault.target is Target.HAND and lone is not None:
            wrench = self._against(fault)
            return lambda: lone.touch(wrench), lambda: lone.touch(np.zeros(6))
        if (fault.target, fault.kind) == (Target.ARM, Kind.STUCK) and lone is not None:
            return lambda: lone.brake(SEIZED_Nms_RAD), lambda: None
        return None

    def _lost(self, arm: str) -> None:
        if arm not in self._lone:
            self._cell_plant.gone = True
            return
        self._cell_plant.seats[arm].orphan()
        end_ns = self._clock.now_ns() + round(WATCHDOG_S * 1e9)
        self._agenda.append((end_ns, self._cell_plant.seats[arm].switch_off))
        self._agenda.sort(key=lambda entry: entry[0])

    def _driver(self, run: ArmRun, arm: Arm, clock: AgentClock, mine: Sequence[Injection]) -> Driver:
        seat = self._cell_plant.seats[arm.name]
        if arm.name not in self._lone:
            return VirtualSim(seat, arm, clock)
        real = super()._driver(run, arm, clock, mine)
        return bridge(self.cell, arm, real, VirtualTwin(seat), clock, emulated=False)

    def _sink(self, rows: Rows, row: AgentRow, driver: Driver) -> LoopLog:
        return BridgedRows(rows, row, driver) if isinstance(driver, BridgeDriver) else rows
