"""The refusals of an operator's word."""

from __future__ import annotations

from drivers.interface import Refusal


class ControlError(Refusal):
    """An operator's request was not accepted."""

    exit_code = 7


class ControlPlaceError(ControlError):
    """An agent cannot listen for operators where it was told to; nothing was begun."""

    exit_code = 2


class InstantError(ControlError):
    """A command line that names no instant, two of them, or one that cannot be read; no arm has been asked."""

    exit_code = 2
