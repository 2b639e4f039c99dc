"""The paper's four figures of a run, and the start of its errors."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.log.runinfo import Bounded, RunArm
from agent.report.labels import end_labels, room_in
from agent.report.plotting import (
    AXIS_COLOURS,
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    LIGHT_BLUE,
    ORANGE,
    PURPLE,
    RED,
    headline,
    line,
    panels,
    styled,
    time_axis,
)
from agent.report.prepared import Prepared
from agent.report.series import Array, angle_about, column, component, rotation_vector
from agent.report.shown import SEEN_BY, object_series, start_s

NEAR_LIMIT = 0.8  # of tau_max: torques above it are drawn with their limits
OFF_PLANE_SHOWN = 1e-9  # out-of-plane components below it are rounding and are not drawn


@styled
def pose(run: Prepared) -> Figure:
    """Desired (wide) and actual (dashed) object pose: x, y and angle in a plane, else x, y, z and rotation vector."""
    plane = run.info.plane
    columns = 2 if plane is None else 1
    series = list(object_series(run))
    names = ["desired", *(label.removeprefix(SEEN_BY) for label, _ in series)]
    figure, axes = panels(3, columns, gap_in=0.16, top_in=0.42, names_in=room_in(names))
    if plane is None:
        axes = [*axes[0::2], *axes[1::2]]
        labels = [f"{a} [m]" for a in "xyz"] + [f"rotation {a} [rad]" for a in "xyz"]
    else:
        first, second, normal = plane.names
        labels = [f"{first} [m]", f"{second} [m]", f"angle about {normal} [rad]"]
    for i, (label, s) in enumerate(series):
        if i == 0:
            for ax, desired in zip(axes, _pose_rows(run, s.p_des, s.quat_des), strict=True):
                line(ax, s.t, desired, color=LIGHT_BLUE, linewidth=3.4, label="desired")
        for ax, actual in zip(axes, _pose_rows(run, s.p, s.quat), strict=True):
            line(ax, s.t, actual, color=(RED, ORANGE, PURPLE, GREEN)[i % 4], label=label)
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        end_labels(ax, SEEN_BY)
    headline(figure, "Object pose")
    time_axis(axes, run.info.duration_s)
    return figure


def _pose_rows(run: Prepared, p: Array, quat: Array) -> list[Array]:
    plane = run.info.plane
    if plane is None:
        return [*p.T, *rotation_vector(quat).T]
    return [p[:, plane.in_plane[0]], p[:, plane.in_plane[1]], angle_about(quat, plane)]


@styled
def errors(run: Prepared) -> Figure:
    """Errors over the whole run: e_p on top, e_η − 1 and e_ε below."""
    return _errors(run, run.info.duration_s, "")


@styled
def errors_rest(run: Prepared) -> Figure:
    """The same errors after the transient, at a scale that the start does not set."""
    return _errors(run, run.info.duration_s, " after the transient", from_s=run.info.transient_s)


@styled
def errors_start(run: Prepared) -> Figure:
    """The same errors at the start, where they decay; on the same axes they would be one vertical line."""
    return _errors(run, start_s(run), " at the start")


def _errors(run: Prepared, until_s: float, when: str, from_s: float = 0.0) -> Figure:
    figure, axes = panels(2, height_in=2.1, names_in=room_in(["bound", r"$e_\eta - 1$"]))
    label, s = next(object_series(run))
    shown = (s.t >= from_s) & (s.t <= until_s)
    t, e_p, e_xi = s.t[shown], s.e_p[shown], s.e_xi[shown]
    for axis, name in enumerate("xyz"):
        if _worth(run, e_p, axis):
            line(axes[0], t, 1e3 * e_p[:, axis], color=AXIS_COLOURS[axis], label=rf"$e_p$ {name}")
    line(axes[1], t, 1e3 * (e_xi[:, 0] - 1.0), color=BLUE, label=r"$e_\eta - 1$")
    several = sum(_worth(run, e_xi[:, 1:], axis, rotation=True) for axis in range(3)) > 1
    for axis, name in enumerate("xyz"):
        if _worth(run, e_xi[:, 1:], axis, rotation=True):
            colour = (RED, ORANGE, PURPLE)[(axis + 1) % 3]  # the paper's red is about z
            line(
                axes[1],
                t,
                1e3 * e_xi[:, 1 + axis],
                color=colour,
                label=rf"$e_\varepsilon$ {name}" if several else r"$e_\varepsilon$",
            )
    axes[0].set_ylabel("position error [mm]")
    axes[1].set_ylabel("quaternion error [10⁻³]")
    axes[0].set_title(f"Position error{when} ({'true pose' if run.true else label.removeprefix('actual, ')})")
    axes[1].set_title(f"Attitude error{when}")
    _mark_bound(axes[0], run, until_s, 1e3 * run.info.bounds.get(Bounded.POSITION, math.nan))
    _mark_bound(axes[1], run, until_s, 1e3 * math.sin(0.5 * run.info.bounds.get(Bounded.ATTITUDE, math.nan)))
    for ax in axes:
        _mark_transient(ax, run, until_s)
        end_labels(ax)
    time_axis(axes, until_s, from_s)
    return figure


def _worth(run: Prepared, vectors: Array, axis: int, *, rotation: bool = False) -> bool:
    plane = run.info.plane
    if plane is None or (axis == plane.normal) is rotation:
        return True
    return bool(np.nanmax(np.abs(vectors[:, axis]), initial=0.0) > OFF_PLANE_SHOWN)


def _mark_bound(ax: Axes, run: Prepared, until_s: float, bound: float) -> None:
    """Dotted lines that no component leaves where the bound is met; none where they would dwarf the errors."""
    low, high = ax.get_ylim()
    if run.info.transient_s < until_s and bound <= max(-low, high):
        span = [run.info.transient_s, until_s]
        for signed in (-bound, bound):
            label = "bound" if signed > 0 else None
            ax.plot(span, [signed, signed], color="black", linestyle=":", linewidth=1.0, label=label)


def _mark_transient(ax: Axes, run: Prepared, until_s: float) -> None:
    ax.axhline(0.0, color=GREY, linewidth=0.6, zorder=1)
    if 0.0 < run.info.transient_s < until_s:
        ax.axvspan(0.0, run.info.transient_s, color="#f3f4f6", zorder=0, linewidth=0)


@styled
def torques(run: Prepared) -> Figure:
    """Joint torques τ_i, one panel per arm; dashed: the limit of each joint that comes near its own."""
    names = [joint.replace("_", " ") for arm in run.arms for joint in arm.joints]
    figure, axes = panels(len(run.arms), height_in=2.1, sharey=True, names_in=room_in(names))
    for ax, arm in zip(axes, run.arms, strict=True):
        rows = run.rows[arm.name]
        t = column(rows, "t")
        for j, joint in enumerate(arm.joints):
            tau = component(rows, "tau_cmd", j)
            line(ax, t, tau, color=CYCLE[j], label=joint.replace("_", " "), linewidth=0.8)
            _limits(ax, arm, j, tau)
        ax.set_title(rf"$\tau$ of {arm.name}")
        ax.set_ylabel("torque [N·m]")
    for ax in axes:
        end_labels(ax)
    time_axis(axes, run.info.duration_s)
    return figure


def _limits(ax: Axes, arm: RunArm, joint: int, tau: Array) -> None:
    bound = arm.tau_max_Nm[joint]
    if np.nanmax(np.abs(tau), initial=0.0) > NEAR_LIMIT * bound:
        for signed in (-bound, bound):
            ax.axhline(signed, color=CYCLE[joint], linestyle="--", linewidth=0.8)


@styled
def wrenches(run: Prepared) -> Figure:
    """Task-space wrenches u_i, one row per arm: forces left, moments right; in a plane F_x, F_y and M_z."""
    return wrench_panels(run, "wrench_cmd", "$u$")


def wrench_panels(run: Prepared, name: str, symbol: str) -> Figure:
    """Forces and moments of one wrench of the rows, one row of panels per arm."""
    figure, axes = panels(len(run.arms), 2, height_in=1.9, sharey="col", names_in=room_in(["$F_x$"]))
    plane = run.info.plane
    forces = list(range(3)) if plane is None else list(plane.in_plane)
    moments = list(range(3)) if plane is None else [plane.normal]
    for i, arm in enumerate(run.arms):
        rows = run.rows[arm.name]
        t, wrench = column(rows, "t"), column(rows, name)
        force, moment = axes[2 * i], axes[2 * i + 1]
        for axis in forces:
            line(force, t, wrench[:, axis], color=AXIS_COLOURS[axis], label=f"$F_{'xyz'[axis]}$", linewidth=0.8)
        for axis in moments:
            line(moment, t, wrench[:, 3 + axis], color=AXIS_COLOURS[axis], label=f"$M_{'xyz'[axis]}$", linewidth=0.8)
        for ax, what in ((force, "force [N]"), (moment, "moment [N·m]")):
            ax.set_title(f"{symbol} of {arm.name}")
            ax.set_ylabel(what)
    for ax in axes:
        end_labels(ax)
    time_axis(axes, run.info.duration_s)
    return figure
