"""A run whose plant ends before its faults were carried out is no run with these faults.

What the deeds are, with all processes: tests/process/run/test_listeners.py.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.faults.listeners import Struck
from agent.faults.plan import Injection
from agent.faults.strikes import placed_at, strikes
from agent.host.child import Child, ChildFailed
from tests.support.nobody import Nobody


def test_faults_that_did_not_happen_are_a_failure(tmp_path: Path) -> None:
    cell = load_cell(Path("paper"), ["duration_s=2.0"])
    planned = strikes(cell, placed_at(cell, [Injection(fault="recorder-stuck", at_s=1.0, for_s=0.5)]))
    struck = Struck(cell, 1, tmp_path / "run.mcap", tmp_path, planned, "tcp/127.0.0.1:0")
    struck._plant = Child("plant", ["nothing"], tmp_path)  # it ends at once
    try:
        with pytest.raises(ChildFailed, match=r"plant: found ended with 2 instants of faults to come \(exit code 2\)"):
            struck.end(Nobody())
    finally:
        struck.abandon()
