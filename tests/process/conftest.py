"""Runs that several test files read and none changes: made once for each worker."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.coop import PAPER, coop

PAPER_RUN_S = 3


@pytest.fixture(scope="session")
def paper_runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folders of two runs of the paper's cell, `PAPER_RUN_S` long."""
    folder = tmp_path_factory.mktemp("paper")
    for name in ("a", "b"):
        done = coop("run", PAPER, "--duration", PAPER_RUN_S, "--out", name, cwd=folder)
        assert done.returncode == 0, done.stderr
    return folder / "a", folder / "b"
