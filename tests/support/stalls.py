"""What the machine did to a run in real time: a control loop at 200 Hz says nothing on one that stops for 50 ms."""

from __future__ import annotations

from agent.log.read import RunLog
from agent.safety import Flag

ATTEMPTS = 3  # a run that the machine stalled is repeated


def stalled(log: RunLog, before_s: float = float("inf")) -> str:
    """What the machine, not the software, did until then: two periods late, or the emulator silent for as long."""
    for arm, rows in log.agents.items():
        early = rows[rows["t"] < before_s]
        lost = early["flags"] & Flag.STALE.value != 0
        if (lost[:-2] & lost[1:-1] & lost[2:]).any():
            return f"{arm}: three cycles in a row without a reply"
        if early["late_s"].max(initial=0.0) > 0.01:
            return f"{arm}: a cycle {early['late_s'].max() * 1e3:.0f} ms late"
    return ""
