"""A page of several runs: their errors, figures and settings beside each other, and nothing from elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from agent.log.read import RunLog
from agent.report.compare import Change, Difference
from agent.report.compare_page import render, write_comparison
from agent.report.metrics import summarise_prepared
from agent.report.numbers import number
from agent.report.overlay import overlay
from agent.report.prepared import prepare
from agent.report.results_file import ReportError
from agent.report.settings import ABSENT, different, settings_of, settings_table
from agent.report.shown import ComparedRun, error_series
from tests.support.view_run import view_log
from tests.unit.report.test_report import Page


def compared(log: RunLog, name: str) -> ComparedRun:
    run = prepare(log)
    return ComparedRun(Path(name), summarise_prepared(run), settings_of(log), error_series(run))


def changed(old: bytes, new: bytes) -> RunLog:
    log = view_log()
    assert old in log.attachments["cell.toml"]
    log.attachments["cell.toml"] = log.attachments["cell.toml"].replace(old, new)
    return log


@pytest.fixture(scope="module")
def runs() -> list[ComparedRun]:
    worse = changed(b"load_share = 0.5", b"load_share = 0.4")
    for rows in worse.agents.values():
        rows["p_object"][:, 1] += 1e-3
    assert worse.plant is not None
    worse.plant["p_object"][:, 1] += 1e-3
    third = changed(b'name = "paper"', b'name = "paper"\nseed = 3')
    return [compared(view_log(), "a.mcap"), compared(worse, "b.mcap"), compared(third, "c.mcap")]


@pytest.fixture(scope="module")
def rendered(runs: list[ComparedRun]) -> str:
    return render(runs)


def test_settings_are_told_by_key_and_arms_by_name(runs: list[ComparedRun]) -> None:
    found = {setting.key: setting.values for setting in different([run.settings for run in runs])}
    assert found == {
        "arms.left.load_share": ("0.5", "0.4", "0.5"),
        "arms.right.load_share": ("0.5", "0.4", "0.5"),
        "seed": (ABSENT, ABSENT, "3"),
    }


def test_that_no_setting_differs_is_said(runs: list[ComparedRun]) -> None:
    def keys(*letters: int) -> list[object]:
        return list(settings_table([runs[i].settings for i in letters]).columns[0].cells)

    assert keys(0, 0) == ["none"]
    assert keys(0, 1) == ["arms.left.load_share", "arms.right.load_share"]


def test_another_arm_file_is_another_setting() -> None:
    log = view_log()
    log.attachments["widowx_mk2.urdf"] += b"\n"
    keys = [setting.key for setting in different([settings_of(view_log()), settings_of(log)])]
    assert keys == ["file widowx_mk2.urdf"]


def test_a_log_without_files_says_so() -> None:
    log = view_log()
    log.attachments.clear()
    assert settings_of(log) == {
        "cell file": "not in the log, or not readable", "run.json": "not in the log, or not readable"
    }  # fmt: skip


def test_the_page_holds_every_run_against_the_first(rendered: str) -> None:
    page = Page()
    page.feed(rendered)
    page.close()
    assert page.open == []
    assert len(page.images) == 1
    for word in ("3 runs of paper", "B against A", "C against A", "worse, +", "arms.left.load_share", "a.mcap"):
        assert word in page.text


def test_the_figure_has_a_line_of_each_run_and_scales_of_its_own(runs: list[ComparedRun]) -> None:
    figure = overlay([run.errors for run in runs])
    start, rest = figure.axes[:2]
    assert [line.get_label() for line in start.lines] == ["A", "B", "C"]
    assert len({line.get_linestyle() for line in start.lines}) == 3
    assert start.lines[0].get_ydata()[0] == pytest.approx(1e3 * np.hypot(0.001, 0.003))
    assert rest.lines[0].get_xdata().size == 0  # two seconds end before the transient does


def test_settings_are_shown_as_they_are_and_not_as_styles() -> None:
    shown = settings_table([{"file [/].csv": "[red]"}, {}])
    console = Console(width=80)
    with console.capture() as captured:
        console.print(shown)
    assert "file [/].csv   [red]" in captured.get()


def test_a_log_whose_name_is_no_text_has_a_page(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_comparison([compared(view_log(), "\udcff.mcap") for _ in "AB"], path)
    assert "\\udcff.mcap" in path.read_text()


def test_a_page_that_cannot_be_written_leaves_what_was_there(
    runs: list[ComparedRun], rendered: str, tmp_path: Path
) -> None:
    with pytest.raises(ReportError, match="No such file"):
        write_comparison(runs[:2], tmp_path / "nowhere" / "page.html")
    path = tmp_path / "page.html"
    write_comparison(runs, path)
    assert path.read_text() == rendered
    assert list(tmp_path.iterdir()) == [path]


def test_an_immense_figure_is_short() -> None:
    assert number(7e90, "rad/s").replace("\N{NO-BREAK SPACE}", " ") == "> 1000000000 rad/s"
    assert number(-7e90) == "< −\N{SPACE}1000000000"
    far = Difference("x", "m", 1.0, 1e30, Change.WORSE)
    assert far.words == "worse, over 1000 times"
    assert replace(far, b=1.1).words == "worse, +10.0 %"
    assert replace(far, a=0.0).words == "worse"
