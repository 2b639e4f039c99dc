"""The commands of docs/questions.md, run as they stand but for the length of the runs; each gives its answer."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.coop import coop as run_process
from tests.support.documents import ROOT
from tests.support.pages import fences

SHORT = ("--no-report", "--duration", "1.5", "--set", "report.transient_s=0.5")  # of every run
QUESTIONS = re.findall(r"^## (.*)$", (ROOT / "docs/questions.md").read_text(), re.MULTILINE)
BLOCKS = fences("questions.md", "")


def test_there_are_five_questions_with_a_block_of_commands_each() -> None:
    assert len(QUESTIONS) == len(BLOCKS) == 5
    assert all(question.endswith("?") for question in QUESTIONS)


def answer(block: str, folder: Path) -> str:
    """What the last command of a block says; those before it are runs."""
    *runs, last = [line.split() for line in block.splitlines()]
    for line in runs:
        assert line[:2] == ["coop", "run"]
        done = run_process(*line[1:], *SHORT, cwd=folder)
        assert done.returncode == 0, done.stderr
    done = run_process(*last[1:], cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_did_the_adaptive_law_help(tmp_path: Path) -> None:
    said = answer(BLOCKS[0], tmp_path)
    assert re.search(r"A: paper_adaptive, known law.*\n.*B: paper_adaptive, adaptive law", said)
    assert re.search(r"rms_position_error_m .* (better|worse)", said)


def test_why_did_the_arm_hold(tmp_path: Path) -> None:
    said = answer(BLOCKS[1], tmp_path)
    for arm in ("left", "right"):
        assert re.search(rf"0\.\d\d\d s +{arm} +WARN +mode TRACK → HOLD", said), said
        assert re.search(rf"0\.\d\d\d s +{arm} +WARN +safety: off track", said), said
        assert re.search(rf"\d s +{arm} +INFO +run ended in HOLD t = .*OFF_TRACK", said), said


def test_which_arm_is_badly_calibrated(tmp_path: Path) -> None:
    said = answer(BLOCKS[2], tmp_path)
    assert "against the true object" in said
    offsets = re.findall(r"(left|right) +([\d.]+) mm", said)
    assert [arm for arm, _ in offsets] == ["left", "right"]
    assert all(float(mm) < 0.3 for _, mm in offsets), "both are as the cell says"


def test_how_much_friction_margin_is_left(tmp_path: Path) -> None:
    said = answer(BLOCKS[3], tmp_path)
    found = re.findall(r"(left|right) .* ([\d.]+) N +6\.00 N +([\d.]+) N", said)
    assert [arm for arm, *_ in found] == ["left", "right"]
    for _, force, margin in found:
        assert float(margin) == pytest.approx(6.0 - float(force), abs=0.011)


def test_are_these_two_runs_the_same(tmp_path: Path) -> None:
    said = answer(BLOCKS[4], tmp_path)
    assert said.count("rows in both, all equal but for timing\n") == 3
