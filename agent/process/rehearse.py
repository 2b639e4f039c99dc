"""An arm in the loop, from the cell file: its bridge, its rows, and what must hold before one may rehearse."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from agent.around import LoopLog
from agent.config.cell import Arm, Cell, ConfigError
from agent.config.files import CellFiles
from agent.config.schema.driver import DriverKind
from agent.control.models import ArmModel
from agent.guard.pulse import SHARED_S
from agent.telemetry.row.fill import AgentRow
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.interface import Clock, Driver, Vector
from sim_backend.hil.coupling import FRESH_CYCLES, Here, Settings
from sim_backend.hil.driver import BridgeDriver, Patience
from sim_backend.hil.gripper import Carried, GripperCheck
from sim_backend.hil.guest import Twin
from sim_backend.hil.touch import Borne

FLAT = 1e-3  # of the largest singular value: a direction in which joints feel no force


def in_the_loop(cell: CellFiles, arm: str) -> bool:
    """Whether [hil] names this arm."""
    return arm in cell.file.looped


def driver_of(cell: CellFiles, arm: str, asked: DriverKind | None) -> DriverKind:
    """What moves this arm; asked: on the command line.  Raises ConfigError where that contradicts [hil]."""
    if cell.file.hil is None:
        return asked or cell.file.driver
    kind = DriverKind.DYNAMIXEL if in_the_loop(cell, arm) else DriverKind.SIM
    if asked not in (None, kind):
        raise ConfigError(
            f"driver of arm {arm}", found=asked.value if asked is not None else "", expected=f"{kind.value}, by [hil]",
            remedy="name the real arms in [hil], or remove the table for the real carry",
        )  # fmt: skip
    return kind


def refuse_port_of_simulated(kind: DriverKind, arm: str, port: str | None) -> None:
    """Refuse a port for an arm that is simulated, which would open none.  Raises ConfigError."""
    if port is not None and kind is DriverKind.SIM:
        raise ConfigError(
            f"--port of arm {arm}", found=f"{port}, and an arm that is simulated", expected="servos on that port",
            remedy="give --driver dynamixel, too, or leave out --port",
        )  # fmt: skip


def require_wall_clock(cell: CellFiles, *, real_time: bool, found: str = "a run in lockstep") -> None:
    """Refuse a rehearsal in lockstep: a real arm waits for nobody.  Raises ConfigError.

    found: what it is instead of a rehearsal at the wall clock's pace.
    """
    if cell.file.hil is not None and not real_time:
        raise ConfigError(
            f"[hil] of cell {cell.file.name}", found=found, expected="a rehearsal at the wall clock's pace",
            remedy="coop run CELL --hil ARMS, or --real-time of coop plant and coop agent; or remove [hil]",
        )  # fmt: skip


def require_one_host(cell: CellFiles) -> None:
    """Refuse a rehearsal of arms on several hosts, which share no plant.  Raises ConfigError."""
    hosts = sorted({arm.host for arm in cell.file.arms if arm.host is not None})
    if cell.file.hil is not None and len(hosts) > 1:
        raise ConfigError(
            f"[hil] of cell {cell.file.name}", found=f"arms on {' and '.join(hosts)}",
            expected="one host: its plant is shared by all arms, over a Unix socket",
            remedy="plug the real arms into one host, and remove host of the others (--set arms.NAME.host=...)",
        )  # fmt: skip


def holds(cell: CellFiles, kind: DriverKind, *, emulated: bool, asked: bool | None) -> bool:
    """Whether an arm holds at a stop and at the end: a real one, and partners of real ones in a rehearsal.

    asked: on the command line.
    """
    if asked is not None:
        return asked
    return not emulated and (kind is DriverKind.DYNAMIXEL or cell.file.hil is not None)


def require_empty_gripper(arm: str, said_so: bool) -> None:
    """Refuse an arm of which nobody says that its gripper is empty.  Raises ConfigError."""
    if not said_so:
        raise ConfigError(
            f"gripper of arm {arm}", found="nobody who says that it is empty",
            expected="a person's yes: the object of a rehearsal is simulated",
            remedy="open the gripper, look, then give --gripper-empty (a service: touch /run/coop/gripper-empty/ARM)",
        )  # fmt: skip


def taken(word: Path | None) -> bool:
    """Whether a person has made this file; it is taken away, so that a yes counts once."""
    if word is None:
        return False
    try:
        word.unlink()
    except OSError:
        return False
    return True


class BridgedRows:
    """A log whose rows say what the bridge has added; `commit` adds that to every row."""

    def __init__(
        self, sink: LoopLog, row: AgentRow, driver: BridgeDriver, tell: Callable[[str], None] = lambda _: None
    ) -> None:
        """tell: of each touch."""
        self._sink, self._row, self._driver, self._tell = sink, row, driver, tell
        self._touches = 0

    def commit(self) -> None:
        """Make the filled row visible to readers; never blocks."""
        driver = self._driver
        self._row.fill_bridge(*driver.taken(), driver.q_twin, driver.age_s)
        self._sink.commit()
        if driver.touches != self._touches:
            self._touches = driver.touches
            self._tell("somebody touches the arm: the rehearsal goes on without it")

    def wait_for_space(self) -> None:
        """A rehearsal is never in lockstep."""
        self._sink.wait_for_space()


def bridge(cell: Cell, arm: Arm, real: Driver, twin: Twin, clock: Clock, *, emulated: bool) -> BridgeDriver:
    """Driver of an arm that [hil] names; real: its own driver; emulated: its servos are."""
    hil, period_s = cell.file.hil, 1.0 / cell.file.rate_hz
    assert hil is not None
    tau_max = arm.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall
    settings = Settings(
        period_s=period_s,
        frequency_rad_per_s=hil.frequency(cell.file.rate_hz),
        damping_ratio=hil.damping_ratio,
        clamp_Nm=hil.tau_share * tau_max,
        ramp_s=hil.ramp_s,
        apart_max_rad=hil.apart_max_rad,
        touch=Borne(hil.touch_max_N, hil.touch_max_s),
    )
    patience = Patience(SHARED_S if emulated else FRESH_CYCLES * period_s, WATCHDOG_S)
    model = cell.model(arm)
    weight = cell.file.object.mass_kg * -cell.gravity
    carried = Carried(
        gravity=lambda q: model.evaluate(q, np.zeros(arm.n)).g,
        weight=lambda q: model.evaluate(q, np.zeros(arm.n)).Jt[:, :3].dot(weight),
        friction_Nm=np.array([servo.coulomb_Nm.value for servo in arm.servos]),
        share_max=hil.gripper_share_max,
    )
    return BridgeDriver(real, twin, clock, settings, patience, partial(_here, model), GripperCheck(carried))


def _here(model: ArmModel, q: Vector) -> Here:
    """What the bridge knows of the arm at q (n,)."""
    J = (model.task_basis.T @ model.jacobian(q))[:3]
    return Here(model.inertia(q), np.linalg.pinv(J.T, rcond=FLAT).astype(np.float64, copy=False))
