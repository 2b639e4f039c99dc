"""Commands on a log take memory for what they look at, not for the log."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.log.read import read_log
from tests.support.measured import measured
from tests.support.telemetry.long_log import make_long_log

DURATION_S = 100.0
BYTES_CUT = 50


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 MB, 132 MB of rows."""
    path = tmp_path_factory.mktemp("long") / "run.mcap"
    make_long_log(path, DURATION_S)
    return path


@pytest.mark.long  # `make bench` has the report of 100 s and of 2000 s
def test_a_report_never_holds_the_rows(log: Path, tmp_path: Path) -> None:
    """A report of 100 s may take 250 MB; with the rows in memory it takes 300, 50 of them to draw the cell."""
    assert measured("report", log, "--out", tmp_path).peak_MB < 225


@pytest.mark.long
def test_a_comparison_never_holds_the_rows(log: Path) -> None:
    assert measured("compare", log, log).peak_MB < 120


@pytest.mark.long
def test_a_repair_never_holds_the_file(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(log.read_bytes()[:-BYTES_CUT])
    assert measured("recover", path).peak_MB < 80
    assert read_log(path).problems == ()
