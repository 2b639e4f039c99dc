"""The refusal of an operator's word."""

from __future__ import annotations

from drivers.interface import Refusal


class ControlError(Refusal):
    """An operator's request was not accepted."""

    exit_code = 7
