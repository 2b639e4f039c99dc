"""Options of the test command: a real arm for the driver's contract."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """`pytest -m hardware --hardware CELL --arm NAME`: supported, unloaded, nobody within reach."""
    group = parser.getgroup("hardware")
    group.addoption("--hardware", metavar="CELL", help="cell file of the real arm to test")
    group.addoption("--arm", metavar="NAME", help="which arm of that cell")
