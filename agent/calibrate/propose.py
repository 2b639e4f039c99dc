"""Which further motion of the object would tell the most of what is not well known yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.calibrate.chain import Chain, Matrix
from agent.calibrate.solve import Solution, information
from drivers.interface import Vector

WAY_M: Final = 0.05
TURN_RAD: Final = 0.3
STEPS: Final = 10  # poses to each side
AXES: Final = ("x", "y", "z")
JOINT_STEP_MAX_RAD: Final = 0.8  # farther it is no small motion any more


@dataclass(frozen=True, slots=True)
class Proposal:
    """A motion of the object there and back, and the factor by which standard errors fall in the mean of all."""

    what: str
    factor: float


def propose(chain: Chain, solution: Solution, q: Sequence[Matrix]) -> list[Proposal]:
    """Motions from the middle of the poses q, (k, n) of each arm; the most telling first."""
    known = information(chain, solution.x, q, solution.spread) + np.eye(chain.size)
    middle = [np.median(angles, axis=0) for angles in q]
    _, before = np.linalg.slogdet(known)
    found = []
    for what, twist in _motions(chain):
        moved = _along(chain, solution.x, middle, twist)
        if moved is None:
            continue
        more = information(chain, solution.x, moved, solution.spread)
        _, after = np.linalg.slogdet(known + more)
        found.append(Proposal(what, float(np.exp(0.5 * (after - before) / max(solution.observed, 1)))))
    return sorted(found, key=lambda proposal: -proposal.factor)


def _motions(chain: Chain) -> list[tuple[str, Vector]]:
    """Shifts and turns that the arms can make together, world axes."""
    possible = chain.basis.T @ chain.basis
    motions = [(f"shift it by ±{1e3 * WAY_M:.0f} mm along {AXES[i]}", WAY_M * np.eye(6)[i]) for i in range(3)]
    motions += [(f"turn it by ±{TURN_RAD:g} rad about {AXES[i]}", TURN_RAD * np.eye(6)[3 + i]) for i in range(3)]
    return [(what, twist) for what, twist in motions if np.allclose(possible @ twist, twist)]


def _along(chain: Chain, x: Vector, middle: Sequence[Vector], twist: Vector) -> list[Matrix] | None:
    """Reported angles (2 STEPS + 1, n) of each arm along a motion; None where an arm would have to turn far."""
    seen = chain.see(x, [q[None] for q in middle])
    shares = np.linspace(-1.0, 1.0, 2 * STEPS + 1)[:, None]
    moved = []
    for q, arm in zip(middle, seen, strict=True):
        step = np.linalg.lstsq(chain.basis @ arm.by_joints[0], chain.basis @ twist, rcond=1e-3)[0]
        if np.abs(step).max() > JOINT_STEP_MAX_RAD:
            return None
        moved.append(q + shares * step)
    return moved
