"""Runs that several test files read and none changes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.coop import PAPER, coop
from tests.support.once import once

PAPER_RUN_S = 3


@pytest.fixture(scope="session")
def paper_runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folders of two runs of the paper's cell, `PAPER_RUN_S` long."""

    def make(folder: Path) -> None:
        for name, *options in (("a",), ("b", "--no-report")):
            done = coop("run", PAPER, "--duration", PAPER_RUN_S, "--out", name, *options, cwd=folder)
            assert done.returncode == 0, done.stderr

    folder = once(tmp_path_factory, "paper-runs", make)
    return folder / "a", folder / "b"
