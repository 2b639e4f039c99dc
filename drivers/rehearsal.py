"""How stiffly a real arm may be coupled to its simulated twin, a question of the loop's delay; and what touches it."""

from __future__ import annotations

from typing import Final

STIFFEST: Final = 0.3  # w τ_loop; measured: stable at 0.31, lost at 0.34
BY_RULE: Final = 0.2  # w τ_loop that the rule aims at
FASTEST_RAD_PER_S: Final = 25.0  # beyond it nothing is gained
CYCLES: Final = 1.5  # of delay around the loop: one from a sample to its torque, half a one of the twin's age
LEAST_TOUCH_N: Final = 1.4  # sudden force on the arm from which on it is a touch; an arm that is otherwise makes 1.1


def loop_delay_s(period_s: float, extra_cycles: float) -> float:
    """Delay around real arm and twin; extra_cycles: on top of what plant and bus of one host have."""
    return (CYCLES + extra_cycles) * period_s


def frequency(delay_s: float) -> float:
    """Angular frequency w (rad/s) of the coupling for a loop with this delay."""
    return min(FASTEST_RAD_PER_S, BY_RULE / delay_s)
