"""A replay for a person and for a script: lines and a table, JSON."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from typing import Any, Final

from rich import box
from rich.table import Table

from agent.host.info import versions
from agent.log.read import AnyLog, LogError
from agent.replay.comparison import Comparison, Difference
from agent.replay.whatif import ArmTorques
from agent.report.quantity import json_ready
from agent.telemetry.row.topics import PLANT

SCHEMA: Final = 1
ROUNDING_Nm: Final = 1e-9  # of torques: what another processor or library may leave


def comparison_lines(compared: Comparison) -> list[str]:
    """What was compared, what differs, and where it begins."""
    lines = []
    for arm in compared.arms:
        if arm.arm == PLANT:  # which no law gives: it is here for rows that are of no run of this cell
            lines.append(f"{arm.arm:<12} {arm.rows} rows looked at, {arm.different} are wrong")
            continue
        differ = f"{arm.different} differ, torque by up to {arm.torque_difference_Nm:.3g} N·m"
        told = (
            f"{arm.rows} rows replayed, {differ if arm.different else 'all equal'}" if arm.rows else "no row replayed"
        )
        lines.append(f"{arm.arm:<12} {told}" + (f"; {arm.left_out} left out" if arm.left_out else ""))
    first = compared.first
    if first is not None:
        lines.append(f"first difference: {_said(first)}")
        if 0.0 < max(arm.torque_difference_Nm for arm in compared.arms) < ROUNDING_Nm:
            lines.append("differences of this size are rounding: another processor, or other versions of the libraries")
    return lines


def same_lines(compared: Comparison) -> list[str]:
    """What two logs have in common."""
    lines = []
    for arm in compared.arms:
        differ = f"{arm.different} differ" if arm.different else "all equal but for timing"
        told = f"{arm.rows} rows in both, {differ}" if arm.rows else "no row in both"
        more = f"; {arm.left_out} only in one of the logs" if arm.left_out else ""
        lines.append(f"{arm.arm:<12} {told}{more}")
    first = compared.first
    return lines if first is None else [*lines, f"first difference: {_said(first, ('here', 'there'))}"]


def _said(d: Difference, sides: tuple[str, str] = ("recorded", "replayed")) -> str:
    place = d.field if d.index is None else f"{d.field}[{d.index}]"
    others = [name for name in d.fields if name != d.field]
    also = f" (also {', '.join(others[:6])}{' …' if len(others) > 6 else ''})" if others else ""
    values = f"{sides[0]} {d.recorded!r}, {sides[1]} {d.replayed!r}"
    return f"row {d.row} of {d.arm}, t = {d.t_s:.3f} s, {place}: {values}{also}"


def version_notes(log: AnyLog) -> list[str]:
    """Which versions that can change a number are others than those of the run."""
    try:
        recorded = log.run_info().get("versions", {})
    except LogError:
        return []
    here = versions()
    other = [
        f"{name} {was} (here {here[name]})" for name, was in recorded.items() if name in here and here[name] != was
    ]
    return [f"recorded with {', '.join(other)}"] if other else []


def comparison_document(log: AnyLog, compared: Comparison, notes: Sequence[str]) -> dict[str, Any]:
    """The same for scripts."""
    first = compared.first
    document = {
        "schema": SCHEMA,
        "log": str(log.path),
        "equal": compared.equal,
        "rows_compared": compared.rows,
        "rows_different": compared.different,
        "first_difference": None if first is None else _difference(first),
        "arms": {
            arm.arm: {
                "rows_compared": arm.rows, "rows_different": arm.different, "rows_left_out": arm.left_out,
                "max_torque_difference_Nm": arm.torque_difference_Nm,
            }
            for arm in compared.arms
        },
        "complete": log.complete,
        "notes": [*notes, *compared.notes],
        "machine": platform.machine(),
    }  # fmt: skip
    ready: dict[str, Any] = json_ready(document)
    return ready


def _difference(d: Difference) -> dict[str, Any]:
    return {
        "arm": d.arm, "row": d.row, "t_s": d.t_s, "field": d.field, "index": d.index, "recorded": d.recorded,
        "replayed": d.replayed, "fields": list(d.fields),
    }  # fmt: skip


def torque_table(arms: Sequence[ArmTorques]) -> Table:
    """Torques as they were and as they would have been, by joint."""
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("arm", "joint", "rms recorded", "rms changed", "rms difference", "largest difference", "at"):
        table.add_column(heading, justify="left" if heading in ("arm", "joint") else "right", overflow="fold")
    for arm in arms:
        for f in arm.joints:
            torques = (f.rms_recorded_Nm, f.rms_Nm, f.rms_difference_Nm, f.max_difference_Nm)
            table.add_row(arm.arm, f.joint, *(f"{x:.4f} N·m" for x in torques), f"{f.at_s:.3f} s")
    return table


def torque_lines(arms: Sequence[ArmTorques]) -> list[str]:
    """What a table of torques does not say."""
    return [
        f"{arm.arm}: {len(arm.t)} rows; a limit cut {arm.limited_recorded}, with the change {arm.limited}"
        + (f"; in {arm.without} the changed law gives nothing" if arm.without else "")
        for arm in arms
    ]


def torque_document(log: AnyLog, changes: Sequence[str], arms: Sequence[ArmTorques]) -> dict[str, Any]:
    """The same for scripts."""
    document = {
        "schema": SCHEMA,
        "log": str(log.path),
        "set": list(changes),
        "arms": {
            arm.arm: {
                "rows": len(arm.t), "rows_limited_recorded": arm.limited_recorded, "rows_limited": arm.limited,
                "rows_without_torque": arm.without,
                "joints": {
                    f.joint: {
                        "rms_recorded_Nm": f.rms_recorded_Nm, "rms_Nm": f.rms_Nm,
                        "rms_difference_Nm": f.rms_difference_Nm, "max_difference_Nm": f.max_difference_Nm,
                        "t_max_difference_s": f.at_s,
                    }
                    for f in arm.joints
                },
            }
            for arm in arms
        },
    }  # fmt: skip
    ready: dict[str, Any] = json_ready(document)
    return ready
