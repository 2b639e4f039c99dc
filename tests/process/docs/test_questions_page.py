"""The commands of docs/questions.md, run as they stand but for the length of the runs; each gives its answer."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.process.conftest import SHORT, RunOf
from tests.support.command import coop
from tests.support.documents import ROOT
from tests.support.pages import fences

QUESTIONS = re.findall(r"^## (.*)$", (ROOT / "docs/questions.md").read_text(), re.MULTILINE)
BLOCKS = fences("questions.md", "")


def test_there_are_five_questions_with_a_block_of_commands_each() -> None:
    assert len(QUESTIONS) == len(BLOCKS) == 5
    assert all(question.endswith("?") for question in QUESTIONS)


@pytest.fixture
def answer(tmp_path: Path, run_of: RunOf, paper_runs: tuple[Path, Path]) -> Callable[[str], str]:
    """What the last command of a block says; those before it are runs, each of them one that no other line is."""

    def say(block: str) -> str:
        *runs, last = [line.split() for line in block.splitlines()]
        plain = iter(paper_runs)
        for line in runs:
            *words, out, name = line
            assert (words[:2], out) == (["coop", "run"], "--out")
            made = next(plain) if words[2:] == ["paper"] else run_of(*words[2:], *SHORT)
            (tmp_path / name).symlink_to(made)
        done = coop(*last[1:], cwd=tmp_path)
        assert done.code == 0, done.err
        return done.out

    return say


@pytest.mark.long  # two runs of which nobody else needs one; `coop compare` is in tests/unit/cli
def test_did_the_adaptive_law_help(answer: Callable[[str], str]) -> None:
    said = answer(BLOCKS[0])
    assert re.search(r"A: paper_adaptive, known law.*\n.*B: paper_adaptive, adaptive law", said)
    assert re.search(r"rms_position_error_m .* (better|worse)", said)


def test_why_did_the_arm_hold(answer: Callable[[str], str]) -> None:
    said = answer(BLOCKS[1])
    for arm in ("left", "right"):
        assert re.search(rf"0\.\d\d\d s +{arm} +WARN +mode TRACK → HOLD", said), said
        assert re.search(rf"0\.\d\d\d s +{arm} +WARN +safety: off track", said), said
        assert re.search(rf"(?m)\d s +{arm} +INFO +run ended in HOLD t = [0-9.]+ s: OFF_TRACK$", said), said


def test_which_arm_is_badly_calibrated(answer: Callable[[str], str]) -> None:
    said = answer(BLOCKS[2])
    assert "against the true object" in said
    offsets = re.findall(r"(left|right) +([\d.]+) mm", said)
    assert [arm for arm, _ in offsets] == ["left", "right"]
    assert all(float(mm) < 0.3 for _, mm in offsets), "both are as the cell says"


@pytest.mark.long  # a run that nobody else needs; the same command answers the question above
def test_how_much_friction_margin_is_left(answer: Callable[[str], str]) -> None:
    said = answer(BLOCKS[3])
    found = re.findall(r"(left|right) .* ([\d.]+) N +6\.00 N +([\d.]+) N", said)
    assert [arm for arm, *_ in found] == ["left", "right"]
    for _, force, margin in found:
        assert float(margin) == pytest.approx(6.0 - float(force), abs=0.011)


def test_are_these_two_runs_the_same(answer: Callable[[str], str]) -> None:
    said = answer(BLOCKS[4])
    assert said.count("rows in both, all equal but for timing\n") == 3
