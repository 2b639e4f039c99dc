"""What identification shows: a table, and measured against predicted torque on data it has not seen."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from agent.identify.result import Identified, Outcome, gravity_rows
from agent.report.plotting import BLUE, GREY, HEADER_IN, RED, header_line, panels, styled


def estimates_table(result: Identified) -> Table:
    """One row per figure of the arm file and per gravity parameter."""
    arm = result.recording.arm
    table = Table(title=f"{arm.entry.model}  {result.recording.source}", title_justify="left")
    for column in ("what", "estimate", "± (1 σ)", "before", ""):
        table.add_column(column, justify="left" if column in ("what", "") else "right", overflow="fold")
    for f in result.figures:
        colour = "green" if f.outcome is Outcome.REPLACED else "yellow"
        table.add_row(f"{f.key}, {f.joint}", *_numbers(f.value, f.sigma, f.previous), f"[{colour}]{f.outcome}[/]")
    table.add_section()
    for name, value, sigma, described in gravity_rows(result.fit):
        table.add_row(f"{name}, kg·m", *_numbers(value, sigma, described), "not in the arm file")
    return table


def residual_lines(result: Identified) -> list[str]:
    """How well each joint's torque is predicted where it was not fitted."""
    fit = result.fit
    return [
        f"{name}: torque {fit.torque[j]:.3f} N·m rms, predicted to {fit.residual[j] * 1e3:.1f} mN·m "
        f"(before: {fit.residual_described[j] * 1e3:.1f} mN·m), {fit.used[j]:.0%} of the time used"
        for j, name in enumerate(result.recording.arm.entry.controlled)
    ]


def friction_lines(result: Identified) -> list[str]:
    """The model of friction that was chosen, and why."""
    choice = result.fit.choice
    return [f"friction model: {choice.name}", *(f"  {reason}" for reason in choice.reason.split("; "))]


def scale_lines(result: Identified) -> list[str]:
    """Joints whose torque is another part of what they are asked for than that of the joint that bears most."""
    scales, joints = result.fit.scales, result.recording.arm.entry.controlled
    most = joints[scales.most]
    return [
        f"torque: {name} is asked for {value:.3f} ± {sigma:.1g} times what links that {most} bears would ask of it: a "
        "torque constant is off by that; the figures of each are in its own torque"
        for name, value, sigma, taken in zip(joints, scales.value, scales.sigma, scales.taken, strict=True)
        if taken != 1.0
    ]


def delay_line(result: Identified) -> str:
    """What the recording says of the loop's delay."""
    delay = result.fit.delay
    if delay is None:
        return "loop delay: not to be seen in this motion"
    found = (
        f"loop delay: {delay.value_s:.4f} s ± {delay.sigma_s:.1g} (loop_delay_s, or one period: {delay.believed_s:g})"
    )
    if not delay.is_taken:
        return f"{found}; the figures are those of {delay.taken_s:.4g} s: viscous friction above all is off by that"
    if delay.taken_s != delay.believed_s:
        return f"{found}; the figures are those of {delay.taken_s:.4g} s: set loop_delay_s to it"
    if delay.may_be_friction:
        return f"{found}; not told apart from sticking and other friction: the figures are those of the believed one"
    return found


@styled
def validation_figure(result: Identified) -> Figure:
    """Measured and predicted torque of each joint on the held-out part, and what is left over."""
    fit, part = result.fit, result.fit.held_out
    predicted, before = part.columns @ fit.value, part.columns @ fit.described
    joints = result.recording.arm.entry.controlled
    figure, axes = panels(len(joints), 2, top_in=HEADER_IN)
    for j, name in enumerate(joints):
        torque, rest = axes[2 * j : 2 * j + 2]
        used = part.used[:, j]
        torque.plot(part.t, part.tau[:, j], color=GREY, linewidth=2.0, label="measured")
        torque.plot(part.t, before[:, j], color=RED, linestyle=":", label="arm file before")
        torque.plot(part.t, predicted[:, j], color=BLUE, label="identified")
        torque.set_title(name)
        torque.set_ylabel("torque [N·m]")
        for values, colour in ((before, RED), (predicted, BLUE)):
            rest.plot(part.t, np.where(used, part.tau[:, j] - values[:, j], np.nan) * 1e3, color=colour)
        rest.set_title(f"{fit.residual[j] * 1e3:.1f} mN·m rms, before {fit.residual_described[j] * 1e3:.1f}")
        rest.set_ylabel("not predicted [mN·m]")
    for ax in axes[-2:]:
        ax.set_xlabel("time [s], held out from the fit")
    header_line(figure, f"{result.recording.arm.entry.model}, {result.recording.day}", axes[0])
    return figure


def _numbers(value: float, sigma: float | None, before: float) -> tuple[str, str, str]:
    return f"{value:.4g}", "best of a few" if sigma is None else f"{sigma:.2g}", f"{before:.4g}"
