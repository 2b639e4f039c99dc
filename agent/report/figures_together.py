"""Figures of how the arms get along and what margin is left: load share, disagreement, what they notice, load, bus."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.control.against import LEVEL_AT, WEIGHT_AT
from agent.control.borne import LOAD_AT, STUCK_AT
from agent.control.knock import KNOCK_AT, SLIP_AT
from agent.report.errors import apart_by_pair
from agent.report.labels import end_labels, room_in
from agent.report.plotting import CYCLE, STYLES, line, panels, styled, time_axis
from agent.report.prepared import Prepared
from agent.report.series import Array, column, component, grasp_force, joint_columns
from agent.report.together import thresholds
from agent.telemetry.row.sample import BUS_COUNTERS

HOLDS_ABOVE: Final = "holds above"
LOADS: Final = (LOAD_AT, STUCK_AT)  # whose limits do not grow with the slip
HOLDS_BELOW: Final = "holds below"
A_TOUCH: Final = "a touch below"
SHARE_S: Final = 1.0  # a load share is that of so long a stretch


def _look(number: int) -> dict[str, Any]:
    return {"color": CYCLE[number % len(CYCLE)], "linestyle": STYLES[number % len(STYLES)]}


def _room(run: Prepared, *more: str) -> float:
    return room_in([*(arm.name for arm in run.info.arms), *more])


@styled
def load_share(run: Prepared) -> Figure:
    """The part of the force on the object that each arm carries, over stretches of SHARE_S; dotted: commanded."""
    figure, axes = panels(1, height_in=2.0, names_in=_room(run))
    assert run.grasps is not None
    t, plant = run.grasps.t, run.grasps.plant
    forces = [grasp_force(plant, i) for i in range(len(run.info.arms))]
    total = np.sum(forces, axis=0)
    for number, arm in enumerate(run.info.arms):
        at, share = in_stretches(t, np.sum(forces[number] * total, axis=1), np.sum(total * total, axis=1), SHARE_S)
        line(axes[0], at, share, label=arm.name, **_look(number))
        axes[0].axhline(arm.load_share, color=CYCLE[number % len(CYCLE)], linestyle=":", linewidth=0.9)
    axes[0].set(ylabel="load share [1]", title="Load share, realised (dotted: commanded)")
    end_labels(axes[0])
    time_axis(axes, run.info.duration_s)
    return figure


def in_stretches(t: Array, part: Array, whole: Array, each_s: float) -> tuple[Array, Array]:
    """Σ part / Σ whole over stretches of time, and the middle of each; NaN where the whole is nothing or infinite.

    `t`, `part`, `whole` (k,), k > 0, sorted by time.
    """
    number = np.floor((t - t[0]) / each_s + 1e-9).astype(int)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    counts = np.diff(np.append(starts, len(t)))
    sums = [np.add.reduceat(np.where(np.isnan(values), 0.0, values), starts) for values in (part, whole)]
    some = (sums[1] > 0.0) & np.isfinite(sums[0]) & np.isfinite(sums[1])
    share = np.divide(sums[0], sums[1], out=np.full(len(starts), np.nan), where=some)
    return np.add.reduceat(t, starts) / counts, share


@styled
def disagreement(run: Prepared) -> Figure:
    """How far apart the arms see the object, and by how much each has shifted its target to meet the others."""
    shifted = [arm for arm in run.arms if np.any(column(run.rows[arm.name], "shift"))]
    pairs = list(apart_by_pair(run))
    room = room_in([f"{one} − {other}" for one, other, _, _ in pairs])
    figure, axes = panels(2 if shifted else 1, height_in=1.9, names_in=room)
    for number, (one, other, t, apart) in enumerate(pairs):
        line(axes[0], t, 1e3 * apart, label=f"{one} − {other}", **_look(number))
    axes[0].set(ylabel="distance [mm]", title="Arms disagree on the object by")
    axes[0].set_ylim(bottom=0.0)
    end_labels(axes[0])
    if shifted:
        for number, arm in enumerate(run.arms):
            shift = column(run.rows[arm.name], "shift", slice(0, 3))
            size = 1e3 * np.linalg.norm(shift, axis=1)
            line(axes[1], column(run.rows[arm.name], "t"), size, label=arm.name, **_look(number))
        _threshold(axes[1], 1e3 * thresholds(run.log).shift_m, "limit")
        axes[1].set(ylabel="shift [mm]", title="Shift of the desired pose")
        axes[1].set_ylim(bottom=0.0)
        end_labels(axes[1])
    time_axis(axes, run.info.duration_s)
    return figure


@styled
def friction(run: Prepared) -> Figure:
    """What each arm has learned of its friction, in times that of its file."""
    figure, axes = panels(1, height_in=1.9, names_in=_room(run))
    for number, arm in enumerate(run.arms):
        rows = run.rows[arm.name]
        line(axes[0], column(rows, "t"), column(rows, "friction_factor"), label=arm.name, **_look(number))
    axes[0].set(ylabel="factor [1]", title="Friction, in times that of the arm's file")
    end_labels(axes[0])
    time_axis(axes, run.info.duration_s)
    return figure


@styled
def noticed(run: Prepared) -> Figure:
    """What acts on each arm beside its load share, as the arm itself finds it: its fast and its slow part."""
    figure, axes = panels(2, 2, height_in=1.7, sharey="row", names_in=_room(run, HOLDS_ABOVE, A_TOUCH))
    limits = thresholds(run.log)
    told = (
        (0, "fast part", "[N]", limits.fast_N), (2, "slow part", "[N]", limits.slow_N),
        (1, "fast part", "[N·m]", limits.fast_Nm), (3, "slow part", "[N·m]", limits.slow_Nm),
    )  # fmt: skip
    for ax, (place, what, unit, limit) in zip(axes, told, strict=True):
        for number, arm in enumerate(run.arms):
            rows = run.rows[arm.name]
            line(ax, column(rows, "t"), column(rows, "unexpected")[:, place], label=arm.name, **_look(number))
        _threshold(ax, limit, HOLDS_ABOVE)
        if place == 0:
            _threshold(ax, limits.touch_N, A_TOUCH)
        ax.set(title=f"Unexpected {'force' if unit == '[N]' else 'moment'}, {what}", ylabel=unit)
        ax.set_ylim(bottom=0.0)
    for ax in axes:
        end_labels(ax)
    time_axis(axes, run.info.duration_s)
    return figure


@styled
def pulled(run: Prepared) -> Figure:
    """What pulls each arm back against the motion, down and up, or strikes it, as the arm itself finds it."""
    limits = thresholds(run.log)
    told = [(LEVEL_AT, "against the motion", limits.level_N), (WEIGHT_AT, "down", limits.weight_N)]
    grows = np.isfinite(limits.knock_N)  # limits with the slip; in older logs they do not, and nobody finds a blow
    if grows:
        told.append((KNOCK_AT, "of a blow", limits.knock_N))
    if np.isfinite(limits.load_N):
        told.append((LOAD_AT, "down, with what friction bears", limits.load_N))
    if np.isfinite(limits.stuck_N):
        told.append((STUCK_AT, "down, with joints that stick", limits.stuck_N))
    figure, axes = panels(len(told), height_in=1.7, names_in=_room(run, HOLDS_ABOVE))
    for ax, (place, where, limit) in zip(axes, told, strict=True):
        for number, arm in enumerate(run.arms):
            rows = run.rows[arm.name]
            slip = component(rows, "memory", SLIP_AT) if grows and place not in LOADS else 1.0
            line(ax, column(rows, "t"), component(rows, "memory", place) / slip, label=arm.name, **_look(number))
        _threshold(ax, limit, HOLDS_ABOVE)
        if place == WEIGHT_AT:
            _threshold(ax, -limits.lifted_N, HOLDS_BELOW)
        ax.set(
            title=f"Unexpected force {where}{' over the slip' if grows and place not in LOADS else ''}", ylabel="[N]"
        )
        end_labels(ax)
    time_axis(axes, run.info.duration_s)
    return figure


def _threshold(ax: Axes, value: float, label: str) -> None:
    """A dotted line where it does not dwarf the curves."""
    if np.isfinite(value) and abs(value) < 3.0 * max(*np.abs(ax.get_ylim()), 1e-12):
        ax.axhline(value, color="black", linestyle=(0, (1, 1.5)), linewidth=1.1, label=label)


@styled
def margins(run: Prepared) -> Figure:
    """What is left: distance from a singular pose, and torque as a part of what each servo may give."""
    figure, axes = panels(2, height_in=1.8, names_in=_room(run))
    for number, arm in enumerate(run.arms):
        rows = run.rows[arm.name]
        t, sigma = column(rows, "t"), column(rows, "sigma_min")
        line(axes[0], t, np.where(sigma > 0.0, sigma, np.nan), label=arm.name, **_look(number))
        load = np.abs(joint_columns(rows, "tau_sent", len(arm.joints))) / np.array(arm.tau_max_Nm)
        line(axes[1], t, 100.0 * np.max(load, axis=1), label=arm.name, **_look(number))
    axes[0].set(ylabel="least σ, bound [1]", title="Distance from a singular pose")
    axes[0].set_ylim(bottom=0.0)
    axes[1].set(ylabel="of the limit [%]", title="Torque of the most loaded joint")
    axes[1].set_ylim(bottom=0.0)
    for ax in axes:
        end_labels(ax)
    time_axis(axes, run.info.duration_s)
    return figure


@styled
def bus(run: Prepared) -> Figure:
    """Errors on the bus of each arm since its start."""
    figure, axes = panels(len(run.arms), height_in=1.5, sharey=True, names_in=room_in(["timeouts"]))
    for ax, arm in zip(axes, run.arms, strict=True):
        rows = run.rows[arm.name]
        for number, name in enumerate(BUS_COUNTERS):
            count = rows[name].astype(float)
            if count[-1] > 0:
                label = name.removeprefix("bus_")
                ax.plot(column(rows, "t"), count, drawstyle="steps-post", label=label, **_look(number))
        ax.set(ylabel="count [1]", title=f"Bus errors of {arm.name}")
        end_labels(ax)
    time_axis(axes, run.info.duration_s)
    return figure
