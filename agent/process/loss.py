"""What becomes of a simulated run that loses an agent."""

from __future__ import annotations

from enum import StrEnum


class AfterLoss(StrEnum):
    """What the simulated cell does when the agent of an arm is gone."""

    END = "end"
    LIMP = "limp"
