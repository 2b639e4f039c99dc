"""Options of the test command: a real arm for the driver's contract, and how hypothesis chooses its examples."""

from __future__ import annotations

import os

import pytest
from hypothesis import Phase, settings

# The same examples in every run, so that a red run means a change; HYPOTHESIS_PROFILE=explore looks for new ones.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", derandomize=False, deadline=None)
# `make mutate` asks whether a test fails, not for the smallest example of it
settings.register_profile("mutate", derandomize=True, deadline=None, phases=(Phase.explicit, Phase.generate))
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_addoption(parser: pytest.Parser) -> None:
    """`-m hardware --hardware CELL --arm NAME`: supported, unloaded, nobody within reach.  `--fresh`: Debian trees."""
    group = parser.getgroup("hardware")
    group.addoption("--hardware", metavar="CELL", help="cell file of the real arm to test")
    group.addoption("--arm", metavar="NAME", help="which arm of that cell")
    parser.addoption("--fresh", action="store_true", help="build Debian trees and run in them (make test-fresh)")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what takes minutes and downloads, unless it is asked for."""
    if config.getoption("--fresh"):
        return
    for item in items:
        if item.get_closest_marker("fresh"):
            item.add_marker(pytest.mark.skip(reason="two minutes and 300 MB per Debian release: make test-fresh"))
