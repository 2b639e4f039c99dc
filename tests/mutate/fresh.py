"""A change that only a fresh import can bring in (constants, defaults, classes): the tests start from nothing."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import CodeType, ModuleType

import pytest

from tests.mutate.forks import Tell
from tests.mutate.mutants import Mutant


class Changed(MetaPathFinder, Loader):
    """Finds one module, and gives it the changed code."""

    def __init__(self, mutant: Mutant) -> None:
        self._name = mutant.module
        self._code: CodeType = mutant.code()

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        """See `MetaPathFinder`."""
        if fullname != self._name:
            return None
        return spec_from_loader(fullname, self, origin=self._code.co_filename)

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed code."""
        module.__file__ = self._code.co_filename
        exec(self._code, module.__dict__)


class FirstFailure:
    """A pytest plugin that tells the first test, or the first file that cannot be imported, and ends the process."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Say what is running, for the case that it never ends."""
        self._tell(("running", nodeid))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A failure is all that was looked for."""
        if report.failed:
            self._fail(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file that cannot be imported is a failure too."""
        if report.failed:
            self._fail(f"{report.nodeid} (its import)")

    def _fail(self, name: str) -> None:
        self._tell(("failed", name))
        os._exit(0)


def run_fresh(mutant: Mutant, arguments: Sequence[str], tell: Tell) -> None:
    """Run the tests with the change, in a process that has not imported the module."""
    if mutant.module in sys.modules:
        raise RuntimeError(f"{mutant.module} is imported already")
    sys.meta_path.insert(0, Changed(mutant))
    if pytest.main([*arguments], plugins=[FirstFailure(tell)]) == pytest.ExitCode.OK:
        tell(("complete",))
