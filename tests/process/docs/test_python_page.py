"""The examples of docs/python.md, run as they stand."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import pytest

from tests.support.command import coop
from tests.support.pages import commands, fences, here

EXAMPLES = fences("python.md", "python")
SAYS = ["('left', 'right') True ()", "200 rows, largest error ", "e_p_x_m", "mm off the desired motion", "run ended"]


def test_there_are_five_examples() -> None:
    assert len(EXAMPLES) == len(SAYS) == 5


@pytest.mark.parametrize(("example", "says"), list(zip(EXAMPLES, SAYS, strict=True)), ids=SAYS)
def test_an_example_runs_and_says_what_it_should(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, paper_runs: tuple[Path, Path], example: str, says: str
) -> None:
    monkeypatch.chdir(here(tmp_path, {"run.mcap": paper_runs[0] / "run.mcap"}))
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(example, "docs/python.md", "exec"), {})
    assert says in said.getvalue()


def test_the_commands_export_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, paper_runs: tuple[Path, Path]
) -> None:
    monkeypatch.chdir(here(tmp_path, {"run.mcap": paper_runs[0] / "run.mcap"}))
    whole, parquet, part = commands("python.md")
    part = [{"10": "1", "20": "2"}.get(word, word) for word in part]  # the run of the test is short
    for line in (whole, parquet, part):
        done = coop(*line[1:])
        assert (done.code, done.err) == (0, "")
    names = {"left.csv", "right.csv", "plant.csv", "events.csv", "columns.csv"}
    assert {path.name for path in (tmp_path / "run-csv").iterdir()} == names
    assert (tmp_path / "run-parquet" / "left.parquet").stat().st_size < (
        tmp_path / "run-csv" / "left.csv"
    ).stat().st_size / 2
    assert len((tmp_path / "here" / "left.csv").read_text().splitlines()) == 201
