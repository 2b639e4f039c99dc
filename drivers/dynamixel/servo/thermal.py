"""Will a servo reach its temperature limit?  Pure: an estimate for a warning.

A servo warms like a first-order system with a time constant of minutes: T∞ = T + τ dT/dt.  The sensor gives whole
degrees, so the slope is a least-squares line over the last minute.  The servo shuts itself off at its limit, and on an
arm a servo without torque drops the load; hence a warning that comes before.
"""

from __future__ import annotations

from collections import deque

MARGIN_C = 5.0  # warn this close to the limit, whatever the slope
TIME_CONSTANT_S = 180.0  # assumption: no figure is published; a larger one warns earlier
WINDOW_S = 60.0
MIN_SPAN_S = 20.0  # one degree of quantisation over less says nothing about the slope


class ThermalWatch:
    """Temperature of one servo over time."""

    def __init__(self, limit_C: float) -> None:
        self.limit_C = limit_C
        self._samples: deque[tuple[float, float]] = deque()

    def add(self, t_s: float, temperature_C: float) -> None:
        """Take a reading; at most four per second are kept."""
        samples = self._samples
        if samples and t_s - samples[-1][0] < 0.25:
            return
        samples.append((t_s, temperature_C))
        while samples[0][0] < t_s - WINDOW_S:
            samples.popleft()

    @property
    def hot(self) -> bool:
        """True when the last reading is within MARGIN_C of the limit."""
        return bool(self._samples) and self._samples[-1][1] >= self.limit_C - MARGIN_C

    @property
    def final_C(self) -> float | None:
        """Where the temperature is heading if the load stays; None while too little is known."""
        samples = self._samples
        if not samples or samples[-1][0] - samples[0][0] < MIN_SPAN_S:
            return None
        count = len(samples)
        mean_t = sum(t for t, _ in samples) / count
        mean_T = sum(T for _, T in samples) / count
        spread = sum((t - mean_t) ** 2 for t, _ in samples)
        slope = sum((t - mean_t) * (T - mean_T) for t, T in samples) / spread
        return samples[-1][1] + TIME_CONSTANT_S * slope

    @property
    def heating(self) -> bool:
        """True when the limit will be passed at this load."""
        final_C = self.final_C
        return final_C is not None and final_C >= self.limit_C and self._samples[-1][1] >= self.limit_C - 20.0
