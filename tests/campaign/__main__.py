"""`make campaign`: random gains, pads and delays; no combination that the criterion accepts diverges in simulation.

CAMPAIGN_N: combinations (default 200).  CAMPAIGN_SEED: of the first one (0).  CAMPAIGN_CELLS: names, with commas.
CAMPAIGN_ADAPTIVE=0: without the adaptive law's runs (tests.campaign.adaptive).  CAMPAIGN_UNLIKE=1: each arm on a pad
of its own, of which the criterion sees the range from the softest to the stiffest.
The criterion sees the drawn pads and delay with its usual errors of inertia; the plant draws all other errors from the
cell's `[tolerance]`.  A run diverges when the object is lost, or strained by more than 10 N once it has settled.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from agent.config.cell import Cell, load_cell
from agent.config.reality import draw
from agent.control.models import ModelError
from agent.monitors.bounds import Name
from agent.study.lab import Laboratory
from agent.study.measure import measure
from agent.verify.check import start_configurations
from agent.verify.criterion.examine import examine
from agent.verify.robustness import Walk, loop_of, poses, ranges_of
from tests.campaign.adaptive import disagreements
from tests.soak.watch import say

CELLS: Final = "paper_real,two_wx200,two_models,three_wx250s"
DURATION_S: Final = 3.0
STRAINED_N: Final = 10.0
OBSERVERS: Final = ((0.01, 0.08, 0.3), (0.4, 0.5, 6.0))  # least and most: of position, of velocity, and the slope
LINEAR, ANGULAR = (1e3, 1e6), (5.0, 1e3)  # N/m, N·m/rad of pads
QUIET: Final = ("safety.noticing.enabled=false", f"safety.monitors.off={[name.value for name in Name]}")


@dataclass(frozen=True)
class Combination:
    """One draw, what the criterion says of it, and what the plant did."""

    cell: str
    seed: int
    radius: float
    diverged: bool
    words: str

    @property
    def unsafe(self) -> bool:
        """Accepted, and yet it diverges."""
        return self.radius < 1.0 and self.diverged


def scaled(gain: float | Sequence[float], factor: float) -> float | list[float]:
    """One gain, or one for every direction."""
    return factor * gain if isinstance(gain, float) else [factor * g for g in gain]


def changed(name: str, rng: np.random.Generator) -> tuple[Cell, str]:
    """The cell with gains around its own, and how they differ."""
    spec = load_cell(Path(name)).file
    k_p, k_eps, k_v, k_w = np.exp(rng.uniform(np.log(0.5), np.log((1.6, 1.6, 2.0, 2.0)))).tolist()
    ratio = rng.uniform(0.5, 1.0)
    share_q, share_dq, slope = np.exp(rng.uniform(*np.log(OBSERVERS))).tolist()
    law = spec.controller
    gains = {
        "controller.k_p_per_s": scaled(law.k_p_per_s, k_p),
        "controller.k_eps_rad_per_s": scaled(law.k_eps_rad_per_s, k_eps),
        "controller.k_p_rate_per_s": scaled(law.k_p_per_s, ratio * k_p),
        "controller.k_eps_rate_rad_per_s": scaled(law.k_eps_rad_per_s, ratio * k_eps),
        "controller.observer.position_gain": share_q,
        "controller.observer.velocity_gain": share_dq,
        "controller.observer.velocity_from_position_per_s": slope,
    }
    for arm in spec.arms:
        gains[f"arms.{arm.name}.k_v_N_s_per_m"] = scaled(arm.k_v_N_s_per_m, k_v)
        gains[f"arms.{arm.name}.k_v_Nm_s_per_rad"] = scaled(arm.k_v_Nm_s_per_rad, k_w)
    changes = [f"{key}={value}" for key, value in gains.items()]
    short = ("simulation.ready_s=0.0", f"duration_s={DURATION_S}", "report.transient_s=1.5")
    words = f"k_p × {k_p:.2f}, k_eps × {k_eps:.2f}, rate {ratio:.2f}, k_v × {k_v:.2f} and {k_w:.2f}"
    words += f", observer {share_q:.3f}, {share_dq:.3f}, {slope:.2f}/s"
    return load_cell(Path(name), [*changes, *short, *QUIET]), words


def combination(name: str, seed: int) -> Combination:
    """One draw, judged and run."""
    rng = np.random.default_rng(seed)
    cell, words = changed(name, rng)
    count = len(cell.arms) if os.environ.get("CAMPAIGN_UNLIKE") == "1" else 1
    linear, angular = ([math.exp(rng.uniform(*np.log(span))) for _ in range(count)] for span in (LINEAR, ANGULAR))
    late = float(rng.uniform(0.5, 1.5)) * cell.file.delay_periods
    models = [cell.model(arm) for arm in cell.arms]
    walk = Walk(cell, models, [start_configurations(cell, models)], [0.0])
    ranges = replace(
        ranges_of(cell),
        delay_periods=(late, late, late),
        pads_N_per_m=(min(linear), max(linear)),
        pads_Nm_per_rad=(min(angular), max(angular)),
    )
    radius = examine(poses(walk), loop_of(cell), ranges).radius
    real = draw(cell.file.tolerance, seed, cell)
    own = [{"pads_N_per_m": k_t, "pads_Nm_per_rad": k_r} for k_t, k_r in zip(linear, angular, strict=True)]
    arms = real.arms
    if count > 1:
        arms = {name: arm.model_copy(update=of) for (name, arm), of in zip(arms.items(), own, strict=True)}
    reality = real.model_copy(update={**own[0], "delay_s": late / cell.file.rate_hz, "arms": arms})
    found = measure(Laboratory(cell), reality)
    strained = found.internal_force_max_N is not None and found.internal_force_max_N > STRAINED_N
    k_t, k_r = (", ".join(f"{k:.2g}" for k in values) for values in (linear, angular))
    words += f"; pads {k_t} N/m, {k_r} N·m/rad; delay {late:.2f} periods"
    return Combination(name, seed, radius, bool(found.lost or strained), words)


def main() -> int:
    """All combinations; 0 when none is unsafe."""
    count, first = int(os.environ.get("CAMPAIGN_N", "200")), int(os.environ.get("CAMPAIGN_SEED", "0"))
    cells = os.environ.get("CAMPAIGN_CELLS", CELLS).split(",")
    found: list[Combination] = []
    for k in range(first, first + count):
        try:
            found.append(combination(cells[k % len(cells)], k))
        except ModelError as error:
            say(f"{k}: {error}")
            continue
        one = found[-1]
        said, did = "accepted" if one.radius < 1.0 else "refused", "diverges" if one.diverged else "lives"
        say(f"{k} {one.cell} {said} at {one.radius:.4f}, {did}: {one.words}")
    accepted = [c for c in found if c.radius < 1.0]
    unsafe = [c for c in found if c.unsafe]
    missed = [c for c in found if c.radius >= 1.0 and not c.diverged]
    refused = f"{len(found) - len(accepted)} refused, of which {len(missed)} live"
    say(f"{len(found)} combinations: {len(accepted)} accepted, of which {len(unsafe)} diverge; {refused}")
    lives = os.environ.get("CAMPAIGN_ADAPTIVE") == "0" or disagreements()
    return 1 if unsafe or not lives else 0


if __name__ == "__main__":
    sys.exit(main())
