"""What the others bear when one arm fails (agent.verify.support), as findings and as a document."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from agent.config.cell import Cell
from agent.verify.finding import Finding, Verdict, judged
from agent.verify.loads import Load, Loads
from agent.verify.support import HELD_SAG_M, Fate, Support


def findings_of(cell: Cell, instants: Sequence[float], arm: int, found: Support) -> list[Finding]:
    """What becomes of the others and the object when this arm fails; instants: of the places, s."""
    bound, where = cell.file.safety.tau_max_fraction_of_stall, cell.arms[arm].name
    remedy = "switch on safety.noticing" if found.noticed_s is None else "move more slowly"
    remedy += ", squeeze less" * any(a.entry.internal_wrench_N_Nm for a in cell.arms)
    stays = ("locked", found.locked.most, found.locked_s), ("holding", found.holding.most, found.holding_s)
    return [
        judged(
            "this arm limp", where,
            f"{_loaded(cell, instants, found.limp.most)}; {_sag(found)}; at the stated tolerance: {found.fate.value}",
            f"held within {HELD_SAG_M * 1e3:g} mm by {bound:.0%} of stall", holds=found.fate is Fate.HELD,
            otherwise=Verdict.WARNING,
            remedy="have a support below the object, a pose with less load, lighter arms or stiffer gains",
        ),
        *(
            judged(
                f"this arm {what}", where, _fought(cell, instants, load, None if found.noticed_s is None else after_s),
                f"≤ {bound:.0%}", holds=load.share <= bound, otherwise=Verdict.WARNING,
                remedy=f"{remedy}, or take softer gains",
            )
            for what, load, after_s in stays
        ),
    ]  # fmt: skip


def document_of(cell: Cell, instants: Sequence[float], found: Support) -> dict[str, Any]:
    """The worst of each fault, what it is at every place, and what each of the others gives."""
    limp, locked, holding = (_loads(cell, instants, x) for x in (found.limp, found.locked, found.holding))
    for place, sag_m in zip(limp["along"], found.sag_along_m, strict=True):
        place["sag_m"] = sag_m
    for loads, after_s in ((locked, found.locked_s), (holding, found.holding_s)):
        for place, at_s in zip(loads["along"], after_s, strict=True):
            place["noticed_s"] = at_s
    limp |= {"sag_m": found.sag_m, "crept_m": found.crept_m, "object": found.fate.value}
    return {"noticed_s": found.noticed_s, "limp": limp, "locked": locked, "holding": holding}


def _sag(found: Support) -> str:
    """How far the object goes, from what friction of the joints leaves at first to what it comes to as they creep."""
    sag_mm, crept_mm = found.sag_m * 1e3, found.crept_m * 1e3
    if math.isinf(sag_mm):
        return "falls"
    if math.isinf(crept_mm):
        return f"sags by {sag_mm:.2g} mm, then creeps and falls"
    return f"sags by {sag_mm:.2g} mm, {crept_mm:.2g} as joints creep"


def _fought(cell: Cell, instants: Sequence[float], load: Load, after_s: Sequence[float] | None) -> str:
    """What the others give against an arm that stays, and until when they do; after_s: None where noticing is off."""
    told = _loaded(cell, instants, load)
    if after_s is not None:
        at_s = after_s[load.place]
        return f"{told}, {'not noticed by then' if math.isinf(at_s) else f'noticed after about {at_s:.2g} s'}"
    safety, off = cell.file.safety, "noticing is off: the others fight it until"
    mm, mrad = safety.tracking_error_max_m * 1e3, safety.tracking_error_max_rad * 1e3
    if load.share > (bound := safety.tau_max_fraction_of_stall):
        given = _loaded(cell, instants, replace(load, share=bound))
        return f"up to the torque bound, {given}; {off} a monitor, or their error, holds them"
    return f"{told}; {off} they are {mm:g} mm or {mrad:g} mrad off, or as far as the motion goes"


def _loaded(cell: Cell, instants: Sequence[float], load: Load) -> str:
    arm = cell.arms[load.arm]
    at = f"t = {instants[load.place]:.3g} s"
    return f"{load.share:.0%} of stall ({arm.name} {arm.entry.controlled[load.joint]}, {at})"


def _loads(cell: Cell, instants: Sequence[float], loads: Loads) -> dict[str, Any]:
    each = {cell.arms[load.arm].name: _load(cell, instants, load) for load in loads.each}
    survivors = {name: {key: load[key] for key in ("share_of_stall", "joint", "t_s")} for name, load in each.items()}
    along = [_load(cell, instants, load) for load in loads.along]
    return _load(cell, instants, loads.most) | {"along": along, "survivors": survivors}


def _load(cell: Cell, instants: Sequence[float], load: Load) -> dict[str, Any]:
    arm = cell.arms[load.arm]
    return {
        "share_of_stall": load.share,
        "arm": arm.name,
        "joint": arm.entry.controlled[load.joint],
        "t_s": instants[load.place],
    }
