"""What a log says about its run besides the rows (run.json), computed from the cell's models.

`python -m agent.process.describe CELL DRIVER SEED` prints it: a recorder starts this beside itself and stays small.
"""

from __future__ import annotations

import json
import socket
import sys
from pathlib import Path
from typing import Any

from agent.config.cell import Arm, Cell, load_cell
from agent.config.floating import taking_part
from agent.config.noticing import against, brace, knock, loads_N, thresholds, touch
from agent.config.reality import reality_of
from agent.config.schema.driver import DriverKind
from agent.host.info import versions
from drivers.interface import Refusal


def run_info(cell: Cell, driver: DriverKind, seed: int, alone: str | None = None) -> bytes:
    """The content of run.json: what the report needs and a reader wants to know.  Raises Refusal.

    alone: the one arm that the log is of, where it is of no more.
    """
    expected = [alone] if alone is not None else [arm.name for arm in taking_part(cell) or cell.arms]
    normal = cell.model(cell.arms[0]).plane_normal
    report = cell.file.report
    bounds = {
        key: value
        for key, value in (
            ("max_position_error_m", report.max_position_error_m),
            ("max_attitude_error_rad", report.max_attitude_error_rad),
        )
        if value is not None
    }
    content = {
        "cell": cell.file.name,
        "fingerprint": cell.fingerprint,
        "rate_hz": cell.file.rate_hz,
        "loop_delay_s": cell.file.delay_s,
        "duration_s": cell.file.duration_s,
        "transient_s": report.transient_s,
        "plane_normal": None if normal is None else normal.tolist(),
        "controller": cell.file.controller.model_dump(mode="json"),
        "simulation": cell.file.simulation.model_dump(mode="json"),
        "reality": None if (real := reality_of(cell)) is None else real.model_dump(mode="json"),
        "noticing": thresholds(cell)._asdict() if cell.file.safety.noticing.enabled else None,
        "noticing_against": _against(cell),
        "noticing_touch": _touch(cell),
        "noticing_brace_N": None if (pull_back := brace(cell)) is None else pull_back.limit_N,
        "driver": driver.value,
        "hil": list(cell.file.looped),
        "seed": seed,
        "versions": versions(),
        "host": socket.gethostname(),
        "arms": [_arm(cell, arm) for arm in cell.arms],
        "taking_part": expected,
        "bounds": bounds,
    }
    return json.dumps(content, indent=2).encode()


def _against(cell: Cell) -> dict[str, float] | None:
    """Limits of a pull against the motion, down and up, and of a blow, where joints hardly move."""
    along = against(cell) if cell.file.safety.noticing.enabled else None
    struck = knock(cell, along)
    if along is None or struck is None:
        return None
    limits = {"level_N": along.level_N, "climb_N": along.climb_N, "weight_N": along.hangs_N}
    if (loads := loads_N(cell)) is not None:
        limits["load_N"], limits["stuck_N"] = loads
    return limits | {"lifted_N": along.lifted_N, "knock_N": struck.limit_N}


def _touch(cell: Cell) -> dict[str, float] | None:
    """Up to where a sudden force may be a touch."""
    found = touch(cell, thresholds(cell)) if cell.file.safety.noticing.enabled else None
    return None if found is None else {"most_N": found.most_N, "down_N": found.down_N, "plain_N": found.plain_N}


def _arm(cell: Cell, arm: Arm) -> dict[str, Any]:
    return {
        "name": arm.name,
        "model": arm.entry.model,
        "joints": arm.entry.controlled,
        "tau_stall_Nm": arm.tau_stall_Nm.tolist(),
        "tau_max_Nm": (arm.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall).tolist(),
        "load_share": arm.entry.load_share,
        "p_object_ee_m": list(arm.entry.p_object_ee_m),
        **_estimate_bounds(cell, arm),
    }


def _estimate_bounds(cell: Cell, arm: Arm) -> dict[str, Any]:
    adaptation = cell.offline(arm).adaptation
    if adaptation is None:
        return {}
    lower, upper = adaptation.lower, adaptation.upper
    pairs = {"arm": zip(lower.arm, upper.arm, strict=True), "object": zip(lower.object, upper.object, strict=True)}
    return {"estimate_bounds": {key: [[float(low), float(up)] for low, up in some] for key, some in pairs.items()}}


if __name__ == "__main__":
    path, kind, number = sys.argv[1:]
    try:
        sys.stdout.buffer.write(run_info(load_cell(Path(path)), DriverKind(kind), int(number)))
    except Refusal as refusal:
        sys.stderr.write(str(refusal))
        sys.exit(refusal.exit_code)
