"""The way to an arm's port: at which speed it is opened, and what a port that is lost on the way is called."""

from __future__ import annotations

from typing import Any, cast

import pytest

from drivers.dynamixel.connected import opened
from drivers.dynamixel.errors import PortError, PortLostError, WriteTimeoutError
from drivers.dynamixel.line.port import Port
from drivers.interface import Refusal

SAID: dict[str, Any] = {"found": "no device", "expected": "an adapter", "remedy": "plug it in"}


class Line:
    """A port that was last used at another speed."""

    def __init__(self, trouble: Refusal | None = None) -> None:
        self.baud, self.opened_at, self._trouble = 57_600, 0, trouble

    def open(self) -> None:
        if self._trouble is not None:
            raise self._trouble
        self.opened_at = self.baud


def test_a_port_is_opened_at_the_speed_of_its_arm() -> None:
    line = Line()
    with opened(cast("Port", line), 1_000_000):
        assert line.opened_at == 1_000_000


@pytest.mark.parametrize("kind", [PortLostError, WriteTimeoutError])
@pytest.mark.parametrize("when", ["as it is opened", "later"])
def test_a_port_that_is_lost_before_the_arm_is_connected_cannot_be_used(kind: type[Refusal], when: str) -> None:
    trouble = kind("port /dev/ttyDXL_left", **SAID)
    line = Line(trouble if when == "as it is opened" else None)
    said = "port /dev/ttyDXL_left: found no device, expected an adapter; plug"
    with pytest.raises(PortError, match=said) as raised, opened(cast("Port", line), 1_000_000):
        raise trouble
    assert raised.value.__cause__ is trouble
