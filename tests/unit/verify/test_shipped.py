"""Every cell that ships passes all that `coop check` looks at, and for real arms too where it is for them."""

from __future__ import annotations

from pathlib import Path

import pytest

import configs
from agent.config.cell import load_cell
from agent.verify.check import examine
from agent.verify.finding import Verdict
from tests.support.few import few

SIMULATED = {"paper", "paper_ideal"}  # the paper's gains: README and their own first lines say so
QUICK = {"identify_wx200", "paper_real", "two_wx200"}


@pytest.mark.parametrize(
    "name", few(sorted(path.stem for path in configs.CELLS_DIR.glob("*.toml")), QUICK.__contains__)
)
def test_a_shipped_cell_is_not_refused(name: str) -> None:
    servos = [] if name in SIMULATED else ['driver="dynamixel"']
    report = examine(load_cell(Path(name), servos), wired=True, thorough=True)
    assert [f for f in report.findings if f.verdict is Verdict.REFUSED] == []
