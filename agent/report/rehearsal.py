"""What the rows say of an arm in the loop: the torque that its driver added, and how far its twin was.

Figures about the law are without the addition; logs of releases before it have none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from agent.report.quantity import Better, Unit
from agent.report.series import Array, component, joint_columns

if TYPE_CHECKING:
    from agent.log.columns import Table


@dataclass(frozen=True, slots=True)
class HilResults:
    """An arm in the loop over the motion."""

    added_max: Annotated[float, Unit("")]  # largest addition, of the limit of its joint
    apart_max_rad: Annotated[float, Unit("rad")]  # largest difference of a joint between arm and twin
    twin_age_max_s: Annotated[float, Unit("s")]
    coupled: Annotated[float, Unit("", Better.HIGHER)]  # share of the rows with an addition


def added_to(rows: Table, j: int) -> Array | float:
    """What was added to joint j, (k,) N·m; zero of a log without it."""
    try:
        return component(rows, "tau_bridge", j)
    except KeyError:
        return 0.0


def hil_results(rows: Table, tau_max_Nm: Sequence[float]) -> HilResults | None:
    """None of an arm that was not in the loop."""
    n = len(tau_max_Nm)
    try:
        age = np.asarray(rows["twin_age_s"], dtype=np.float64)
        added, q_twin = joint_columns(rows, "tau_bridge", n), joint_columns(rows, "q_twin", n)
    except KeyError:
        return None
    if not np.any(age):
        return None
    apart = np.abs(joint_columns(rows, "q_measured", n) - q_twin)
    return HilResults(
        added_max=_largest(np.abs(added) / np.array(tau_max_Nm)),
        apart_max_rad=_largest(apart),
        twin_age_max_s=_largest(np.where(np.isfinite(age), age, np.nan)),
        coupled=float(np.mean(np.any(added != 0.0, axis=1))),
    )


def _largest(values: Array) -> float:
    return float(np.fmax.reduce(values, axis=None))
