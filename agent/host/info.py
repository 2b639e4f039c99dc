"""What a log says about its run besides the rows: run.json, versions, host; reads, never writes."""

from __future__ import annotations

import json
import platform
import socket
from importlib import metadata
from typing import Any

from agent.config.cell import Arm, Cell
from agent.config.schema.cell import DriverKind

PACKAGES = ("widowx-coop", "pin", "numpy", "scipy", "eclipse-zenoh", "mcap", "dynamixel-sdk")


def versions() -> dict[str, str]:
    """Versions of everything that can change a number."""
    found = {name: metadata.version(name) for name in PACKAGES}
    found["python"] = platform.python_version()
    return found


def run_info(cell: Cell, driver: DriverKind, seed: int, plane_normal: list[float] | None) -> dict[str, Any]:
    """The content of run.json: what the report needs and a reader wants to know."""
    c, report = cell.file.controller, cell.file.report
    bounds = {
        key: value
        for key, value in (
            ("max_position_error_m", report.max_position_error_m),
            ("max_attitude_error_rad", report.max_attitude_error_rad),
        )
        if value is not None
    }
    return {
        "cell": cell.file.name,
        "fingerprint": cell.fingerprint,
        "rate_hz": cell.file.rate_hz,
        "loop_delay_s": cell.file.delay_s,
        "duration_s": cell.file.duration_s,
        "transient_s": report.transient_s,
        "plane_normal": plane_normal,
        "controller": c.model_dump(mode="json"),
        "simulation": cell.file.simulation.model_dump(mode="json"),
        "driver": driver.value,
        "seed": seed,
        "versions": versions(),
        "host": socket.gethostname(),
        "arms": [
            {
                "name": arm.name,
                "model": arm.entry.model,
                "joints": arm.entry.controlled,
                "tau_stall_Nm": arm.tau_stall_Nm.tolist(),
                "tau_max_Nm": (arm.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall).tolist(),
                "load_share": arm.entry.load_share,
                "p_object_ee_m": list(arm.entry.p_object_ee_m),
                **_estimate_bounds(cell, arm),
            }
            for arm in cell.arms
        ],
        "bounds": bounds,
    }


def _estimate_bounds(cell: Cell, arm: Arm) -> dict[str, Any]:
    adaptation = cell.offline(arm).adaptation
    if adaptation is None:
        return {}
    lower, upper = adaptation.lower, adaptation.upper
    pairs = {"arm": zip(lower.arm, upper.arm, strict=True), "object": zip(lower.object, upper.object, strict=True)}
    return {"estimate_bounds": {key: [[float(low), float(up)] for low, up in some] for key, some in pairs.items()}}


def attachments(cell: Cell, info: dict[str, Any]) -> dict[str, bytes]:
    """Files that make a log self-describing: run.json, the cell file, the arms' files and URDFs."""
    files = {"run.json": json.dumps(info, indent=2).encode(), "cell.toml": cell.toml}
    for arm in cell.arms:
        files[f"{arm.entry.model}.toml"] = arm.toml
        files[arm.file.urdf] = arm.urdf_xml.encode()
    return files
