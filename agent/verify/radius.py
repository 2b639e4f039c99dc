"""A spectral radius for a person: digits enough to tell it from its bound, and what mends one above it.

The radius is that of one period, so a slow mode comes nearer to 1 with a higher rate and is no quicker for it.
"""

from __future__ import annotations

import math
from typing import Final

DIGITS: Final = (4, 9)  # behind the point: as a rule, and at most


def told(radius: float, most: float) -> str:
    """The radius, on the side of the printed bound, and of 1, on which it is."""
    bound, text = float(f"{most:g}"), ""
    for digits in range(DIGITS[0], DIGITS[1] + 1):
        text = f"{radius:.{digits}f}"
        shown = float(text)
        beside = shown > bound if radius > most else shown < bound
        if beside and (shown < 1.0) is (radius < 1.0):
            break
    return text


def mended(radius: float, rate_hz: float, unstable: str) -> str:
    """Remedy for a radius above its bound; unstable: what to say of one that is 1 or more."""
    if not 0.0 < radius < 1.0:
        return unstable
    slow_s = -1.0 / (rate_hz * math.log(radius))
    return f"stable, but an error takes {slow_s:.3g} s to fall to 37 %; take the gains that `coop tune` proposes"
