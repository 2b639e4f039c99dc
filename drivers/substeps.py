"""How long an integration step of the simulated plant may be; the one home of it, for the plant and for cell files."""

from __future__ import annotations

import math
from typing import Final

LONGEST_S: Final = 0.01
MAX_BAUMGARTE_STEP: Final = 0.5  # of a step times the gain on a grasp's drift speed: above, the correction oscillates
BAUMGARTE_D_PER_S: Final = 90.0


def damps(substep_s: float, baumgarte_d_per_s: float = BAUMGARTE_D_PER_S) -> bool:
    """Whether steps of this length take out the drift of a grasp without swinging."""
    return 0 <= substep_s * baumgarte_d_per_s <= MAX_BAUMGARTE_STEP


def is_short_enough(substep_s: float) -> bool:
    """Whether the plant takes steps of this length."""
    return 0 < substep_s <= LONGEST_S and damps(substep_s)


def substep_s(rate_hz: float, substeps: int) -> float:
    """Length of each of so many steps in a control cycle."""
    return 1.0 / rate_hz / substeps


def fewest_substeps(rate_hz: float) -> int:
    """The least number of steps in a control cycle that the plant takes."""
    count = max(1, math.floor(BAUMGARTE_D_PER_S / MAX_BAUMGARTE_STEP / rate_hz))
    while not is_short_enough(substep_s(rate_hz, count)):
        count += 1
    return count
