"""What the searches that look at the rigid cell alone try: which k_v, and how far down a gain must go."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

STEP: Final = 0.93  # between gains that are tried; the last one is refined
K_V_FACTORS: Final = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)


def k_v_factors() -> list[tuple[float, float]]:
    """Factors of k_v, (translation, rotation): all of it first, then the pair that takes the least away."""
    pairs = [(linear, angular) for linear in K_V_FACTORS for angular in K_V_FACTORS]
    return sorted(pairs, key=lambda pair: (-pair[0] * pair[1], -pair[0]))


def descend(keeps: Callable[[float], bool], lowest: float, highest: float) -> float | None:
    """The largest x in the range that keeps the margin, to a thousandth; None when none does."""
    above, x = None, highest
    while not keeps(x):
        above, x = x, x * STEP
        if x < lowest:
            return None
    if above is None:
        return x
    for _ in range(6):
        middle = 0.5 * (x + above)
        if keeps(middle):
            x = middle
        else:
            above = middle
    return x
