"""What the servos of an arm say of themselves in a figure: temperature, supply and load, with their limits."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.log.runinfo import RunArm
from agent.log.servos import ServoTable
from agent.report.labels import end_labels, room_in
from agent.report.plotting import BLUE, CYCLE, HEADER_IN, RED, STYLES, headline, panels, styled, time_axis
from agent.report.prepared import Prepared
from agent.report.series import Array
from agent.report.together import load_limit


@styled
def servos(run: Prepared, arm: RunArm) -> Figure:
    """Temperature, supply and load of each servo of one arm over the run; dashed: the limits."""
    table = run.log.servos[arm.name]
    figure, axes = panels(3, height_in=1.7, top_in=HEADER_IN, names_in=room_in(map(str, table.servo_id)))
    shown = (
        (axes[0], table.temperature_C, "temperature [°C]"),
        (axes[1], table.voltage_V, "supply [V]"),
        (axes[2], 100.0 * loads(table), "load [% of stall]"),
    )
    for ax, values, label in shown:
        for i, servo in enumerate(table.servo_id):
            colour, style = CYCLE[i % len(CYCLE)], STYLES[i // len(CYCLE) % len(STYLES)]
            ax.plot(table.t, values[:, i], label=str(servo), linewidth=0.9, color=colour, linestyle=style)
        ax.set_ylabel(label)
    limits(axes[0], table.temperature_limit_C, RED)
    limits(axes[1], table.voltage_min_V, RED)
    limits(axes[1], table.voltage_max_V, RED)
    limits(axes[2], np.array([[100.0 * load_limit(run.log)]]), BLUE)
    axes[2].set_ylim(bottom=0.0)
    for ax in axes:
        end_labels(ax)
    headline(figure, f"Servos of {arm.name}, by ID")
    time_axis(axes, run.info.duration_s)
    return figure


def loads(table: ServoTable) -> Array:
    """(k, m) load of each servo as a share of its stall: by its current where it senses one."""
    by_current = np.abs(table.current_A) / table.stall_current_A
    found: Array = np.where(np.isfinite(by_current), by_current, np.abs(table.load))
    return found


def limits(ax: Axes, values: Array, colour: str) -> None:
    """A dashed line at each limit that is known; the panel makes room for it."""
    for value in np.unique(values[np.isfinite(values)]).tolist():
        ax.axhline(value, color=colour, linestyle="--", linewidth=0.9)
    ax.margins(y=0.08)
