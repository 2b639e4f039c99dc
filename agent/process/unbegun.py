"""An arm that is asked to end before it has torque gets none."""

from __future__ import annotations

from agent.host.signals import StopFlag
from drivers.interface import Refusal


class Unbegun(Refusal):
    """An arm was asked to end before its torque came on; it stays off."""

    exit_code = 130

    @classmethod
    def check(cls, arm: str, stop: StopFlag) -> None:
        """Asked right before the torque.  Raises Unbegun."""
        if stop.stopped:
            raise cls(
                f"arm {arm}", found="a stop before its torque came on", expected="none; it stays off",
                remedy="start its agent again",
            )  # fmt: skip
