"""A picture of the torques that were and those that would have been."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from agent.atomic import write_atomically
from agent.replay.whatif import ArmTorques


def save_picture(arms: Sequence[ArmTorques], changes: Sequence[str], path: Path) -> None:
    """Both torques of every joint over time, a panel per arm.  Raises WriteError."""
    figure = Figure(figsize=(10.0, 3.0 * len(arms)), layout="constrained")
    FigureCanvasAgg(figure)
    for panel, arm in zip(figure.subplots(len(arms), 1, sharex=True, squeeze=False)[:, 0], arms, strict=True):
        for j, joint in enumerate(arm.joints):
            line = panel.plot(arm.t, arm.recorded[:, j], linewidth=1.0, label=joint.joint)[0]
            panel.plot(arm.t, arm.changed[:, j], linewidth=1.0, linestyle="--", color=line.get_color())
        panel.set_ylabel(f"{arm.arm}  [N·m]")
        panel.legend(loc="upper right", fontsize="small")
        panel.grid(alpha=0.3)
    figure.suptitle(f"torque: recorded (solid), with {', '.join(changes)} (dashed)", fontsize="medium")
    panel.set_xlabel("t [s]")
    image = BytesIO()
    figure.savefig(image, format="png", dpi=100)
    write_atomically(path, image.getvalue())
