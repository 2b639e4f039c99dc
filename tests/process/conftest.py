"""Runs that several test files read and none changes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.coop import coop
from tests.support.once import once

PAPER_RUN_S = 3
TRANSIENT_S = 1.0
PAPER_RUN = ("paper", "--duration", PAPER_RUN_S, "--set", f"report.transient_s={TRANSIENT_S}")
SHORT = ("--duration", 1.5, "--set", "report.transient_s=0.5", "--no-report")  # of a run whose length says nothing
WAITING = (
    "paper", "--duration", 2, "--set", "simulation.ready_s=0.5", "--set", "controller.alignment.max_m=0.02",
    "--set", "report.transient_s=1", "--no-report",
)  # fmt: skip
WIRE_RUN = ("two_wx200", "--wire", "--duration", 20, "--set", "report.transient_s=8")

RunOf = Callable[..., Path]


@pytest.fixture(scope="session")
def run_of(tmp_path_factory: pytest.TempPathFactory) -> RunOf:
    """The folder of `coop run` with these words; whoever asks for the same words gets the same run."""

    def folder_of(*words: str | float) -> Path:
        def make(folder: Path) -> None:
            done = coop("run", *words, "--out", "out", cwd=folder)
            assert done.returncode == 0, done.stderr

        name = hashlib.sha256(repr(tuple(map(str, words))).encode()).hexdigest()[:16]
        return once(tmp_path_factory, f"run-{name}", make) / "out"

    return folder_of


@pytest.fixture(scope="session")
def paper_runs(run_of: RunOf) -> tuple[Path, Path]:
    """Folders of two runs of the paper's cell, `PAPER_RUN_S` long, the first with its report."""
    return run_of(*PAPER_RUN), run_of(*PAPER_RUN, "--no-report")
