"""A test with processes is made again where the machine had no core, with fixtures of its own, and only there."""

from __future__ import annotations

from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from tests.conftest import MADE_AGAIN, pytest_terminal_summary
from tests.process import conftest
from tests.support import stalls

FOLDERS: list[Path] = []
SOMEBODY_WAITED = stalls.SOMEBODY_WAITED
MACHINES: list[str] = []


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("paced")


def test_what_fails_on_a_machine_without_cores_is_made_again_and_told(
    folder: Path, request: pytest.FixtureRequest
) -> None:
    FOLDERS.append(folder)
    stalls.SOMEBODY_WAITED = -inf if len(FOLDERS) == 1 else SOMEBODY_WAITED
    assert len(FOLDERS) > 1, "the first time"
    assert len(set(FOLDERS)) == 2
    ((name, why),) = request.node.user_properties
    request.node.user_properties.clear()  # it is no news
    assert name == MADE_AGAIN
    assert "AssertionError; in " in why
    assert "somebody waited for a core" in why


@pytest.fixture(scope="module")
def machine() -> str:
    MACHINES.append("booted")
    stalls.SOMEBODY_WAITED = -inf if len(MACHINES) == 1 else SOMEBODY_WAITED
    assert len(MACHINES) > 1, "the first time it does not boot"
    return MACHINES[-1]


def test_a_fixture_of_many_tests_that_failed_is_made_again(machine: str, request: pytest.FixtureRequest) -> None:
    request.node.user_properties.clear()
    assert ["booted", machine] == MACHINES


@pytest.mark.parametrize(("accused", "times"), [("", 1), ("no core", stalls.ATTEMPTS)])
def test_what_fails_each_time_or_with_cores_fails(monkeypatch: pytest.MonkeyPatch, accused: str, times: int) -> None:
    report = SimpleNamespace(failed=True, when="call", longreprtext="trace\nE  what", outcome="failed")
    made: list[Any] = []
    monkeypatch.setattr(conftest, "runtestprotocol", lambda item, **_: made.append(item) or [report])
    monkeypatch.setattr(stalls.Kernel, "accuses", lambda _: accused)
    item = MagicMock(user_properties=[], path=Path(__file__))
    item.get_closest_marker.return_value = None
    assert conftest.pytest_runtest_protocol(item, None)
    assert len(made) == times
    assert item.user_properties == [(MADE_AGAIN, "E  what; no core")] * (times - 1)
    item.ihook.pytest_runtest_logreport.assert_called_once_with(report=report)
    assert report.outcome == "failed"


@pytest.mark.parametrize("path", [Path("tests/unit/test_whole.py").resolve(), Path(__file__).parent])
def test_what_is_in_no_process_is_made_once(path: Path) -> None:
    item = MagicMock(path=path)
    item.get_closest_marker.return_value = None
    assert conftest.pytest_runtest_protocol(item, None) is None


def test_what_was_made_again_is_named_at_the_end() -> None:
    reports = [
        SimpleNamespace(nodeid=f"test_{when}", when=when, user_properties=[(MADE_AGAIN, "why")])
        for when in ("setup", "call")
    ]
    terminal = MagicMock(stats={"passed": [*reports, SimpleNamespace(nodeid="test_plain", when="call")]})
    pytest_terminal_summary(terminal)
    terminal.write_line.assert_called_once_with("MADE AGAIN test_call: why")
