"""What a calibration shows: a table, plain sentences, and the disagreement before and after as a figure."""

from __future__ import annotations

from matplotlib.figure import Figure
from rich.table import Table

from agent.calibrate.result import Calibrated, Outcome
from agent.report.plotting import BLUE, GREY, HEADER_IN, RED, header_line, legend, panels, styled

COLOURS = {Outcome.MEASURED: "green", Outcome.UNSEEN: "yellow", Outcome.GIVEN: "dim"}


def estimates_table(result: Calibrated) -> Table:
    """One row per parameter, mm and mrad."""
    table = Table(title=f"{result.cell.file.name}: what is moved", title_justify="left")
    for column in ("arm", "what", "by", "± (1 σ)", "tolerance (1 σ)", ""):
        table.add_column(column, justify="left" if column in ("arm", "what", "") else "right", no_wrap=True)
    arm = None
    for e in result.estimates():
        if arm not in (None, e.arm):
            table.add_section()
        unit = "mm" if e.name[-2:] in (" x", " y", " z") and " about " not in e.name else "mrad"
        numbers = (f"{1e3 * v:.2f}" for v in (e.value, e.sigma, e.prior))
        table.add_row(e.arm, f"{e.name}, {unit}", *numbers, f"[{COLOURS[e.outcome]}]{e.outcome}[/]")
        arm = e.arm
    return table


def lines(result: Calibrated) -> list[str]:
    """What was seen, what cannot be, how far it helped and what to move next."""
    before_m, after_m, before_rad, after_rad = result.judged
    poses, seen = result.poses, result.solution.observed
    said = [f"{len(poses.t)} poses, {int(poses.held_out.sum())} of them held out"]
    said.append(
        f"{result.free} parameters: the poses tell {seen} combinations of them, {result.free - seen} stay with the "
        "tolerance; no motion tells a first joint's zero from the turn of its base, a last joint's from the turn of "
        "its grasp, or a shift of all bases, or of all grasps, together"
    )
    said.append(
        f"disagreement of the poses held out, rms: {1e3 * before_m:.2f} mm and {1e3 * before_rad:.2f} mrad before, "
        f"{1e3 * after_m:.2f} mm and {1e3 * after_rad:.2f} mrad after"
    )
    if result.settled:
        most_m, most_rad = result.readings
        said.append(
            f"the cell's file agrees already: readings leave up to {1e3 * most_m:.2f} mm and {1e3 * most_rad:.2f} mrad "
            "by themselves; it is kept, and nothing is written"
        )
    doubted = int((result.solution.weights < 0.5).sum())
    if doubted:
        said.append(f"{doubted} poses do not fit the others and count little: did a grasp slip?")
    if result.proposals:
        best = result.proposals[0]
        said.append(f"to know more: {best.what} (standard errors fall by {best.factor:.2f} in the mean)")
    return said


@styled
def figure(result: Calibrated) -> Figure:
    """Disagreement of each pose before and after; those held out are shaded."""
    drawn, axes = panels(2, 1, top_in=HEADER_IN)
    t = result.poses.t
    for ax, unit, before, after in zip(axes, ("mm", "mrad"), result.before, result.after, strict=True):
        ax.semilogy(t, 1e3 * before, color=RED, linestyle=":", label="before")
        ax.semilogy(t, 1e3 * after, color=BLUE, label="after")
        low, high = ax.get_ylim()
        ax.fill_between(t, low, high, where=result.poses.held_out.tolist(), color=GREY, alpha=0.15, label="held out")
        ax.set_ylim(low, high)
        ax.set_ylabel(f"disagreement [{unit}]")
    axes[-1].set_xlabel("time [s]")
    legend(axes[0])
    header_line(drawn, f"{result.cell.file.name}, {len(t)} poses", axes[0])
    return drawn
