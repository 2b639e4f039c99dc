"""Monitors of what the servos say of themselves: temperature, supply, and load of each.

What a servo does not tell (NaN) is not judged.  A bound that is passed in one reading alone may be a slip of the bus;
where a slow bus has brought nothing new since the last look, it is still that one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from agent.monitors.body import loaded
from agent.monitors.bounds import Bounds, Name
from agent.monitors.tick import sentence
from drivers.interface import ServoHealth

READINGS = 2  # in a row


class Servos:
    """Judges one health reading after the other."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._in_a_row: dict[tuple[Name, int], int] = {}
        self._heat: dict[int, float] = {}  # mean square of each servo's share of stall
        self._stamp_ns: int | None = None
        self._slow_ns: dict[int, int] = {}  # when each servo was last read, as of the last look

    def judge(self, health: ServoHealth) -> list[tuple[Name, str]]:
        """What is wrong by now, with the monitor that says so."""
        if not health.servo_ids:
            return []
        watched, bad = self._bounds.watched, {}
        for name, place, said in (*self._temperature(health), *self._voltage(health), *self._load(health)):
            if name in watched:
                bad[name, health.servo_ids[place]] = said
        read_ns = dict(zip(health.servo_ids, health.slow_ns.tolist(), strict=True))
        known, self._slow_ns = self._slow_ns, read_ns
        self._in_a_row = {
            (name, servo): self._in_a_row.get((name, servo), 0)
            + (name is Name.SERVO_LOAD or read_ns[servo] != known.get(servo))
            for name, servo in bad
        }
        return [(key[0], said) for key, said in bad.items() if self._in_a_row[key] >= READINGS]

    def _temperature(self, health: ServoHealth) -> Iterator[tuple[Name, int, str]]:
        allowed = health.temperature_limit_C - self._bounds.temperature_margin_C
        for place in np.flatnonzero(health.temperature_C >= allowed).tolist():
            yield Name.TEMPERATURE, place, sentence(
                f"temperature of {_title(health, place)}", f"{health.temperature_C[place]:.0f} °C",
                f"below {allowed[place]:.0f} °C ({health.temperature_limit_C[place]:.0f} °C switches it off)",
                "support the object, release it and let the arm cool",
            )  # fmt: skip

    def _voltage(self, health: ServoHealth) -> Iterator[tuple[Name, int, str]]:
        margin = self._bounds.voltage_margin_V
        low, high = health.voltage_min_V + margin, health.voltage_max_V - margin
        for place in np.flatnonzero((health.voltage_V < low) | (health.voltage_V > high)).tolist():
            yield Name.VOLTAGE, place, sentence(
                f"supply of {_title(health, place)}", f"{health.voltage_V[place]:.1f} V",
                f"{low[place]:.1f} to {high[place]:.1f} V", "check supply, cable and connectors",
            )  # fmt: skip

    def _load(self, health: ServoHealth) -> Iterator[tuple[Name, int, str]]:
        b, stamp_ns = self._bounds, health.stamp_ns
        passed_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = stamp_ns
        rate, square = min(1.0, passed_s / b.load_time_s), b.load_share**2
        for place, share in enumerate(loads(health).tolist()):
            if math.isnan(share):
                continue
            servo = health.servo_ids[place]
            heat = self._heat.get(servo, 0.0)
            self._heat[servo] = heat = heat + rate * (share**2 - heat)
            if heat > square:
                yield Name.SERVO_LOAD, place, loaded(_title(health, place), heat, square)


def loads(health: ServoHealth) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Present load of each servo (m,) as a signed share of its stall: by its current where it senses one."""
    by_current = health.current_A / health.stall_current_A
    return np.where(np.isfinite(by_current), by_current, health.load)


def _title(health: ServoHealth, place: int) -> str:
    return f"servo {health.servo_ids[place]} ({health.joints[place]})"
