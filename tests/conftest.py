"""Options of the test command: a real arm for the driver's contract, and how hypothesis chooses its examples."""

from __future__ import annotations

import functools
import gc
import os
from collections.abc import Generator
from importlib import metadata

import pytest
from hypothesis import Phase, settings
from hypothesis.internal.conjecture import providers

from agent.host.starting import GARBAGE_AFTER, SETTINGS
from tests.support.shares import dealt

MADE_AGAIN = "made again"  # the property of a report that says why

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # read when numpy is loaded
    os.environ.setdefault(_library, SETTINGS[_library])

metadata.version = functools.cache(metadata.version)  # 4 ms for all that a log names, which tests ask a thousand times

pytest.register_assert_rewrite("tests.support.driver_contract")

# The same examples in every run, so that a red run means a change; HYPOTHESIS_PROFILE=explore looks for new ones.
# Hypothesis would also draw numbers and texts out of the modules that are loaded: by what has run before in a worker.
providers._get_local_constants = lambda: providers._local_constants
# Half of what hypothesis would take in `make test`, all of it in `make long`.
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=50)
settings.register_profile("explore", derandomize=False, deadline=None)
# `make mutate` asks whether a test fails, not for the smallest example of it
settings.register_profile(
    "mutate", derandomize=True, deadline=None, max_examples=50, phases=(Phase.explicit, Phase.generate)
)
# `make fuzz`: what is marked so, sixty times as many
settings.register_profile("long", derandomize=True, deadline=None, max_examples=3000)
# `make long`: all of the examples that a test names
settings.register_profile("whole", derandomize=True, deadline=None, max_examples=101)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--hardware CELL --arm NAME`: an arm, supported, unloaded, nobody within reach.  `--fresh`: Debian trees."""
    group = parser.getgroup("hardware")
    group.addoption("--hardware", metavar="CELL", help="cell file of the real arm to test (tests/hardware)")
    group.addoption("--arm", metavar="NAME", help="which arm of that cell")
    parser.addoption("--fresh", action="store_true", help="build Debian trees and run in them (make test-fresh)")


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Generator[None, None, None]:
    """Leave out what needs an arm, and what takes minutes and downloads, unless it is asked for; deal out the rest."""
    arm = config.getoption("--hardware") and config.getoption("--arm")
    for item in items:
        if item.get_closest_marker("realtime") and "tests/process/" not in item.nodeid:
            raise pytest.UsageError(f"{item.nodeid} is marked realtime: `make test` looks for these in tests/process")
        if item.get_closest_marker("fresh") and not config.getoption("--fresh"):
            item.add_marker(pytest.mark.skip(reason="two minutes and 300 MB per Debian release: make test-fresh"))
        if item.get_closest_marker("hardware") and not arm:
            item.add_marker(pytest.mark.skip(reason="needs a real arm: --hardware CELL --arm NAME"))
    yield  # what `-m` and `-k` leave out is out
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    waits, builds = (lambda item, room=room: room in item.nodeid for room in ("tests/process/", "tests/property/"))
    items[:] = dealt(items, workers, waits, builds, lambda item: item.path)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Spare the garbage collector 400 000 objects of modules and tests, which it would look through again and again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()
        gc.set_threshold(GARBAGE_AFTER)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """Behind each file spare it what the file has loaded, too: who serves a plant or servos asks for a collection."""
    try:
        return (yield)
    finally:
        if nextitem is not None and nextitem.path != item.path:
            gc.collect()
            gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name each test that failed at first: one that is seen here often has a race, not a slow machine."""
    for reports in list(terminalreporter.stats.values()):
        for report in reports:
            for name, why in getattr(report, "user_properties", ()):
                if name == MADE_AGAIN and report.when == "call":
                    terminalreporter.write_line(f"MADE AGAIN {report.nodeid}: {why}")
