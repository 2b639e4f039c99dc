"""Ctrl-C where `coop run` asks nobody: while a cell is examined, and while the report is made."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.host.signals import StopFlag
from agent.process.run import ReportStopped, RunOptions, run_cell
from agent.process.run import _reported as reported
from agent.process.run_kind import RunKind
from tests.support.coop import PAPER
from tests.support.stops import stop_flag


class _StoppedAtOnce:
    """A person who presses Ctrl-C when the first thing is done."""

    def phase(self, what: str, **_: object) -> None:
        assert what == "checking"
        signal.raise_signal(signal.SIGINT)

    def advance(self, *how_far: object) -> None:
        raise AssertionError(how_far)


@pytest.fixture
def stop() -> Iterator[StopFlag]:
    with stop_flag() as flag:
        yield flag


def test_ctrl_c_while_a_cell_is_examined_starts_nothing(tmp_path: Path, stop: StopFlag) -> None:
    options = RunOptions(PAPER, (), 1.0, tmp_path / "out", 0, RunKind.LOCKSTEP)
    with pytest.raises(KeyboardInterrupt):
        run_cell(options, stop, _StoppedAtOnce())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("drawn", [True, False])
def test_ctrl_c_while_the_report_is_made_leaves_the_log_and_nothing_half_done(
    drawn: bool, tmp_path: Path, paper_runs: tuple[Path, Path], stop: StopFlag, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = Path(shutil.copy(paper_runs[0] / "run.mcap", tmp_path))
    late = "agent.view.film.still" if drawn else "agent.process.run.write_results"
    monkeypatch.setattr(late, lambda *_: signal.raise_signal(signal.SIGINT))
    words = r"run.mcap: found a stop while it was made, .* `coop report` makes it"
    with pytest.raises(ReportStopped, match=words) as told:
        reported(log, tmp_path, stop, drawn=drawn)
    assert told.value.exit_code == 130
    assert list(tmp_path.iterdir()) == [log]
