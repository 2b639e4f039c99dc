"""A report is whole or not there, needs nothing beside its page, and says what a poor log cannot show."""

from __future__ import annotations

import base64
import itertools
import json
import resource
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from rich.console import Console

from agent.report.gallery import pictures
from agent.report.page import pictures_in
from agent.report.prepared import Prepared, prepare
from agent.report.report import ReportFiles, write_report
from agent.report.results_file import ReportError, folder_of, terminal_table
from agent.telemetry.row.event import Event, Level
from agent.view.film import still
from tests.support.telemetry.synthetic_run import paper_run, spatial_run
from tests.support.view_run import view_log

PNG = b"\x89PNG\r\n\x1a\n"
SOME = ("pose", "errors", "errors_start", "torques", "wrenches", "loop_timing")  # test_figures.py draws them all
VOID = {"meta", "img", "br", "hr", "link"}


class Page(HTMLParser):
    """Refuses a tag that is not closed, closed twice, or that fetches something."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in {"script", "link", "iframe"}
        for name, value in attrs:
            if name in {"src", "href"}:
                assert (value or "").startswith("data:"), f"{tag} fetches {value}"
        if tag == "img":
            self.images.append(dict(attrs)["src"] or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data.replace("\N{NO-BREAK SPACE}", " ")


def read_page(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    page.close()
    assert page.open == []
    return page


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> ReportFiles:
    log = paper_run(Path("run.mcap"), duration_s=25.0, adaptive=True)
    log.events.append(
        Event(1_800_000_001_500_000_000, "left", Level.WARN, "torque <limited>: lower k_p & wait", {"tau_Nm": 3.25})
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("agent.report.report.pictures", lambda run: [p for p in pictures(run) if p.stem in SOME])
        return write_report(log, tmp_path_factory.mktemp("report") / "new" / "folder")


def test_every_figure_is_a_png_of_some_size(written: ReportFiles) -> None:
    assert tuple(written.figures) == SOME
    for path in written.figures.values():
        content = path.read_bytes()
        assert content.startswith(PNG)
        assert len(content) > 10_000


def test_a_page_tells_the_names_of_its_pictures(written: ReportFiles) -> None:
    assert pictures_in(written.html.read_bytes()) == [path.name for path in written.figures.values()]


def test_the_page_is_well_formed_and_needs_nothing_else(written: ReportFiles) -> None:
    page = read_page(written.html)
    embedded = {base64.b64decode(source.removeprefix("data:image/png;base64,")) for source in page.images}
    assert embedded == {path.read_bytes() for path in written.figures.values()}


def test_the_page_shows_bounds_verdicts_events_and_provenance(written: ReportFiles) -> None:
    text = read_page(written.html).text
    for expected in (
        "≤ 0.500 mm",
        "0.200 mm",
        "✓ met",
        "torque <limited>",
        "lower k_p & wait",
        "5f" * 32,
        "widowx_mk2",
    ):
        assert expected in text


def test_results_json_is_what_the_results_say(written: ReportFiles) -> None:
    content = json.loads(written.results_file.read_text(encoding="utf-8"))
    assert content == json.loads(json.dumps(written.results.to_json()))
    assert content["max_position_error_m"] == pytest.approx(2e-4, rel=1e-6)
    assert content["verdicts"] == {"max_position_error_m": "met", "max_attitude_error_rad": "met"}
    assert content["complete"] is True


def test_nothing_is_left_beside_the_report(written: ReportFiles) -> None:
    expected = {written.html, written.results_file, *written.figures.values()}
    assert set(written.html.parent.iterdir()) == expected


def test_the_terminal_table_fits_eighty_columns_and_has_the_verdicts(written: ReportFiles) -> None:
    console = Console(width=80, record=True, file=None, quiet=False, force_terminal=False)
    with console.capture() as captured:
        console.print(terminal_table(written.results))
    text = captured.get()
    assert "…" not in text
    assert text.count("✓ met") == 3
    assert "largest position error" in text


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """One picture instead of twenty, where nothing is said of them."""
    monkeypatch.setattr("agent.report.report.pictures", lambda run: itertools.islice(pictures(run), 1))


@pytest.mark.usefixtures("few")
def test_a_report_that_fails_leaves_the_last_one_untouched(tmp_path: Path) -> None:
    log = paper_run(Path("run.mcap"), duration_s=25.0)
    largest = max(path.stat().st_size for path in write_report(log, tmp_path).figures.values())
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    log.agents["left"]["p_object"] += 1.0
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest + 20_000, unlimited[1]))  # figures fit, the page does not
    try:
        with pytest.raises(ReportError, match="File too large"):
            write_report(log, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_folder_in_the_place_of_a_file_leaves_the_report_before_as_it_was(tmp_path: Path) -> None:
    def write() -> None:
        with folder_of(tmp_path) as draft:
            for name in ("report.html", "results.json"):
                (draft / name).write_text("after")

    (tmp_path / "results.json").mkdir()
    (tmp_path / "report.html").write_text("before")
    with pytest.raises(ReportError, match=f"file {tmp_path}/results.json: found a folder, expected a file"):
        write()
    assert (tmp_path / "report.html").read_text() == "before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "results.json"]


def test_a_place_that_is_a_file_is_refused_with_a_remedy(tmp_path: Path) -> None:
    place = tmp_path / "taken"
    place.write_text("here first")
    with pytest.raises(ReportError, match="name another directory") as refused:
        write_report(paper_run(Path("run.mcap"), duration_s=25.0), place)
    assert str(place) in refused.value.found
    assert place.read_text() == "here first"


def test_a_log_without_rows_still_gets_a_page_that_says_so(tmp_path: Path) -> None:
    log = paper_run(Path("run.mcap"), duration_s=25.0)
    files = write_report(replace(log, agents={}, plant=None, complete=False), tmp_path)
    text = read_page(files.html).text
    assert "no row of the arm left" in text
    assert "0 of 10000" in text
    assert "✗ not met" in text
    assert files.figures == {}


@pytest.mark.usefixtures("few")
def test_a_log_that_ends_in_the_transient_shows_its_figures_and_no_verdict(tmp_path: Path) -> None:
    log = paper_run(Path("run.mcap"), duration_s=25.0)
    cut = {name: rows[:1000] for name, rows in log.agents.items()}
    assert log.plant is not None
    files = write_report(replace(log, agents=cut, plant=log.plant[:1000]), tmp_path)
    text = read_page(files.html).text
    assert "no usable row of plant after the transient of 20 s" in text
    assert "? not shown" in text
    assert "pose" in files.figures


def test_three_six_joint_arms_without_a_plant_have_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, own = spatial_run(Path("run.mcap"), duration_s=25.0), [f"torque_terms_arm{i}" for i in range(3)]
    assert [picture.stem for picture in pictures(prepare(log)) if picture.stem in own] == own
    monkeypatch.setattr(
        "agent.report.report.pictures", lambda run: [picture for picture in pictures(run) if picture.stem == own[2]]
    )
    files = write_report(log, tmp_path)
    assert list(files.figures) == own[2:]
    text = read_page(files.html).text
    assert "seen by arm2" in text
    assert "no simulation in the log" in text


@pytest.mark.usefixtures("few")
def test_the_page_opens_with_the_cell_at_the_start(tmp_path: Path) -> None:
    drawn: list[bytes] = []

    def first(run: Prepared) -> bytes:
        drawn.append(still(run))
        return drawn[-1]

    files = write_report(view_log(), tmp_path, first)
    picture = (tmp_path / "start.png").read_bytes()
    assert drawn == [picture]
    assert next(iter(files.figures)) == "start"
    assert '<figure id="start">' in files.html.read_text()
    assert "#start img { width: 100%; }" in files.html.read_text(), "a phone shows both arms at once"
    assert base64.b64decode(read_page(files.html).images[0].removeprefix("data:image/png;base64,")) == picture


@pytest.mark.usefixtures("few")
def test_a_log_that_does_not_say_how_its_cell_looks_has_no_such_picture(tmp_path: Path) -> None:
    files = write_report(paper_run(Path("run.mcap"), duration_s=2.0), tmp_path, still)
    assert "start" not in files.figures
    assert not (tmp_path / "start.png").exists()
