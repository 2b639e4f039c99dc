"""The figures of how the arms get along and what margin is left, where a run has something to show in them."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from agent.report import figures_servos, figures_together
from agent.report.picture import Picture
from agent.report.prepared import Prepared
from agent.report.series import column
from agent.report.together import thresholds
from agent.telemetry.row.sample import BUS_COUNTERS

SHARE: Final = (
    "The part of the force on the object that each arm carried, over stretches of one second: Σ f·F / Σ F·F. "
    "Dotted: the commanded share."
)
APART: Final = (
    "Distance between where two arms believe the object to be; below, where the cell lets them align, by how much each "
    "has shifted its desired pose."
)
FRICTION: Final = (
    "How many times the friction of its file each arm takes itself to have: learned from the power that it loses, and "
    "compensated."
)
NOTICED: Final = (
    "Force and moment on each arm beside its load share, as the arm finds them from its own joints: the sudden part on "
    "top, the part that stays below. Dotted: above it the arm holds; where a sudden force has two such lines, it holds "
    "above the upper one, and between them for what 2 N on the object do not make."
)
PULLED: Final = (
    "The force on each arm beside its load share, without its slow part: what works against the motion, moments "
    "too, as of a neighbour that holds or is locked, what points down, as of one that is limp, and what comes at once. "
    "Friction hides less of each where the joints are quick: divided by that slip. Dotted: beyond it the arm holds."
)
MARGINS: Final = (
    "Above: a lower bound, 1/‖J⁻¹‖, of the smallest singular value of the object Jacobian; at zero the arm cannot act "
    "in some direction. Below: the torque sent to the most loaded joint, as a part of its limit."
)
SERVOS: Final = (
    "What each servo says of itself about once a second: temperature, supply, and load as a share of stall. Dashed: "
    "the servo's own limits; of the load, what it may be in the mean square before the arm holds."
)


def together(run: Prepared) -> list[Picture]:
    """Those that this run can fill."""
    found = []
    if run.grasps is not None:
        found.append(Picture("load_share", "Load share", SHARE, partial(figures_together.load_share, run)))
    if len(run.seen) > 1:
        draw = partial(figures_together.disagreement, run)
        found.append(Picture("disagreement", "Disagreement of the arms", APART, draw))
    if any(np.any(column(rows, "friction_factor") != 1.0) for rows in run.rows.values()):
        found.append(Picture("friction", "Friction", FRICTION, partial(figures_together.friction, run)))
    if any(np.isfinite(column(rows, "unexpected")).any() for rows in run.rows.values()):
        draw = partial(figures_together.noticed, run)
        found.append(Picture("noticed", "What the arms notice of each other", NOTICED, draw))
    if np.isfinite(thresholds(run.log).weight_N):
        found.append(
            Picture("pulled", "What pulls the arms back or down", PULLED, partial(figures_together.pulled, run))
        )
    found.append(Picture("margins", "Margins", MARGINS, partial(figures_together.margins, run)))
    if any(rows[name][-1] > 0 for rows in run.rows.values() for name in BUS_COUNTERS):
        caption = "Timeouts, corrupt answers, alerts and retries since the start."
        found.append(Picture("bus", "Bus errors", caption, partial(figures_together.bus, run)))
    return found + [
        Picture(f"servos_{arm.name}", f"Servos of {arm.name}", SERVOS, partial(figures_servos.servos, run, arm))
        for arm in run.arms
        if arm.name in run.log.servos
    ]
