"""An arm that is asked to end before it has torque gets none; a command that is, while its processes start, is over."""

from __future__ import annotations

from agent.host.signals import StopFlag
from agent.operator.socket import ControlSocket
from agent.operator.table import Verb
from drivers.interface import Refusal

_ENDING = {Verb.STOP, Verb.RELEASE}


class StoppedEarly(Refusal):
    """A command was stopped while its processes started; no arm has torque any more."""

    exit_code = 130

    @classmethod
    def of(cls, what: str) -> StoppedEarly:
        """The error of a command: what it was to do."""
        found, expected = "a stop while its processes started", "time for them to be ready"
        return cls(what, found=found, expected=expected, remedy="start it again")


class Unbegun(Refusal):
    """An arm was asked to end before its torque came on; it stays off."""

    exit_code = 130

    @classmethod
    def check(cls, arm: str, stop: StopFlag, control: ControlSocket | None) -> None:
        """Asked while the agent waits, and right before the torque: by signal or over its socket.  Raises Unbegun."""
        if control is not None:
            control.poll()
        if stop.stopped or (control is not None and not _ENDING.isdisjoint(control.requests.words)):
            raise cls(
                f"arm {arm}", found="a stop before its torque came on", expected="none; it stays off",
                remedy="start its agent again",
            )  # fmt: skip
