"""Figures beyond the paper's: loop timing, internal force, torque terms, estimates, Lyapunov value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.log.runinfo import EstimateBounds, RunArm
from agent.report.labels import end_labels, name_curve, room_in
from agent.report.plotting import (
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    HEADER_IN,
    RED,
    STYLE_WORDS,
    STYLES,
    header_line,
    headline,
    line,
    panels,
    styled,
    time_axis,
)
from agent.report.prepared import Prepared
from agent.report.series import Array, column, component, durations, joint_columns

LABELS: Final = {"late_s": "began late", "read_s": "bus read", "step_s": "control step", "write_s": "bus write"}
NAMED_AT: Final = (0.02, 0.6, 0.2, 0.06)  # the fraction at which the curve of each duration is named
# feedback first: it carries the noise and would hide the others
TERMS: Final = ("feedback", "inertia", "coriolis", "gravity", "adaptive", "object", "internal", "friction", "posture")
COMMANDED, UNEXPECTED = "commanded", "unexpected"  # curves of internal force
TAIL_POINTS: Final = 300
# columns of one body or joint in the estimates: what, unit, first column, how many
BODY_GROUPS: Final = (("mass", "kg", 0, 1), ("first moment", "kg·m", 1, 3), ("inertia", "kg·m²", 4, 6))
BODY_PARAMETERS: Final = sum(count for *_, count in BODY_GROUPS)  # of one link
JOINT_GROUPS: Final = (
    ("rotor inertia", "kg·m²"), ("viscous friction", "N·m·s/rad"), ("Coulomb friction", "N·m"),
    ("breakaway", "N·m"), ("load friction", "1"), ("breakaway load", "1"),
)  # fmt: skip
MOVING_GROUPS: Final = 3  # of the groups of joints, those before breakaway and load


def late_arms(run: Prepared) -> list[RunArm]:
    """The arms with a cycle that began late; none in lockstep simulation, where time waits."""
    return [arm for arm in run.arms if np.any(durations(run.rows[arm.name])["late_s"] > 0.0)]


@styled
def loop_timing(run: Prepared) -> Figure:
    """How often a duration of the loop is longer than x, and, if any did, when cycles began late."""
    late_ones = late_arms(run)
    room = room_in([arm.name for arm in run.arms] if late_ones else [])
    figure, axes = panels(2 if late_ones else 1, height_in=2.1, gap_in=0.85, sharex=False, names_in=room)
    tail = axes[0]
    named: set[str] = set()
    for i, arm in enumerate(run.arms):
        took = durations(run.rows[arm.name])
        for j, (name, label) in enumerate(LABELS.items()):
            x, fraction = tail_of(1e3 * took[name])
            if len(x):
                (curve,) = tail.plot(x, fraction, color=CYCLE[j], linestyle=STYLES[i % len(STYLES)])
                if label not in named:
                    named.add(label)
                    name_curve(tail, curve, label, NAMED_AT[j])
    tail.margins(x=0.03)
    period = tail.axvline(1e3 / run.info.rate_hz, color=GREY, linestyle="--", linewidth=0.9)
    name_curve(tail, period, "period", 1.0)
    looks = ", ".join(f"{arm.name} {STYLE_WORDS[i % len(STYLES)]}" for i, arm in enumerate(run.arms))
    tail.set(xscale="log", yscale="log", xlabel="duration [ms]", ylabel="fraction longer [1]")
    tail.set_title(f"Loop timing ({looks})")
    if late_ones:
        _lateness(axes[1], run)
    return figure


def _lateness(ax: Axes, run: Prepared) -> None:
    for i, arm in enumerate(run.arms):
        rows, colour = run.rows[arm.name], CYCLE[i % len(CYCLE)]
        t, late, style = column(rows, "t"), 1e3 * durations(rows)["late_s"], STYLES[i % len(STYLES)]
        line(ax, t, late, color=colour, linestyle=style, label=arm.name, linewidth=0.8, clip_on=False)
    ax.set(ylabel="began late [ms]", title="Lateness of each cycle")
    ax.set_ylim(bottom=0.0)
    end_labels(ax)
    time_axis([ax], run.info.duration_s)


def tail_of(values: Array) -> tuple[Array, Array]:
    """Points of x → fraction of `values` that are longer than x, dense in the tail; without zeros."""
    ordered = np.sort(values[np.isfinite(values) & (values > 0.0)])
    count = len(ordered)
    if not count:
        return np.empty(0), np.empty(0)
    longer = np.unique(np.round(np.geomspace(1, count, TAIL_POINTS)).astype(int))
    return ordered[count - longer], longer / np.count_nonzero(np.isfinite(values))


@styled
def internal_force(run: Prepared) -> Figure:
    """Internal wrench at each end effector: size of force and moment, commanded, realised, and what the arm feels."""
    names_in = room_in([COMMANDED, UNEXPECTED if _feels(run) else COMMANDED])
    figure, axes = panels(len(run.arms), 2, height_in=1.8, sharey="col", top_in=HEADER_IN, names_in=names_in)
    for i, arm in enumerate(run.arms):
        rows = run.rows[arm.name]
        t, number = column(rows, "t"), run.info.arms.index(arm)
        for ax, part, unit in ((axes[2 * i], slice(0, 3), "force [N]"), (axes[2 * i + 1], slice(3, 6), "moment [N·m]")):
            if run.grasps is not None:
                real = run.grasps.internal_force if part.start == 0 else run.grasps.internal_moment
                line(ax, run.grasps.t, real[:, number], color=RED, label="realised", linewidth=0.8)
            felt = np.linalg.norm(column(rows, "unexpected_wrench", part), axis=1)
            if part.start == 0 and np.isfinite(felt).any():  # told at the object, where its moment is another
                line(ax, t, felt, color=GREEN, label=UNEXPECTED, linewidth=0.8)
            size = np.linalg.norm(column(rows, "wrench_internal", part), axis=1)
            line(ax, t, size, color=BLUE, linestyle="--", label=COMMANDED)
            ax.set_ylabel(unit)
            ax.set_title(arm.name)
    for ax in axes:
        end_labels(ax)
    headline(figure, "Internal wrench")
    time_axis(axes, run.info.duration_s)
    return figure


def _feels(run: Prepared) -> bool:
    return any(np.isfinite(column(rows, "unexpected_wrench")).any() for rows in run.rows.values())


@styled
def torque_terms(run: Prepared, arm: RunArm) -> Figure:
    """The terms of the torque of each joint of one arm; terms that are zero throughout are left out."""
    rows, joints = run.rows[arm.name], len(arm.joints)
    columns = 1 if joints <= 3 else 2
    figure, axes = panels(-(-joints // columns), columns, height_in=1.7, top_in=HEADER_IN, names_in=room_in(TERMS))
    t = column(rows, "t")
    for colour, name in enumerate(TERMS):
        tau = joint_columns(rows, f"tau_{name}", joints)
        if not np.any(tau):
            continue
        for j in range(joints):
            line(axes[j], t, tau[:, j], color=CYCLE[colour % len(CYCLE)], label=name, linewidth=0.8)
    for j, joint in enumerate(arm.joints):
        axes[j].set_title(joint.replace("_", " "))
        axes[j].set_ylabel("torque [N·m]")
        end_labels(axes[j])
    for unused in axes[joints:]:
        unused.remove()
    headline(figure, f"Torque of {arm.name}")
    time_axis(axes[:joints], run.info.duration_s)
    return figure


@styled
def estimates(run: Prepared, arm: RunArm) -> Figure:
    """What one arm of an adaptive run believes: of its own links and joints, and of the object (black)."""
    rows, joints = run.rows[arm.name], len(arm.joints)
    t = column(rows, "t")
    columns = 3 if sticking(run, arm) else 2
    figure, axes = panels(3, columns, height_in=1.7, top_in=HEADER_IN)
    left, right = axes[0::columns], [ax for column in range(1, columns) for ax in axes[column::columns]]
    for ax, (what, unit, first, count) in zip(left, BODY_GROUPS, strict=True):
        ax.set_title(what)
        ax.set_ylabel(f"[{unit}]")
        for k in range(first, first + count):
            for j, joint in enumerate(arm.joints):
                label = joint.replace("_", " ") if k == first else None
                line(
                    ax,
                    t,
                    component(rows, "theta_arm", BODY_PARAMETERS * j + k),
                    color=CYCLE[j],
                    label=label,
                    linewidth=0.8,
                )
            label = "object" if k == first else None
            line(ax, t, component(rows, "theta_object", k), color="black", label=label, linewidth=0.8)
    for block, (ax, (what, unit)) in enumerate(zip(right, JOINT_GROUPS, strict=False)):
        ax.set_title(what)
        ax.set_ylabel(f"[{unit}]")
        for j in range(joints):
            line(
                ax,
                t,
                component(rows, "theta_arm", (BODY_PARAMETERS + block) * joints + j),
                color=CYCLE[j],
                linewidth=0.8,
            )
    if arm.estimate_bounds is not None:
        _draw_bounds(left, right, arm.estimate_bounds, joints)
    header_line(figure, f"Estimates of {arm.name}", left[0])
    time_axis(axes, run.info.duration_s)
    return figure


def sticking(run: Prepared, arm: RunArm) -> bool:
    """Whether the arm believes anything of breakaway or load friction."""
    joints = len(arm.joints)
    first = (BODY_PARAMETERS + MOVING_GROUPS) * joints
    last = (BODY_PARAMETERS + len(JOINT_GROUPS)) * joints
    return bool(np.any(column(run.rows[arm.name], "theta_arm", slice(first, last))))


def _draw_bounds(left: Sequence[Axes], right: Sequence[Axes], bounds: EstimateBounds, joints: int) -> None:
    """Dotted: where an estimate is held; a bound far from every estimate stays outside the panel."""
    marked: list[tuple[Axes, str, tuple[float, float]]] = []
    for ax, (_, _, first, count) in zip(left, BODY_GROUPS, strict=True):
        for k in range(first, first + count):
            marked += [(ax, CYCLE[j], bounds.arm[BODY_PARAMETERS * j + k]) for j in range(joints)]
            marked.append((ax, "black", bounds.object[k]))
    for block, ax in enumerate(right):
        marked += [(ax, CYCLE[j], bounds.arm[(BODY_PARAMETERS + block) * joints + j]) for j in range(joints)]
    for ax, colour, pair in marked:
        low, up = ax.get_ylim()
        room = 0.3 * (up - low)
        for value in pair:
            if low - room < value < up + room:
                ax.axhline(value, color=colour, linestyle=":", linewidth=0.8)


@styled
def lyapunov(run: Prepared) -> Figure:
    """The part of the Lyapunov function that each arm computes, and their sum: the function of the whole cell."""
    figure, axes = panels(1, height_in=2.2, names_in=room_in(["cell", *(arm.name for arm in run.arms)]))
    parts = [(arm.name, run.rows[arm.name]) for arm in run.arms]
    for i, (name, rows) in enumerate(parts):
        style, colour = STYLES[i % len(STYLES)], CYCLE[i % len(CYCLE)]
        _positive_line(axes[0], column(rows, "t"), column(rows, "lyapunov"), colour, style, name)
    stamps = [rows["stamp_ns"] for _, rows in parts]
    if len(parts) > 1 and all(np.array_equal(stamps[0], other) for other in stamps[1:]):
        total = np.sum([column(rows, "lyapunov") for _, rows in parts], axis=0)
        _positive_line(axes[0], column(parts[0][1], "t"), total, "black", "-", "cell")
    axes[0].set(yscale="log", ylabel="Lyapunov value [J]", title="Lyapunov value")
    end_labels(axes[0])
    time_axis(axes, run.info.duration_s)
    return figure


def _positive_line(ax: Axes, t: Array, values: Array, colour: str, style: str, label: str) -> None:
    shown = np.where(values > 0.0, values, np.nan)
    line(ax, t, shown, color=colour, linestyle=style, label=label)
