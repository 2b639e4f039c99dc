"""Waits of driver and SDK for emulated servos on a real port, long enough for a machine that has no time for a while.

How long they are is tested in virtual time.
"""

from __future__ import annotations

import pytest

SDK_MS = 2000
DRIVER_NS = 200_000_000


def be_patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until the end of the test."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", SDK_MS)
    monkeypatch.setattr("drivers.dynamixel.line.bus.REPLY_WAIT_NS", DRIVER_NS)
