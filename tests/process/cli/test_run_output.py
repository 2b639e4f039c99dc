"""`coop run` for a script: a document alone on standard output, a word about missed bounds, a folder used again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import configs
from tests.support.command import coop as line
from tests.support.coop import PAPER, TIMEOUT_S
from tests.support.few import long
from tests.support.loaded import Loaded

COOP = [sys.executable, "-m", "agent.cli"]
SHORT = ("run", str(configs.CELLS_DIR / "paper.toml"), "--duration", "1")  # ends within the transient


def coop(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COOP, *arguments], cwd=cwd, capture_output=True, text=True, timeout=TIMEOUT_S)


def test_a_run_gives_one_document_with_results_and_paths(first_run: Path) -> None:
    code, out, err = json.loads((first_run / "said.json").read_text())
    document = json.loads(out)
    assert set(document) == {"schema", "log", "report", "interrupted", "gave_up", "within_bounds", "results"}
    assert (document["schema"], document["interrupted"], document["within_bounds"]) == (1, False, True)
    assert document["results"] == json.loads((first_run / "out" / "results.json").read_text())
    assert (first_run / document["log"]).read_bytes().startswith(b"\x89MCAP0")
    assert (first_run / document["report"]).name == "report.html"
    said = [text for text in err.splitlines() if "x real time, " not in text]  # how far a slow machine has come
    assert (code, said) == (0, []), "--strict has nothing to say"


@pytest.mark.long  # what is said is in tests/unit/report/test_bounds_missed.py
def test_a_bound_that_was_not_shown_is_said_in_one_line(tmp_path: Path) -> None:
    done = coop(*SHORT, "--out", "out", "--json", "--strict", cwd=tmp_path)
    assert json.loads(done.stdout)["within_bounds"] is False
    assert done.returncode == 6
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("coop: bounds of cell paper: found max_position_error_m not measured")
    assert "let it run longer" in done.stderr
    told = coop(*SHORT, "--out", "again", cwd=tmp_path)
    assert f"{Path('again/run.mcap')}: no usable row of plant after the transient of 20 s" in told.stderr


def test_a_folder_is_used_again_only_when_asked(first_run: Path) -> None:
    log = first_run / "out" / "run.mcap"
    before = log.read_bytes()
    assert before != b"an earlier run"
    refused = line(*SHORT, "--out", "out", cwd=first_run)
    assert (refused.code, refused.out) == (2, "")
    assert "earlier run" in refused.err
    assert "--force" in refused.err
    assert log.read_bytes() == before
    assert (first_run / "out" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "code"), [long((("check",), 0)), (("status",), 1), (("status", "--watch"), 0), long((("guide",), 0))]
)
def test_a_command_whose_output_nobody_reads_ends_with_its_own_code(words: tuple[str, ...], code: int) -> None:
    """As behind `| head -1`; what would go on for ever ends."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = Loaded(words[0], PAPER, *words[1:], stdout=writer)
        _, err = done.communicate(TIMEOUT_S)
    finally:
        os.close(writer)
    assert (done.returncode, err) == (code, "")
