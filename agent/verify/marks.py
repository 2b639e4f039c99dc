"""Whether arms whose cables are swapped would be told apart by what their servos hold."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np

from agent.config.cell import Cell
from agent.config.servo_map import arm_map
from agent.verify.finding import Finding, Verdict
from drivers.dynamixel.arm_map import ArmMap


def marks(cell: Cell, *, wired: bool) -> list[Finding]:
    """One line for each group of arms with a port that connect could not tell apart.

    wired: servos move the arms; else nothing is said.  Raises MapError.
    """
    if not wired:
        return []
    alike: dict[Hashable, list[str]] = {}
    for arm in cell.arms:
        if arm.entry.dynamixel is not None:
            servos = arm_map(cell, arm, arm.entry.dynamixel.port, np.array(arm.entry.q_near_rad))
            alike.setdefault(_seen(servos), []).append(arm.name)
    remedy = (
        "swapped cables would not be noticed: give each arm `mark = 1`, `2`, … beside its `port`, then "
        "`coop motors mark CELL --arm NAME`"
    )
    return [
        Finding("what tells arms apart", ", ".join(names), "nothing: the same servos and IDs, and no mark",
                "a mark", Verdict.WARNING, remedy)
        for names in alike.values() if len(names) > 1
    ]  # fmt: skip


def _seen(arm: ArmMap) -> Hashable:
    """All by which connect can know an arm: a rule that refuses it compares each of these with its servos."""
    servos = tuple((slot.servo_id, slot.model.name, slot.shadow, slot.reverse) for slot in arm.slots)
    return arm.baud, arm.mark.own, servos
