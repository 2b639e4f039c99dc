"""The judgement of `make soak`: what rises after it has settled is seen, what rises before or falls is not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.soak.flat import growth

T = np.linspace(50.0, 1050.0, 501)


def test_a_slow_leak_is_seen_at_its_full_size() -> None:
    leak = growth(T, 100.0 + 0.01 * (T - 50.0))
    assert leak.rise == pytest.approx(0.01 * (900.0 - 400.0), rel=1e-6)
    assert leak.settled == pytest.approx(104.0)


def test_what_grows_until_it_has_settled_is_flat() -> None:
    assert growth(T, np.minimum(T, 349.0)).rise == 0.0


def test_noise_averages_out() -> None:
    noise = np.random.default_rng(1).normal(scale=3.0, size=len(T))
    assert abs(growth(T, 100.0 + noise).rise) < 1.0


def test_what_falls_is_no_growth() -> None:
    assert growth(T, -T).rise < 0.0
