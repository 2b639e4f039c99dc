"""What can move arms; in a file of its own for processes that read no cell file."""

from __future__ import annotations

import enum


class DriverKind(enum.StrEnum):
    """What moves the arms of this cell."""

    SIM = "sim"
    DYNAMIXEL = "dynamixel"
