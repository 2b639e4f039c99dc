"""Comparing two runs: what differs is shown, and better means what the figure says it means."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from agent.cli.documents import compare_document
from agent.report.compare import Change, compare, comparison_table
from agent.report.metrics import summarise
from agent.report.results import Results
from agent.report.shown import ComparedRun
from tests.support.telemetry.synthetic_run import paper_run


def results(*, offset_m: float = 0.0, plant: bool = True, keep: int = 5000) -> Results:
    log = paper_run(Path("run.mcap"), duration_s=25.0, plant=plant)
    for rows in [*log.agents.values(), *([log.plant] if log.plant is not None else [])]:
        rows["p_object"][:, 1] += offset_m
    agents = {name: rows[:keep] for name, rows in log.agents.items()}
    return summarise(replace(log, agents=agents))


def test_a_run_compared_with_itself_has_no_difference() -> None:
    run = results()
    found = compare(run, run)
    assert {d.change for d in found if math.isfinite(d.a)} == {Change.SAME}
    assert not any(d.differs for d in found)


def test_what_neither_run_measured_is_not_known_to_be_the_same() -> None:
    a, b = results(plant=False), results(plant=False)
    changes = {d.name: d for d in compare(a, b)}
    share = changes["arms.left.load_share_realised"]
    assert (share.change, share.differs, share.words) == (Change.UNKNOWN, False, "not known")
    assert {d.change for d in changes.values()} == {Change.SAME, Change.UNKNOWN}
    console = Console(width=140)
    with console.capture() as captured:
        console.print(comparison_table(a, b, compare(a, b)))
    assert "load_share_realised" not in captured.get()
    runs = [ComparedRun(Path(name), of, {}, None) for name, of in (("a", a), ("b", b), ("c", results()))]
    figures = {figure["name"]: figure for figure in compare_document(runs)["figures"]}
    one = figures["arms.left.load_share_realised"]
    assert (one["change"], one["changes"]) == ("unknown", ["unknown", "unknown", "appeared"])
    assert figures["by_plant.rms_position_error_m"]["changes"] == ["unknown", "unknown", "appeared"], (
        "a part of C alone"
    )
    assert figures["late_cycles"]["changes"] == ["same", "same", "same"]


def test_a_smaller_error_is_better_and_fewer_rows_are_worse() -> None:
    changes = {d.name: d for d in compare(results(offset_m=1e-3), results(keep=4900))}
    assert changes["max_position_error_m"].change is Change.BETTER
    assert changes["max_position_error_m"].relative == pytest.approx(-0.8, abs=0.01)
    assert changes["rows.left.lost"].change is Change.WORSE
    assert (changes["rows.left.lost"].a, changes["rows.left.lost"].b) == (0, 100)


def test_a_longer_run_is_not_a_better_one() -> None:
    def of(duration_s: float) -> Results:
        return summarise(paper_run(Path("run.mcap"), duration_s=duration_s))

    changes = {d.name: d for d in compare(of(25.0), of(26.0))}
    for name in ("expected", "recorded"):
        assert changes[f"rows.left.{name}"].change is Change.DIFFERENT
    assert changes["rows.left.lost"].change is Change.SAME


def test_what_happened_in_a_run_is_neither_better_nor_worse() -> None:
    a = results()
    assert {d.name: d for d in compare(a, replace(a, events=a.events + 3))}["events"].change is Change.DIFFERENT


def test_a_figure_has_the_unit_of_its_name() -> None:
    units = {d.name: d.unit for d in compare(results(), results())}
    assert (units["by_plant.position.initial"], units["by_plant.attitude.initial"]) == ("m", "rad")
    assert (units["by_arm.left.position.initial"], units["by_arm.left.attitude.initial"]) == ("m", "rad")
    assert set(units.values()) <= {"", "m", "rad", "s", "N", "N·m", "m/s", "rad/s", "J"}


def test_swapping_the_runs_swaps_the_judgement() -> None:
    opposite = {Change.BETTER: Change.WORSE, Change.WORSE: Change.BETTER, Change.APPEARED: Change.GONE}
    opposite |= {later: earlier for earlier, later in opposite.items()}
    a, b = results(offset_m=1e-3), results(plant=False, keep=4900)
    back = {d.name: d.change for d in compare(b, a)}
    for d in compare(a, b):
        assert back[d.name] is opposite.get(d.change, d.change), d.name


def test_what_only_one_run_measured_is_named() -> None:
    changes = {d.name: d for d in compare(results(), results(plant=False))}
    realised = changes["arms.left.load_share_realised"]
    assert realised.change is Change.GONE
    assert math.isnan(realised.b)
    assert changes["by_plant.rms_position_error_m"].change is Change.GONE


def test_the_table_shows_differences_and_the_headline() -> None:
    a, b = results(offset_m=1e-3), results()
    console = Console(width=140)
    with console.capture() as captured:
        console.print(comparison_table(a, b, compare(a, b)))
    text = captured.get()
    assert "max_position_error_m" in text
    assert "max_attitude_error_rad" in text
    assert "arms.left.joints.elbow.peak_torque_Nm" not in text
    assert "better" in text


@pytest.mark.parametrize("width", [60, 80, 100])
def test_no_name_is_cut_on_a_narrow_terminal(width: int) -> None:
    a, b = results(), results(plant=False, keep=4900)
    differences = compare(a, b)
    console = Console(width=width)
    with console.capture() as captured:
        console.print(comparison_table(a, b, differences))
    assert "…" not in captured.get()
    cells = [line[: line.find("  ", 2)].strip() for line in captured.get().splitlines() if line.strip()]
    text = "".join(cells)
    for d in differences:
        assert not d.differs or d.name in text, d.name
