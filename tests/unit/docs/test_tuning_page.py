"""What docs/tuning.md says of shipped cells is what their check finds today."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.verify.check import examine
from agent.verify.disagreement import Disagreement
from agent.verify.robustness import Robustness
from tests.support.documents import ROOT

PAGE = (ROOT / "docs/tuning.md").read_text()
CELLS = ("paper", "paper_real", "two_wx200", "two_models", "three_wx250s", "four_wx250s")


def checked(name: str, *settings: str) -> Robustness:
    found = examine(load_cell(Path(name), settings), thorough=True).robustness
    assert found is not None
    return found


def written(arms: tuple[Disagreement, ...]) -> str:
    most = max(arms, key=lambda arm: arm.force_N)
    return f"{most.force_N:.1f} N, {most.moment_Nm:#.2g} N·m"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "two_wx200" else pytest.mark.long) for name in CELLS]
)
def test_shares_of_stall_and_internal_wrenches_are_those_of_the_check(name: str) -> None:
    _, _, disagree = PAGE.partition("### Arms that disagree")
    row = re.search(rf"^\| `{name}`[^|]*\| ([^|]*) \| ([^|]*) \|$", disagree, re.MULTILINE)
    assert row is not None
    found = checked(name)
    assert row[1] == written(found.disagreement)
    alone = checked(name, "controller.alignment.enabled=false") if name != "paper" else found
    assert row[2] == written(alone.disagreement)
    share = f"{max(s.limp.most.share for s in found.support) * 100:.0f}"
    (sentence,) = re.findall(r"^Static shares of .*?: other", PAGE, re.MULTILINE | re.DOTALL)
    assert re.search(rf"\b{share}\b", sentence)
