"""What `make faults` makes of runs and tests: verdicts, worst figures, and pytest's own report."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.faults.catalogue import Row, Shown, Within, rows
from agent.faults.judge import Judged
from agent.study.lab import Laboratory
from agent.study.measure import measure
from tests.faults.__main__ import judged, worst
from tests.faults.false_trips import Done, FalseTrips, Job, false_trips, jobs
from tests.faults.outside import Outcome, merged, of_row, read_report
from tests.faults.together import STOPPING, drawn
from tests.unit.faults.test_judge import GOOD

ROW = next(row for row in rows() if row.id == "B2")
SHOWN = Shown(cell="two_wx200", within=Within(noticed_s=0.02, reacted_s=0.05))
BARE = Row.model_validate(
    {"id": "P1", "group": "process", "fails": "x", "must": "y", "bound": "z", "untested": "no host for it"}
)  # fmt: skip


def test_a_row_is_met_when_its_runs_and_tests_are() -> None:
    run = Judged(SHOWN, GOOD, ())
    document = judged(ROW, [run, Judged(SHOWN, replace(GOOD, noticed_s=0.02, sag_m=0.01), ())], {})
    assert (document["id"], document["verdict"], document["missed"]) == ("B2", "met", [])
    assert (document["detected_s"], document["reacted_s"], document["sag_m"]) == (0.02, 0.05, 0.01)
    assert judged(ROW, [], dict.fromkeys(ROW.tests, Outcome("passed")))["verdict"] == "met"


def test_one_miss_or_one_failed_test_misses_the_row() -> None:
    late = Judged(SHOWN, GOOD, ("noticed after 1 s, not ≤ 0.02",))
    assert judged(ROW, [late], {})["missed"] == ["two_wx200: noticed after 1 s, not ≤ 0.02"]
    failed = judged(ROW, [Judged(SHOWN, GOOD, ())], {ROW.tests[0]: Outcome("failed", "3 N")})
    assert failed["verdict"] == "missed"
    assert failed["missed"] == [f"{ROW.tests[0]} fails\n3 N"]
    assert failed["tests"][ROW.tests[0]] == "failed"


def test_what_did_not_run_is_not_called_met() -> None:
    document = judged(ROW, [], dict.fromkeys(ROW.tests, Outcome("skipped")))
    assert document["verdict"] == "not tested"
    assert document["why_not"]
    assert judged(BARE, [], {})["why_not"] == "no host for it"


def test_what_never_came_is_no_figure() -> None:
    assert worst([0.1, None]) is None
    assert worst([]) is None
    assert worst([0.1, 0.3]) == 0.3


def test_a_test_with_one_failed_parameter_has_failed_and_its_words_are_kept(tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(
        "import pytest\n\n"
        "@pytest.mark.parametrize('n', [1, 2, 3])\n"
        "def test_x(n):\n    assert n == 1, f'{n} N found'\n\n"
        "def test_y():\n    pytest.skip('no arm')\n\n"
        "def test_z():\n    pass\n"
    )
    report = tmp_path / "report.xml"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-c",
        os.devnull,
        "--rootdir",
        str(tmp_path),
        f"--junitxml={report}",
        ".",
    ]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode == 1
    every: dict[str, list[Outcome]] = defaultdict(list)
    read_report(report, every)
    found = {node.removeprefix("test_some.py::"): merged(some) for node, some in every.items()}
    assert {node: one.kind for node, one in found.items()} == {
        "test_x": "failed",
        "test_y": "skipped",
        "test_z": "passed",
    }
    (told,), ran = of_row(["test_x", "test_z"], found)
    assert ran
    assert told.startswith("test_x fails\n[2]\n")
    assert "2 N found" in told
    assert "[3]" in told
    assert "3 N found" in told
    assert "[1]" not in told
    assert of_row(["test_y"], found) == ([], False)
    assert of_row(["unknown"], found) == ([], False)


def test_the_rate_of_false_trips_is_an_hours() -> None:
    found = FalseTrips(1800.0, 72, ("paper_real, reality 3: x",))
    assert found.per_hour == 2.0
    assert found.document()["verdict"] == "missed"
    assert FalseTrips(1800.0, 72, ()).document()["verdict"] == "met"
    assert FalseTrips(0.0, 0, ()).document()["verdict"] == "not tested"


def test_false_trips_are_looked_for_in_every_cell_by_turns_and_a_kept_run_is_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    todo = jobs(300.0, 5)
    assert Counter(job.seed for job in todo) == {5: 6, 6: 6, None: 2}
    assert {job.cell for job in todo if job.seed is None} == {"paper", "paper_ideal"}
    assert jobs(0.0, 5) == []
    kept, ran = tmp_path / "kept", []

    def carried_out(some: Sequence[Job]) -> Iterator[Done]:
        ran.append(len(some))
        return iter([Done(job, "monitor speed" if job.cell == "paper" else "", 2.0) for job in some])

    monkeypatch.setattr("tests.faults.false_trips._carried_out", carried_out)
    for seconds in (150.0, 300.0):
        found = false_trips(seconds, 5, kept)
        kept.write_text(kept.read_text() + '{"of": "cut sh')
        kept.write_text(kept.read_text() + "\n")
    assert ran == [8, 6]
    assert (found.runs, found.cpu_s, found.trips) == (14, 28.0, ("paper, reality None: monitor speed",))
    monkeypatch.setattr("tests.faults.false_trips.state", lambda: "changed")
    false_trips(150.0, 5, kept)
    assert ran[-1] == 8


def test_a_watched_run_trips_where_a_monitor_finds_something() -> None:
    cell = load_cell(Path("paper_real"), ["duration_s=0.5", "simulation.ready_s=0.5"])
    assert measure(Laboratory(cell), None).why == ""
    tight = load_cell(
        Path("paper_real"), ["duration_s=0.5", "simulation.ready_s=0.5", "safety.monitors.load_share=0.01"]
    )
    assert "monitor load: load of" in measure(Laboratory(tight), None).why


@pytest.mark.parametrize("seed", range(20))
def test_pairs_are_two_different_faults_in_the_run(seed: int) -> None:
    _, (one, two) = drawn(seed)
    assert one.fault != two.fault
    assert {one.fault, two.fault} <= set(STOPPING)
    assert 1.0 <= one.at_s <= two.at_s <= 3.5
