"""Which figures a run's report has, with their titles and captions, in the report's order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from agent.log.runinfo import RunArm
from agent.report import figures, figures_more
from agent.report.gallery_together import together
from agent.report.labels import mark_moments
from agent.report.moments import marks, moments_of
from agent.report.picture import Picture
from agent.report.prepared import Prepared
from agent.report.series import column


def pictures(run: Prepared) -> list[Picture]:
    """The figures that this run can show; none when no arm has a row."""
    if not run.rows:
        return []
    told = marks(moments_of(run), 0.0, run.info.duration_s)
    found = [*_paper(run), *_more(run), *together(run)]
    return [replace(p, draw=partial(_marked, p.draw, told)) for p in found]


def _marked(draw: Callable[[], Figure], told: Sequence[tuple[float, str]]) -> Figure:
    figure = draw()
    mark_moments(figure, told)
    return figure


def _paper(run: Prepared) -> list[Picture]:
    pose = "x, y and the angle about the plane's normal" if run.info.plane else "position and rotation vector"
    source = "The true pose from the simulation." if run.true else "As the arms' own kinematics see it."
    return [
        Picture(
            "pose",
            "Object pose",
            f"Desired (wide, light) and actual (dashed): {pose}. {source}",
            partial(figures.pose, run),
        ),
        Picture(
            "errors",
            "Errors",
            "Above: position error e_p. Below: e_η − 1 and e_ε of the attitude error quaternion, in thousandths. "
            "Shaded: the transient, which counts in no bound. Dotted: the bound, where the errors come near it.",
            partial(figures.errors, run),
        ),
        Picture(
            "errors_start",
            "Errors at the start",
            "The same errors over the first moments, where the start error decays.",
            partial(figures.errors_start, run),
        ),
        *_rest(run),
        Picture(
            "torques",
            "Joint torques",
            "Commanded torques τ, one panel per arm. Dashed: the limit of a joint that comes near it.",
            partial(figures.torques, run),
        ),
        Picture(
            "wrenches",
            "Task-space wrenches",
            "The wrench u of each arm at its end effector, world axes: forces left, moments right.",
            partial(figures.wrenches, run),
        ),
    ]


def _rest(run: Prepared) -> list[Picture]:
    if not 0.0 < run.info.transient_s < run.info.duration_s:
        return []
    caption = "The same errors after the transient, at a scale of their own."
    return [Picture("errors_rest", "Errors after the transient", caption, partial(figures.errors_rest, run))]


def _more(run: Prepared) -> list[Picture]:
    found = [
        Picture(
            "lyapunov",
            "Lyapunov value",
            "The part of the Lyapunov function that each arm computes; the parts of all arms add up to the whole.",
            partial(figures_more.lyapunov, run),
        )
    ]
    wanted = any(np.any(rows["wrench_internal"]) for rows in run.rows.values())
    if wanted or run.grasps is not None:
        caption = "Size of the internal wrench at each end effector, commanded (dashed)"
        caption += " and realised in the simulation: (I − G*Gᵀ) of the grasp wrenches." if run.grasps else "."
        if any(np.isfinite(column(rows, "unexpected_wrench")).any() for rows in run.rows.values()):
            caption += " Unexpected: the force beside its load share, as the arm itself finds it."
        found.append(Picture("internal_force", "Internal force", caption, partial(figures_more.internal_force, run)))
    for arm in run.arms:
        found += _of_arm(run, arm)
    caption = (
        "Fraction of cycles whose duration is longer than the value below it. Line styles are arms, named above it."
    )
    if figures_more.late_arms(run):
        caption = f"Above: {caption[0].lower()}{caption[1:]} Below: how late each cycle began."
    else:
        caption += " No cycle began late: in lockstep simulation time waits."
    return [*found, Picture("loop_timing", "Loop timing", caption, partial(figures_more.loop_timing, run))]


def _of_arm(run: Prepared, arm: RunArm) -> list[Picture]:
    terms = Picture(
        f"torque_terms_{arm.name}",
        f"Torque terms of {arm.name}",
        "The named terms that the commanded torque is the sum of; a term that is zero throughout is left out.",
        partial(figures_more.torque_terms, run, arm),
    )
    if not run.info.adaptive:
        return [terms]
    estimates = Picture(
        f"estimates_{arm.name}",
        f"Estimates of {arm.name}",
        "What the adaptive law of this arm believes of its links and joints, and of the object (black).",
        partial(figures_more.estimates, run, arm),
    )
    return [terms, estimates]
