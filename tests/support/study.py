"""A cell that lives in reality, short enough for tests of a study."""

from __future__ import annotations

from pathlib import Path

import configs
from agent.config.cell import Cell, load_cell

PAPER = configs.CELLS_DIR / "paper.toml"
GAINS = (
    "controller.k_p_per_s=100.0",
    "controller.k_eps_rad_per_s=60.0",
    "controller.k_p_rate_per_s=70.0",
    "controller.k_eps_rate_rad_per_s=42.0",
    *(f"arms.{arm}.k_v_N_s_per_m=1.5" for arm in ("left", "right")),
    *(f"arms.{arm}.k_v_Nm_s_per_rad=0.1" for arm in ("left", "right")),
)
JUMP = "safety.monitors.off=['frozen']"  # the paper's motion begins with a jump, which a stiff joint answers late
SHORT = (*GAINS, JUMP, "report.transient_s=0.2", "duration_s=0.5")


def cell(*overrides: str) -> Cell:
    """Short runs of the paper's cell with gains that its tolerance does not upset."""
    return load_cell(PAPER, [*SHORT, *overrides])


def cell_file(folder: Path, *overrides: str) -> Path:
    """The same as a file."""
    path = folder / "short.toml"
    path.write_bytes(cell(*overrides).toml)
    return path
