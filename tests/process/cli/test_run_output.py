"""`coop run` for a script: a document alone on standard output, a word about missed bounds, a folder used again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import configs
from tests.support.command import coop as line

COOP = [sys.executable, "-m", "agent.cli"]
SHORT = ("run", str(configs.CELLS_DIR / "paper.toml"), "--duration", "1")  # ends within the transient


def coop(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COOP, *arguments], cwd=cwd, capture_output=True, text=True, timeout=110)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A run over an earlier one, with --json and --strict, too short to show that it keeps its bounds."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "out").mkdir()
    (folder / "out" / "run.mcap").write_text("an earlier run")
    (folder / "out" / "notes.txt").write_text("mine")
    return folder, coop(*SHORT, "--out", "out", "--force", "--json", "--strict", cwd=folder)


def test_a_run_gives_one_document_with_results_and_paths(
    run: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    folder, done = run
    document = json.loads(done.stdout)
    assert set(document) == {"schema", "log", "report", "interrupted", "gave_up", "within_bounds", "results"}
    assert (document["schema"], document["interrupted"], document["within_bounds"]) == (1, False, False)
    assert document["results"] == json.loads((folder / "out" / "results.json").read_text())
    assert (folder / document["log"]).read_bytes().startswith(b"\x89MCAP0")
    assert (folder / document["report"]).name == "report.html"


def test_a_bound_that_was_not_shown_is_said_in_one_line(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    _, done = run
    assert done.returncode == 6
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("coop: bounds of cell paper: found max_position_error_m nan not shown")
    assert "let it run longer" in done.stderr


def test_a_folder_is_used_again_only_when_asked(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    folder, _ = run
    log = folder / "out" / "run.mcap"
    before = log.read_bytes()
    refused = line(*SHORT, "--out", "out", cwd=folder)
    assert (refused.code, refused.out) == (2, "")
    assert "earlier run" in refused.err
    assert "--force" in refused.err
    assert log.read_bytes() == before
    assert (folder / "out" / "notes.txt").read_text() == "mine"
