"""A whole study: who does its runs, what it goes on from, and what it leaves."""

from __future__ import annotations

import contextlib
import csv
import gc
import json
import logging
import math
import platform
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet
import pytest

import agent
import drivers
import sim_backend
from agent.atomic import WriteError
from agent.config.cell import Cell, load_cell
from agent.config.once import once_per_cell
from agent.config.reality import draw, reality_of
from agent.config.schema.fault import Fault, FaultKind
from agent.study import work
from agent.study.lab import Laboratory
from agent.study.measure import RunResult, bounds_of, measure, run_once
from agent.study.page import _distribution, _influences, _picture
from agent.study.plan import Plan, Task, load_plan
from agent.study.provenance import hash_of, provenance
from agent.study.store import RUNS_FILE, Store, StudyError
from agent.study.study import RESULTS, Work, _row, run_study, worst_cell
from agent.study.summary import (
    ENOUGH_RUNS,
    FIGURES,
    _spearman,
    counting,
    errors_of,
    influences,
    judged,
    quantile,
    summary,
    verdict,
    worst,
)
from agent.study.work import ATTEMPTS, here, in_processes, until
from agent.verify.check import examine
from drivers.interface import Refusal
from tests.support.command import coop
from tests.support.few import few, long
from tests.support.stops import stop_flag
from tests.support.study import PAPER, SHORT, cell, cell_file

KEYS = (
    "position_error_m",
    "attitude_error_rad",
    "internal_force_mean_N",
    "internal_force_max_N",
    "peak_torque_fraction",
)


STRUCK_S = 5.0


class Told:
    """A progress that remembers."""

    def __init__(self) -> None:
        self.begun: list[tuple[int, int]] = []
        self.done: list[RunResult] = []

    def begin(self, done: int, total: int) -> None:
        self.begun.append((done, total))

    def advance(self, result: RunResult) -> None:
        self.done.append(result)


@pytest.fixture(scope="module", autouse=True)
def examined_once() -> Iterator[None]:
    """Forty studies of one plan, whose cell is found fit once; one that is not fit is another cell.

    Equal results have one picture, drawn once.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("agent.study.study.examine", once_per_cell(examine))
        distribution = cache(_distribution)
        patch.setattr("agent.study.page._distribution", lambda results: distribution(tuple(results)))
        patch.setattr("agent.study.page._picture", cache(_picture))
        yield


@pytest.fixture(scope="module")
def plan() -> Plan:
    return load_plan(PAPER, runs=4, seed=4, overrides=SHORT)


@pytest.fixture(scope="module")
def results(plan: Plan) -> list[RunResult]:
    return [result for _, result in here(plan.tasks())]


def known(results: Sequence[RunResult]) -> Work:
    """Runs that are done already."""
    return lambda tasks: ((task, results[task.index]) for task in tasks)


def a_result(index: int, **changes: object) -> RunResult:
    good = RunResult(
        "c", index, index, lost=False, tripped=False, within_bounds=True, settled=True, tracked_s=60.0,
        first_fault_s=None, tripped_s=None, lost_s=None, position_error_m=1e-3,
        attitude_error_rad=1e-3, position_beyond_anchor_m=1e-4, attitude_beyond_anchor_rad=1e-3,
        internal_force_mean_N=0.5, internal_force_max_N=1.0, peak_torque_fraction=0.2, reaction_s=None, tripped_by="",
        why="",
    )  # fmt: skip
    return replace(good, **{"tripped_s": 30.0 if changes.get("tripped") else None, **changes})  # type: ignore[arg-type]


def a_struck(index: int, **changes: object) -> RunResult:
    """One with a fault."""
    return a_result(index, **{"first_fault_s": STRUCK_S, **changes})


def test_a_study_leaves_its_figures_its_table_a_page_and_its_worst_run(
    tmp_path: Path, plan: Plan, results: list[RunResult]
) -> None:
    told = Told()
    outcome = run_study(plan, tmp_path, known(results), lambda: False, told)
    assert told.begun == [(0, 4)]
    assert told.done == results
    assert not outcome.interrupted
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted((RUNS_FILE, *RESULTS))
    document = json.loads((tmp_path / "study.json").read_text())
    assert (document["runs"], document["lost"], document["tripped"]) == (4, 0, 0)
    assert document["within_bounds"] == sum(r.within_bounds for r in results)
    assert document["tripped_by"] == {}
    assert document["versions"] == plan.identity()["versions"]
    assert document["versions"]["numpy"] == np.__version__
    assert document["holds"] is document["cells"]["paper"]["holds"]
    assert document["cells"]["paper"]["bounds"]["peak_torque_fraction"] == 0.5
    for key in KEYS:
        values = sorted(getattr(r, key) for r in results)
        assert document[key] == {"50": values[1], "95": values[3], "100": values[3]}
    assert document["cells"]["paper"]["position_error_m"] == document["position_error_m"]
    with (tmp_path / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["internal_force_mean_N"]) for row in rows] == [r.internal_force_mean_N for r in results]
    assert [int(row["seed"]) for row in rows] == [t.seed for t in plan.tasks()]
    table = pyarrow.parquet.read_table(tmp_path / "runs.parquet")
    assert table.column("position_error_m").to_pylist() == [r.position_error_m for r in results]
    assert float(rows[0]["error_base_m"]) == table.column("error_base_m").to_pylist()[0]
    page = (tmp_path / "report.html").read_text()
    assert "within bounds" in page
    assert "bound of 95 %" in page
    assert page.count("<img") == 1


def test_the_worst_run_is_a_cell_that_repeats_it(tmp_path: Path, plan: Plan, results: list[RunResult]) -> None:
    run_study(plan, tmp_path, known(results), lambda: False, Told())
    bad = worst(results)
    again = load_cell(tmp_path / "worst.toml")
    assert reality_of(again) == draw(plan.cells[0].file.tolerance, bad.seed, plan.cells[0])
    assert measure(Laboratory(again), None, bad.index, bad.seed) == bad
    assert "fault" not in (tmp_path / "worst.toml").read_text()


def struck(folder: Path, *kinds: str) -> Path:
    """A study of one run of the short cell, on soft pads, whose right arm has these faults."""
    faults = "".join(f'[[faults]]\nkind = "{kind}"\narm = "right"\nat_s = 0.396\n' for kind in kinds)
    cell_file(
        folder, "simulation.ready_s=0.013", "simulation.grasp={stiffness_N_per_m=1e5, stiffness_Nm_per_rad=100.0}"
    )
    path = folder / "struck.toml"
    path.write_text(f'format = 1\ncells = ["short.toml"]\nruns = 1\n{faults}')
    return path


@pytest.mark.parametrize("kinds", [("open",), ("limp",), ("hold",), ("locked",)])
def test_what_befell_the_worst_run_befalls_its_cell(tmp_path: Path, kinds: tuple[str, ...]) -> None:
    plan = load_plan(struck(tmp_path, *kinds))
    ((task, result),) = here(plan.tasks())
    (tmp_path / "worst.toml").write_bytes(worst_cell(plan.cells[0], result, plan.faults))
    assert befalls(plan, task, load_cell(tmp_path / "worst.toml")) == result
    said = ", ".join(fault.told for fault in plan.faults)
    assert f"In every run: {said}; " in counting(plan.cells[0], summary([result]), plan.faults)


def test_all_that_befell_the_worst_run_of_a_study_befalls_the_cell_in_its_folder(tmp_path: Path) -> None:
    plan = load_plan(struck(tmp_path, "limp", "open", "hold"))
    outcome = run_study(plan, tmp_path / "out", here, lambda: False, Told())
    assert outcome.document["runs"] == 1
    befalls(plan, plan.tasks()[0], load_cell(tmp_path / "out" / "worst.toml"))
    said = ", ".join(fault.told for fault in plan.faults)
    assert f"In every run: {said}; " in (tmp_path / "out" / "report.html").read_text()


def befalls(plan: Plan, task: Task, worst: Cell) -> RunResult:
    """The faults of the plan befall its worst cell, and make of it what they made of the run."""
    assert worst.file.simulation.fault == list(plan.faults)
    assert worst.file.simulation.opening == []
    lab, again = Laboratory(plan.cells[0]), Laboratory(worst)
    found = measure(again, None, 0, task.seed)
    assert found == run_once(lab, 0, task.seed, plan.faults)
    assert found != run_once(lab, 0, task.seed)
    return found


def test_a_cells_own_faults_stay_beside_those_of_the_study(tmp_path: Path) -> None:
    own = cell("simulation.fault=[{kind='limp', arm='left', at_s=0.25}]")
    result = measure(Laboratory(own), None)
    path = tmp_path / "worst.toml"
    limp, open_right = own.file.simulation.fault[0], Fault(kind=FaultKind.OPEN, arm="right", at_s=0.3)
    for given, kept in (([open_right], [limp, open_right]), ([limp], [limp]), ([], [limp])):
        path.write_bytes(worst_cell(own, result, given))
        assert load_cell(path).file.simulation.fault == kept


def test_of_two_cells_of_which_one_has_a_fault_of_its_own_only_its_runs_are_judged_by_it(tmp_path: Path) -> None:
    """Nobody notices within the tenth of a second that is left."""
    struck = cell("name='struck'", "simulation.fault=[{kind='limp', arm='left', at_s=0.4}]")
    sound = cell("safety.tracking_error_max_m=1e-5")
    plan, out = Plan((sound, struck), 2, 4, ()), tmp_path / "out"
    document = run_study(plan, out, here, lambda: False, Told()).document
    one, other = document["cells"]["paper"], document["cells"]["struck"]
    assert not {"unnoticed", "tripped_before_fault"} & set(one), "nothing befell anybody"
    assert one["missed"][:1] == ["tripped"]
    assert (one["tripped"], other["tripped"], other["unnoticed"], other["tripped_before_fault"]) == (2, 0, 2, 0)
    assert (document["tripped"], document["unnoticed"], document["tripped_before_fault"]) == (2, 2, 0)
    page = (out / "report.html").read_text()
    assert page.index("<h2>struck</h2>") < page.index("In every run: limp left at 0.4 s")
    assert page.count("In every run") == 1
    with (out / "runs.csv").open() as file:
        assert [row["first_fault_s"] for row in csv.DictReader(file)] == ["", "", "0.4", "0.4"]
    table = pyarrow.parquet.read_table(out / "runs.parquet")
    assert table.column("first_fault_s").to_pylist() == [None, None, 0.4, 0.4]


def test_the_terminal_names_the_worst_run_of_a_study_with_faults(tmp_path: Path) -> None:
    path, worst = struck(tmp_path, "limp", "hold"), tmp_path / "out" / "worst.toml"
    done = coop("study", path, "--workers", "1", "--out", tmp_path / "out")
    assert done.code == 0, done.err
    assert f"worst    {worst}\n" in done.out
    assert "WITHOUT" not in worst.read_text()


def no_worker(_: Sequence[Task]) -> Iterator[tuple[Task, RunResult]]:
    raise StudyError("scheduler", found="no answer", expected="one", remedy="start it")
    yield


def test_a_study_that_fails_before_its_first_run_leaves_what_was_there(tmp_path: Path, plan: Plan) -> None:
    out, kept, empty = tmp_path / "studies" / "one", tmp_path / "kept", tmp_path / "empty"
    kept.mkdir()
    empty.mkdir()
    (kept / "notes").write_text("mine")
    for folder in (out, kept, empty):
        with pytest.raises(StudyError, match="no answer"):
            run_study(plan, folder, no_worker, lambda: False, Told())
    assert sorted(tmp_path.rglob("*")) == [empty, kept, kept / "notes"]
    with Store(empty, plan):
        pass
    assert (empty / RUNS_FILE).is_file(), "of one that was stopped before its first run"


def test_a_study_that_fails_behind_its_first_run_keeps_it(tmp_path: Path, plan: Plan, results: list[RunResult]) -> None:
    def fails(tasks: Sequence[Task]) -> Iterator[tuple[Task, RunResult]]:
        yield tasks[0], results[0]
        yield from no_worker(tasks)

    with pytest.raises(StudyError, match="no answer"):
        run_study(plan, tmp_path, fails, lambda: False, Told())
    with pytest.raises(StudyError, match="no answer"):
        run_study(plan, tmp_path, no_worker, lambda: False, Told())
    with Store(tmp_path, plan) as store:
        assert list(store.results) == [plan.tasks()[0].key]


@pytest.mark.parametrize("name", few(RESULTS, RESULTS[:1].__contains__))
@pytest.mark.parametrize("runs", [None, b"", b"{"], ids=["without runs", "beside empty runs", "beside a cut line"])
def test_a_file_that_no_study_has_written_is_kept_unless_asked(
    tmp_path: Path, plan: Plan, results: list[RunResult], name: str, runs: bytes | None
) -> None:
    """Runs without a whole first line have written no results, whosever they are."""
    (tmp_path / name).write_text("mine")
    if runs is not None:
        (tmp_path / RUNS_FILE).write_bytes(runs)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(WriteError, match=f"{name}: found one of that name, expected none; .*--out, or give --force"):
        run_study(plan, tmp_path, known(results), lambda: False, Told())
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    run_study(plan, tmp_path, known(results), lambda: False, Told(), anew=True)
    assert not (tmp_path / name).read_bytes().startswith(b"mine")


@pytest.mark.parametrize("moved", [False, True])
def test_a_study_whose_folder_is_removed_ends_with_the_next_run_and_one_that_is_moved_goes_on(
    tmp_path: Path, plan: Plan, results: list[RunResult], moved: bool
) -> None:
    """It worked on to its end, and all runs were lost."""
    out, told = tmp_path / "out", Told()

    def work(tasks: Sequence[Task]) -> Iterator[tuple[Task, RunResult]]:
        for count, done in enumerate(known(results)(tasks)):
            if count == 2:
                out.rename(tmp_path / "elsewhere") if moved else shutil.rmtree(out)
            yield done

    with pytest.raises(WriteError, match=r"somebody has removed it.* it begins with the first run|study\.json"):
        run_study(plan, out, work, lambda: False, told)
    assert len(told.done) == (4 if moved else 2)
    if moved:
        assert len((tmp_path / "elsewhere" / RUNS_FILE).read_bytes().splitlines()) == 1 + 4, "with it the study goes on"


def test_a_study_that_was_stopped_goes_on_where_it_was(tmp_path: Path, plan: Plan, results: list[RunResult]) -> None:
    first = Told()
    outcome = run_study(plan, tmp_path, here, lambda: len(first.done) >= 2, first)
    assert outcome.interrupted
    assert outcome.document["runs"] == 2
    second = Told()
    outcome = run_study(plan, tmp_path, here, lambda: False, second)
    assert second.begun == [(2, 4)]
    assert second.done == results[2:]
    assert outcome.document == run_study(plan, tmp_path / "whole", known(results), lambda: False, Told()).document
    assert (tmp_path / "runs.csv").read_bytes() == (tmp_path / "whole" / "runs.csv").read_bytes()
    more = Told()
    run_study(replace(plan, runs=5), tmp_path, here, lambda: False, more)
    assert more.begun == [(4, 5)]
    assert [r.index for r in more.done] == [4]


def test_a_folder_that_a_study_writes_is_nobody_elses_until_its_results_are_there(
    tmp_path: Path, plan: Plan, results: list[RunResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    refused: list[str] = []

    def another(*_: object) -> bytes:
        for anew in (False, True):
            with pytest.raises(StudyError) as caught:
                run_study(plan, tmp_path, here, lambda: False, Told(), anew=anew)
            refused.append(str(caught.value))
        return b""

    def beside(tasks: Sequence[Task]) -> Iterator[tuple[Task, RunResult]]:
        for task, result in known(results)(tasks):
            another()
            yield task, result

    monkeypatch.setattr("agent.study.study.worst_cell", another)
    assert run_study(plan, tmp_path, beside, lambda: False, Told()).document["runs"] == 4
    assert len(refused) == 2 * 5
    assert all(words.startswith(f"study in {tmp_path}: found another `coop study`") for words in refused)
    with Store(tmp_path, plan) as store:
        assert sorted(store.results) == [task.key for task in plan.tasks()]


def test_anew_gives_up_what_is_there_only_for_cells_that_may_run(
    tmp_path: Path, plan: Plan, results: list[RunResult]
) -> None:
    run_study(plan, tmp_path, known(results), lambda: False, Told())
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    unfit = load_plan(PAPER, runs=4, seed=5, overrides=[*SHORT, "controller.k_p_per_s=1e5"])
    with pytest.raises(Refusal):
        run_study(unfit, tmp_path, known(results), lambda: False, Told(), anew=True)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    told = Told()
    outcome = run_study(replace(plan, seed=5), tmp_path, lambda _: iter(()), lambda: False, told, anew=True)
    assert told.begun == [(0, 4)]
    assert outcome.interrupted
    assert sorted(p.name for p in tmp_path.iterdir()) == ["runs.jsonl", "study.json"]


def test_several_processes_find_the_same_to_the_bit(plan: Plan, results: list[RunResult]) -> None:
    found = {task.index: result for task, result in in_processes(plan.tasks(), 2)}
    assert [found[i] for i in range(4)] == results


def test_a_worker_that_dies_takes_nothing_with_it(
    tmp_path: Path, plan: Plan, results: list[RunResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of the first two processes is killed while it has a run; the runs are done by others."""
    started = work._start
    count = 0

    def short_lived() -> object:
        nonlocal count
        count += 1
        process = started()
        if count <= 2:
            process.kill()
        return process

    monkeypatch.setattr(work, "_start", short_lived)
    found = {task.index: result for task, result in in_processes(plan.tasks()[:2], 1)}
    assert [found[i] for i in range(2)] == results[:2]
    assert count == 3


def test_a_run_that_no_worker_survives_is_refused(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    started = work._start
    count = 0

    def dying() -> object:
        nonlocal count
        count += 1
        process = started()
        process.kill()
        return process

    monkeypatch.setattr(work, "_start", dying)
    with pytest.raises(StudyError, match="workers that died during it"):
        list(in_processes(plan.tasks()[:1], 1))
    assert count == ATTEMPTS


def test_a_run_that_cannot_be_done_is_refused_by_its_number() -> None:
    broken = Task(cell().toml.replace(b"widowx_mk2", b"widowx_mk3"), "x.toml", 0, 7, 1, (), "", provenance())
    for way in (here, lambda tasks: in_processes(tasks, 1)):
        with pytest.raises(StudyError, match=r"run 7 of x\.toml, reality 1"):
            list(way([broken]))


@pytest.mark.parametrize("way", [here, long(partial(in_processes, workers=1))], ids=["here", "in a process"])
def test_a_worker_of_another_release_does_no_run_and_says_what_differs(plan: Plan, way: Work) -> None:
    """What a process refuses comes back from it as in the test above."""
    ours, host = provenance()["widowx-coop"], re.escape(platform.node())
    other = replace(plan.tasks()[0], provenance={**provenance(), "widowx-coop": "0.0.9"})
    words = rf"^worker on {host}: found widowx-coop {ours}, expected widowx-coop 0\.0\.9, "
    with pytest.raises(StudyError, match=words):
        list(way([other]))


def test_a_worker_of_other_sources_or_arm_files_does_no_run_and_says_what_differs(plan: Plan) -> None:
    task, host = plan.tasks()[0], re.escape(platform.node())
    with pytest.raises(StudyError, match=rf"found sources {provenance()['sources']}, expected sources none, "):
        list(here([replace(task, provenance={k: v for k, v in provenance().items() if k != "sources"})]))
    fingerprint = plan.cells[0].fingerprint
    with pytest.raises(
        StudyError,
        match=rf"^arm files of paper\.toml on {host}: found fingerprint {fingerprint}, expected fingerprint 0, ",
    ):
        list(here([replace(task, fingerprint="0")]))


def test_the_hash_of_sources_is_of_their_names_and_content_wherever_they_lie(tmp_path: Path) -> None:
    for place in ("here", "there"):
        (tmp_path / place / "a" / "b").mkdir(parents=True)
        (tmp_path / place / "a" / "b" / "law.py").write_text("k = 1\n")
    here, there = tmp_path / "here" / "a", tmp_path / "there" / "a"
    first = hash_of(here)
    (there / "b" / "notes.txt").write_text("mine")
    assert hash_of(there) == first
    (there / "b" / "law.py").write_text("k = 2\n")
    changed = hash_of(there)
    (there / "b" / "law.py").rename(there / "b" / "laws.py")
    assert len({first, changed, hash_of(there), hash_of(here, there)}) == 4
    assert provenance()["sources"] == hash_of(*(Path(of.__path__[0]) for of in (agent, drivers, sim_backend)))


@pytest.mark.long  # tests/process/study/test_stopped.py
def test_a_study_that_is_left_early_ends_its_processes(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    started, processes = work._start, []

    def remembered() -> object:
        processes.append(started())
        return processes[-1]

    monkeypatch.setattr(work, "_start", remembered)
    runs: Iterator[object] = in_processes(plan.tasks(), 2)
    next(runs)
    runs.close()  # type: ignore[attr-defined]
    assert len(processes) == 2
    assert all(process.poll() is not None for process in processes)


def test_quantiles_are_of_all_runs_and_counts_of_each_kind() -> None:
    results = [a_result(i, internal_force_mean_N=float(i)) for i in range(1, 101)]
    results[0] = replace(results[0], lost=True, within_bounds=False)
    results[1] = replace(results[1], tripped=True, tripped_s=30.0, within_bounds=False)
    found = summary(results)
    assert found["internal_force_mean_N"] == {"50": 52.0, "95": 97.0, "100": 100.0}, (
        "the lost one counts as the largest, and so does the one that tripped"
    )
    assert (found["ended_early"], found["ended_before_start"], found["at_least"]) == (2, 0, ["100"])
    assert (found["runs"], found["lost"], found["tripped"], found["within_bounds"]) == (100, 1, 1, 98)
    assert found["reaction_s"] == summary([])["reaction_s"] == {"50": None, "95": None, "100": None}
    assert not {"unnoticed", "tripped_before_fault"} & set(found), "nothing befell anybody"


def test_a_lost_run_looks_good_in_no_figure() -> None:
    """However calm it was until then: it counts as the largest of all, and as a number."""
    kept = [a_struck(i, peak_torque_fraction=0.1 * i, reaction_s=0.2) for i in range(1, 5)]
    calm = {"internal_force_mean_N": 0.0, "internal_force_max_N": 0.0, "peak_torque_fraction": 0.0}
    lost = [a_struck(i, lost=True, within_bounds=False, reaction_s=0.1, **calm) for i in range(5, 10)]
    for runs in ([*kept, *lost], [*lost, *kept]):
        found = summary(runs)
        assert found["peak_torque_fraction"] == dict.fromkeys(("50", "95", "100"), pytest.approx(0.4))
        assert found["internal_force_mean_N"]["50"] == 0.5
        assert found["reaction_s"] == {"50": 0.1, "95": 0.2, "100": 0.2}
    diverged = [replace(lost[0], internal_force_max_N=force) for force in (math.inf, math.nan)]
    only = summary([*lost, *diverged])
    assert all(math.isfinite(value) for figure in FIGURES for value in only[figure].values())


def test_a_run_that_tripped_looks_good_in_no_figure_and_a_quantile_that_falls_on_it_is_marked() -> None:
    """A start that is refused: calm, for nothing moved."""
    calm = {"internal_force_mean_N": 0.0, "peak_torque_fraction": 0.0, "tripped": True, "settled": False}
    kept = [a_result(i, internal_force_mean_N=0.1 * i) for i in range(1, 11)]
    for tripped, marked in ((0, []), (1, ["95", "100"]), (9, ["95", "100"]), (11, ["50", "95", "100"])):
        found = summary([*(a_result(i, tripped_s=-4.0, **calm) for i in range(tripped)), *kept])
        assert found["internal_force_mean_N"]["100"] == pytest.approx(1.0)
        assert (found["ended_early"], found["ended_before_start"], found["at_least"]) == (tripped, tripped, marked)
        for q in ("50", "95", "100"):
            assert quantile(found, "internal_force_mean_N", q).startswith("≥ ") is (q in marked)
        assert found["internal_force_mean_N"]["50"] == pytest.approx(0.1 * min(-(-(10 + tripped) // 2), 10))
    assert quantile(summary(kept), "reaction_s", "50") == "–"
    for_a_fault = [a_struck(i, tripped=True, tripped_s=5.2, reaction_s=0.2, internal_force_mean_N=i) for i in range(9)]
    found = summary(for_a_fault)
    assert (found["ended_early"], found["at_least"], found["internal_force_mean_N"]["50"]) == (0, [], 4)
    found = summary([*for_a_fault, a_struck(9, tripped=True, tripped_s=4.9, reaction_s=0.3)])
    assert (found["ended_early"], found["at_least"], quantile(found, "reaction_s", "100")) == (1, ["95", "100"], "0.3")


def test_a_fault_that_nobody_notices_counts_as_noticed_later_than_any() -> None:
    noticed = [a_struck(i, tripped=True, tripped_s=STRUCK_S + 0.1 * i, reaction_s=0.1 * i) for i in range(1, 4)]
    found = summary([*noticed, a_struck(4)])
    assert (found["unnoticed"], found["tripped_before_fault"], found["tripped"]) == (1, 0, 3)
    assert found["reaction_s"] == {"50": pytest.approx(0.2), "95": None, "100": None}
    assert summary(noticed)["reaction_s"]["100"] == pytest.approx(0.3)


def test_of_runs_without_a_fault_nobody_asks_who_noticed_or_tripped_before_it() -> None:
    struck = [a_struck(0, first_fault_s=0.0), a_struck(1, tripped=True, tripped_s=5.2, reaction_s=0.2)]
    for of in ([a_struck(2, tripped=True, tripped_s=4.9, reaction_s=0.4), *struck], struck):
        found = summary([*of, *(a_result(i, tripped=True, tripped_s=4.0) for i in range(3, 9)), a_result(9)])
        assert (found["runs"], found["unnoticed"], found["tripped_before_fault"]) == (len(of) + 7, 1, len(of) - 2)
        assert found["reaction_s"] == summary(of)["reaction_s"]
        assert found["reaction_s"]["50"] is not None


def test_an_arm_that_trips_for_a_fault_does_what_it_should_and_one_that_trips_before_it_does_not() -> None:
    c = cell()
    after = [a_struck(i, tripped=True, tripped_s=5.2, reaction_s=0.2, tripped_by="UNEXPECTED") for i in range(60)]
    found = summary([*after, a_struck(60)])
    kept = judged(c, found)
    assert (kept["missed"], kept["holds"]) == ([], True)
    assert verdict(found | kept) == (
        "holds: 61 runs, none lost, none tripped before the fault, 95 % of them below every bound; "
        "the others noticed it in 60 of 61 runs"
    )
    found = summary([*after, a_struck(60, tripped=True, tripped_s=4.9)])
    kept = judged(c, found)
    assert (kept["missed"], kept["holds"]) == (["tripped_before_fault"], False)
    assert verdict(found | kept) == (
        "does not hold: of 61 runs 1 tripped before the fault; the others noticed it in 60 of 61 runs"
    )


def test_a_cell_holds_when_nothing_is_lost_or_tripped_and_the_95_percent_quantiles_are_within_bounds() -> None:
    c = cell()
    good = [a_result(i) for i in range(100)]
    bounds = bounds_of(c)
    assert bounds == {
        "position_beyond_anchor_m": 1e-3,
        "attitude_beyond_anchor_rad": 6e-3,
        "internal_force_mean_N": 1.0,
        "peak_torque_fraction": 0.5,
    }
    assert bounds_of(load_cell(Path("three_wx250s")))["internal_force_mean_N"] == 4.0
    for figure, bound in bounds.items():
        some, more = ([a_result(i, **{figure: 1.01 * bound}) for i in range(n)] for n in (5, 6))
        found = judged(c, summary([*some, *good[5:]]))
        assert found == {"bounds": bounds, "missed": [], "holds": True}
        found = judged(c, summary([*more, *good[6:]]))
        assert (found["missed"], found["holds"]) == ([figure], False)
    for key in ("lost", "tripped"):
        assert judged(c, summary([*good[1:], a_result(0, **{key: True})]))["missed"] == [key]
    assert not judged(c, summary([]))["holds"]


def test_the_verdict_says_how_many_runs_it_is_of_and_what_stopped_arms() -> None:
    c = cell()
    kept = "none lost, none tripped, 95 % of them below every bound"
    too_few = "too few to say it of 95 % of all realities, which takes 59 or more"
    stopped = [a_result(i, tripped=True, tripped_by=by) for i, by in enumerate(["monitor load", "UNEXPECTED"] * 2)]
    for results, words in (
        ([a_result(i) for i in range(59)], f"holds: 59 runs, {kept}"),
        ([a_result(i) for i in range(58)], f"holds: 58 runs, {kept}; {too_few}"),
        (stopped, "does not hold: of 4 runs 4 tripped (UNEXPECTED 2, monitor load 2)"),
        (
            [a_result(0, lost=True, internal_force_mean_N=2.0)],
            "does not hold: of 1 run 1 lost, 95 % quantile of internal_force_mean_N above its bound",
        ),
    ):
        found = summary(results)
        assert verdict(found | judged(c, found)) == words


def test_fewer_runs_than_enough_are_all_within_bounds_by_chance_more_than_one_time_in_twenty() -> None:
    assert 0.95**ENOUGH_RUNS < 0.05 < 0.95 ** (ENOUGH_RUNS - 1)


def test_the_worst_is_lost_before_tripped_before_strained_and_the_soonest_of_them() -> None:
    strained = a_result(3, internal_force_mean_N=9.0)
    tripped = [a_result(2, tripped=True, tripped_s=t, tracked_s=9.0 - t) for t in (9.0, 5.0)]
    lost = [a_result(1, lost=True, lost_s=t, tripped_s=25.0 - t, tracked_s=25.0 - t) for t in (22.0, 20.0)]
    assert worst([a_result(0), strained]) is strained
    assert worst([strained, *tripped]) is tripped[1]
    assert worst([strained, *tripped, *lost]) is lost[1]


def test_with_faults_the_worst_is_lost_before_tripped_for_nothing_before_unnoticed_before_noticed_late() -> None:
    late, soon = (a_struck(i, tripped=True, tripped_s=STRUCK_S + s, reaction_s=s) for i, s in ((1, 0.7), (2, 0.4)))
    unnoticed = [a_struck(i, internal_force_mean_N=force) for i, force in ((3, 1.0), (4, 2.0))]
    early = a_struck(5, tripped=True, tripped_s=4.9, reaction_s=0.1)
    lost = a_struck(6, lost=True, lost_s=5.5, tripped=True, tripped_s=5.1, reaction_s=0.1)
    assert worst([soon, late]) is late
    assert worst([soon, late, *unnoticed]) is unnoticed[1]
    assert worst([soon, late, *unnoticed, early]) is early
    assert worst([soon, late, *unnoticed, early, lost]) is lost


def test_a_run_that_nothing_befell_is_worse_than_struck_ones_only_when_it_is_lost_or_trips() -> None:
    at_once = a_struck(1, first_fault_s=0.0, internal_force_mean_N=0.1)
    noticed = a_struck(2, tripped=True, tripped_s=5.1, reaction_s=0.1)
    sound = [a_result(i, internal_force_mean_N=force) for i, force in ((3, 8.0), (4, 9.0))]
    tripped = a_result(5, tripped=True, tripped_s=9.0)
    assert worst(sound) is sound[1]
    assert worst([*sound, noticed]) is noticed
    assert worst([*sound, noticed, at_once]) is at_once
    assert worst([*sound, noticed, at_once, tripped]) is tripped


UNKNOWN = (
    "how they would have gone on is not known, so each counts as the largest of all runs in every figure, and a "
    "quantile that falls on one is marked ≥."
)


def test_from_when_to_when_figures_count_is_said_with_faults_and_with_runs_that_ended_early() -> None:
    c, limp = cell(), Fault(kind=FaultKind.LIMP, arm="left", at_s=0.3)
    until = "Errors and forces count from 0.2 s on, until the first arm trips."
    assert counting(c, summary([a_result(0)]), []) == until
    late, early, unready = (
        a_result(i, settled=t > 0.2, tripped=True, tripped_s=t) for i, t in ((1, 30.0), (2, 0.1), (3, -4.0))
    )
    assert counting(c, summary([a_result(0), late, early]), []) == f"{until} Lost or tripped: 2 of 3; {UNKNOWN}"
    found = summary([a_result(0), late, early, unready, a_result(4, lost=True, lost_s=-1.0)])
    assert (found["unsettled"], found["ended_early"], found["counted_from_start"]) == (2, 4, 0)
    assert counting(c, found, []) == f"{until} Lost or tripped: 4 of 5 (2 before the start); {UNKNOWN}"
    noticed = a_struck(0, first_fault_s=0.05, settled=False, tripped=True, tripped_s=0.1, reaction_s=0.05)
    found = summary([noticed, a_struck(1, tripped=True, tripped_s=4.9)])
    assert (found["unsettled"], found["ended_early"], found["counted_from_start"]) == (1, 1, 1)
    assert counting(c, found, [limp]) == (
        f"{until} Lost, or tripped before the fault: 1 of 2; {UNKNOWN}"
        " Tripped for a fault too early for that, and counted from the start with its error: 1."
        " In every run: limp left at 0.3 s; they count on after it."
    )
    own = cell("simulation.fault=[{kind='open', arm='right', at_s=0.25}, {kind='limp', arm='left', at_s=0.3}]")
    both = f"{until} In every run: open right at 0.25 s, limp left at 0.3 s; they count on after it."
    for given in ([], [limp]):
        assert counting(own, summary([a_result(0)]), given) == both


def test_runs_that_ended_early_are_said_on_the_terminal_and_the_page(tmp_path: Path) -> None:
    path, out = cell_file(tmp_path, "safety.tracking_error_max_m=1e-5"), tmp_path / "out"
    done = coop("study", path, "--runs", "1", "--workers", "1", "--out", out)
    said = f"Lost or tripped: 1 of 1; {UNKNOWN}"
    page, document = (out / "report.html").read_text(), json.loads((out / "study.json").read_text())
    for text in (done.out, page):
        assert said in text
        assert f"≥ {document['internal_force_mean_N']['50']:.4g}" in text
    assert (document["schema"], document["unsettled"], document["at_least"]) == (2, 1, ["50", "95", "100"])


def spearman(x: Sequence[float], y: Sequence[float]) -> float:
    """By definition: the correlation of ranks, of which equal values have the mean; scipy takes 0.6 s to load."""
    rank_x, rank_y = (np.array([sum((w < v) + (w <= v) for w in of) / 2 for v in of]) for of in (x, y))
    return float(np.corrcoef(rank_x, rank_y)[0, 1])


def test_what_matters_is_found_by_rank() -> None:
    tied = [2.0, 1.0, 2.0, -3.0, 2.0], [0.1, 0.1, 7.0, 0.0, 5.0]
    assert spearman(*tied) == _spearman(np.array(tied[0]), np.array(tied[1]))
    assert spearman(*tied) == pytest.approx(0.8029550685469662, rel=1e-12), "scipy.stats.spearmanr"
    c = cell()
    results = []
    for seed in range(30):
        errors = errors_of(draw(c.file.tolerance, seed, c), c)
        results.append(a_result(0, seed=seed, internal_force_mean_N=errors["base_m"] ** 3, peak_torque_fraction=0.2))
    first = influences(c, results)[0]
    assert (first.error, first.figure) == ("base_m", "internal_force_mean_N")
    assert first.correlation == pytest.approx(1.0)
    assert all(i.figure != "peak_torque_fraction" for i in influences(c, results))
    drawn = [errors_of(draw(c.file.tolerance, s, c), c) for s in range(30)]
    wanted = spearman([d["friction"] for d in drawn], [r.internal_force_mean_N for r in results])
    found = next(i for i in influences(c, results) if i.error == "friction")
    assert found.correlation == pytest.approx(wanted)
    assert influences(c, results[:7]) == []


def test_the_tolerance_that_decides_over_tripping_is_named_first() -> None:
    """Runs with an arm that does not know where it stands trip before they move anything; the others' pads strain."""
    c = cell("tolerance.base_m=0.04")
    drawn = [errors_of(draw(c.file.tolerance, seed, c), c) for seed in range(24)]
    results = [
        a_result(i, tripped=True, tripped_s=-4.0, settled=False, internal_force_mean_N=0.01, peak_torque_fraction=0.01)
        if errors["base_m_largest"] > 0.02
        else a_result(i, internal_force_mean_N=errors["pads_N_per_m"])
        for i, errors in enumerate(drawn)
    ]
    assert 12 < sum(r.tripped for r in results) < 24
    found = influences(c, results)
    assert (found[0].error, found[0].figure) == ("base_m_largest", "ended_early")
    assert found[0].correlation > 0.5
    of_figures = [i for i in found if i.figure != "ended_early"]
    assert found == [i for i in found if i.figure == "ended_early"] + of_figures
    assert of_figures[0].error == "base_m_largest"
    assert all(i.correlation > 0.0 for i in of_figures if i.error == "base_m_largest")
    rows = re.findall(r"<tr><td>(\w+)</td><td>(\w+)</td>", _influences(found, 24))
    assert rows[0] == ("base_m_largest", "ended_early")
    assert [figure for _, figure in rows].count("ended_early") == 4
    assert len(rows) == 12
    kept = [r for r in results if not r.tripped] * 3
    assert all(i.figure != "ended_early" for i in influences(c, kept))
    assert influences(c, [r for r in results if r.tripped]) == [], "of runs that all tripped nothing can be told"
    assert "All runs are alike, or all were lost or tripped" in _influences([], 24)
    assert "Too few runs" in _influences([], 7)


def test_errors_are_measured_as_disagreement_and_distance_from_one() -> None:
    c = cell()
    real = draw(c.file.tolerance, 3, c)
    left, right = real.arms["left"], real.arms["right"]
    found = errors_of(real, c)
    assert found["base_m"] == pytest.approx(float(np.linalg.norm(np.subtract(left.base_m, right.base_m))))
    assert found["base_m_largest"] == pytest.approx(max(math.hypot(*a.base_m) for a in (left, right)))
    assert found["grasp_rad_largest"] == pytest.approx(max(math.hypot(*a.grasp_rad) for a in (left, right)))
    assert found["delay"] == pytest.approx((real.delay_s or 0.0) / c.file.simulated_delay_s)
    assert found["skew_s"] == pytest.approx(abs(left.skew_s - right.skew_s))
    assert found["zeros_rad"] == pytest.approx(float(np.linalg.norm([*left.zeros_rad, *right.zeros_rad])))
    assert found["friction"] == pytest.approx((left.friction + right.friction) / 2)
    assert found["friction_off"] == pytest.approx((abs(left.friction - 1) + abs(right.friction - 1)) / 2)
    assert found["object_off"] == pytest.approx(abs(real.object - 1))
    assert (found["backlash_rad"], found["delay_jitter_s"]) == (0.0, 0.0)


def test_unlike_pads_enter_as_their_geometric_mean() -> None:
    c = cell("tolerance.pads_alike=false")
    real = draw(c.file.tolerance, 3, c)
    left, right = (arm.pads_N_per_m for arm in real.arms.values())
    assert left is not None
    assert right is not None
    assert errors_of(real, c)["pads_N_per_m"] == pytest.approx(math.sqrt(left * right))
    plain = draw(cell().file.tolerance, 3, cell())
    assert errors_of(plain, c)["pads_N_per_m"] == plain.pads_N_per_m


def test_factors_of_single_joints_enter_with_their_mean_and_how_far_each_is_off() -> None:
    c = cell("tolerance.joints_alike=false")
    real = draw(c.file.tolerance, 3, c)
    rubs, weighs = (
        np.array([k for arm in real.arms.values() for k in getattr(arm, key)])
        for key in ("joint_friction", "link_masses")
    )
    found = errors_of(real, c)
    for name, each in (("friction", rubs), ("masses", weighs)):
        assert found[name] == pytest.approx(each.mean())
        assert found[f"{name}_off"] == pytest.approx(np.abs(each - 1.0).mean())
    twice = real.model_copy(
        update={"arms": {n: a.model_copy(update={"friction": 2.0, "masses": 3.0}) for n, a in real.arms.items()}}
    )
    assert errors_of(twice, c)["friction"] == pytest.approx(2.0 * rubs.mean())
    assert errors_of(twice, c)["masses"] == pytest.approx(3.0 * weighs.mean())


def test_errors_that_a_study_draws_where_they_are_stated_are_in_its_table_and_among_what_matters() -> None:
    c = cell(
        "tolerance.backlash_rad=0.006", "tolerance.delay_jitter_s=0.002",
        "tolerance.breakaway=0.5", "tolerance.load_friction=0.05",
    )  # fmt: skip
    drawn = [draw(c.file.tolerance, seed, c) for seed in range(30)]
    gaps = [np.linalg.norm([b for arm in r.arms.values() for b in arm.backlash_rad]) for r in drawn]
    held, loads = (
        [np.linalg.norm([x for arm in r.arms.values() for x in getattr(arm, key)]) for r in drawn]
        for key in ("breakaway_Nm", "load_friction")
    )
    jitters = [r.delay_jitter_s for r in drawn]
    for error, sizes in (
        ("backlash_rad", gaps), ("delay_jitter_s", jitters), ("breakaway_Nm", held), ("load_friction", loads),
    ):  # fmt: skip
        results = [a_result(0, seed=seed, internal_force_mean_N=float(sizes[seed])) for seed in range(30)]
        assert errors_of(drawn[3], c)[error] == pytest.approx(sizes[3])
        first = influences(c, results)[0]
        assert (first.error, first.correlation) == (error, pytest.approx(1.0))
        assert f"error_{error}" in _row(c, results[0])


def test_an_error_that_strains_whichever_way_it_goes_is_found() -> None:
    c = cell()
    results = []
    for seed in range(60):
        arms = draw(c.file.tolerance, seed, c).arms.values()
        results.append(a_result(0, seed=seed, internal_force_mean_N=sum(abs(a.masses - 1) for a in arms)))
    found = {i.error: i.correlation for i in influences(c, results) if i.figure == "internal_force_mean_N"}
    assert found["masses_off"] == pytest.approx(1.0)
    assert abs(found["masses"]) < 2.0 / math.sqrt(59)
    assert "By chance alone one in twenty is beyond ±0.26 in 60 runs." in _influences(influences(c, results), 60)


def test_the_command_runs_a_cell_and_says_where_its_results_are(tmp_path: Path) -> None:
    path, out = cell_file(tmp_path), tmp_path / "out"
    done = coop("study", path, "--runs", "2", "--workers", "1", "--out", out)
    assert done.code == 0, done.err
    assert "2 runs: 0 lost" in done.out
    assert "\npaper does not hold: of 2 runs 95 % quantile of position_beyond_anchor_m above its bound" in done.out
    assert str(out / "worst.toml") in done.out
    again = coop("study", path, "--runs", "2", "--workers", "1", "--out", out, "--json")
    assert "2 of 2 runs are there already" in again.err
    assert json.loads(again.out) == json.loads((out / "study.json").read_text())
    other = coop("study", path, "--runs", "2", "--seed", "1", "--workers", "1", "--out", out)
    assert other.code == 2
    assert "found runs of seed 0, not 1, expected none" in other.err
    forced = coop("study", path, "--runs", "1", "--seed", "1", "--workers", "1", "--out", out, "--force")
    assert forced.code == 0
    assert "1 runs" in forced.out


@pytest.mark.parametrize(
    ("address", "found"),
    [
        ("tcp://127.0.0.1:9", "no answer ("),
        ("tcp://127.0.0.1:{mute}", "no answer (TimeoutError)"),
        ("tls://127.0.0.1:9", "no answer (TLS expects a `ssl_context`"),
        ("ucx://127.0.0.1:9", "no answer (Can't instantiate"),
        ("tcb://127.0.0.1:9", "no answer (unknown address scheme 'tcb'"),
        ("127.0.0.1", "no answer (missing port number"),
    ],
)
def test_a_scheduler_that_does_not_answer_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str, found: str
) -> None:
    """Also one that listens and never says a word, and one for which this host has no certificates or no package."""
    from agent.study import cluster

    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        hung = threading.Timer(20.0, mute.close)  # ends a test that would wait for ever, as one of another error
        hung.start()
        address = address.format(mute=mute.getsockname()[1])
        done = coop("study", cell_file(tmp_path), "--runs", "1", "--out", tmp_path / "out", "--scheduler", address)
        hung.cancel()
    assert done.code == 2
    assert done.err.startswith(f"coop: scheduler {address}: found {found}")
    assert done.err.count("\n") == 1
    gc.collect()  # what a half-made client would say at its end is an error of this test


@pytest.mark.parametrize(
    "said",
    [
        b"SSH-2.0-OpenSSH_9.6\r\n",
        b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
        bytes(64),
    ],
    ids=["SSH", "HTTP", "zeros"],
)
def test_something_else_that_answers_at_the_address_of_a_scheduler_is_one_line(tmp_path: Path, said: bytes) -> None:
    def answer() -> None:
        with contextlib.suppress(OSError), listener.accept()[0] as peer:
            peer.settimeout(20.0)
            peer.sendall(said)
            while peer.recv(4096):
                pass

    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.settimeout(20.0)
        answering = threading.Thread(target=answer)
        answering.start()
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        done = coop("study", cell_file(tmp_path), "--runs", "1", "--out", tmp_path / "out", "--scheduler", address)
        answering.join()
    assert done.code == 2
    assert done.err == (
        f"coop: scheduler {address}: found an answer that is no Dask scheduler's, as of SSH or HTTP, expected a Dask "
        "scheduler that answers within 10 s, such as tcp://host:8786; start one with `dask scheduler`, or leave "
        "--scheduler out to use this machine\n"
    )
    gc.collect()


def test_without_the_package_the_scheduler_is_refused_with_the_remedy(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    from agent.study import cluster

    def missing(name: str) -> object:
        raise ImportError(name)

    monkeypatch.setattr(cluster, "import_module", missing)
    with pytest.raises(StudyError, match=r"widowx-coop\[study\]"):
        list(cluster.on_cluster(plan.tasks(), "tcp://127.0.0.1:9"))


def results_of(pairs: Sequence[tuple[Task, RunResult]]) -> list[RunResult]:
    return [result for _, result in sorted(pairs, key=lambda pair: pair[0].key)]


@pytest.mark.long  # the first run of one is that of this process in the test below
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_dask_cluster_finds_the_same_to_the_bit(plan: Plan, results: list[RunResult], workers: int) -> None:
    from distributed import LocalCluster

    from agent.study.cluster import on_cluster

    with LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        assert results_of(list(on_cluster(plan.tasks(), cluster.scheduler_address))) == results


WITHOUT_US = """
import asyncio, sys
from distributed import Worker
sys.modules["agent"] = None
async def work():
    async with Worker(sys.argv[1], nthreads=1) as worker:
        await worker.finished()
asyncio.run(work())
"""


@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_that_goes_away_is_one_line_and_one_without_workers_is_told_and_a_worker_without_us_is_named(
    plan: Plan, results: list[RunResult]
) -> None:
    from distributed import LocalCluster

    from agent.study.cluster import on_cluster

    told: list[str] = []
    started: list[subprocess.Popen[bytes]] = []
    with LocalCluster(n_workers=0, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        address = cluster.scheduler_address

        def without_us(_: str) -> None:
            started.append(subprocess.Popen([sys.executable, "-c", WITHOUT_US, address], stderr=subprocess.DEVNULL))

        words = r"worker tcp://.*: found it cannot load widowx-coop \(.*agent.*\), .* install it there"
        with pytest.raises(StudyError, match=words):
            list(on_cluster(plan.tasks(), address, without_us))
        started[0].kill()
        started[0].wait()
        while cluster.scheduler.workers:
            time.sleep(0.01)
        runs = on_cluster(plan.tasks() * 50, address, lambda text: (told.append(text), cluster.scale(1)))
        task, result = next(runs)
        assert result == results[task.index]
        assert not logging.getLogger("distributed.client").isEnabledFor(logging.ERROR), "the refusal says it"
        cluster.close()
        with pytest.raises(
            StudyError, match=rf"scheduler {address}: found it is gone, .*same --out: finished runs are kept"
        ):
            list(runs)
    assert logging.getLogger("distributed.client").isEnabledFor(logging.ERROR)
    assert told == [f"scheduler {address} has no workers yet: start some with `dask worker {address}`"]


class _Ended:
    """A run that came to its end on a cluster whose scheduler died at some moment."""

    def __init__(self, status: str, raised: BaseException) -> None:
        self.status = status
        self._raised = raised

    def result(self) -> object:
        raise self._raised


SILENT = TimeoutError("Timed out trying to connect to tcp://127.0.0.1:18786 after 10 s")


@pytest.mark.parametrize(
    ("status", "raised", "asked"),
    [
        ("finished", SILENT, None),
        ("finished", ConnectionError("it is gone"), {}),
        ("cancelled", CancelledError("scheduler-connection-lost"), None),
        ("error", ImportError("no agent"), SILENT),
        ("error", OSError("it cannot be read"), ConnectionError("it is gone")),
        ("error", AttributeError("perform"), CancelledError("gone")),
    ],
)
def test_a_scheduler_that_dies_is_the_same_line_whatever_it_was_asked_for(
    plan: Plan, status: str, raised: BaseException, asked: BaseException | dict[str, object] | None
) -> None:
    import distributed

    from agent.study import cluster

    def run(*_: object, **__: object) -> object:
        assert asked is not None
        if isinstance(asked, BaseException):
            raise asked
        return asked

    words = r"scheduler tcp://here: found it is gone, .* start it again, and the study with the same --out"
    with pytest.raises(StudyError, match=words):
        cluster._result(distributed, SimpleNamespace(run=run), _Ended(status, raised), plan.tasks()[0], "tcp://here")


def test_a_run_that_cannot_read_a_file_where_all_is_well_with_the_scheduler_raises_it(plan: Plan) -> None:
    import distributed

    from agent.study import cluster

    client = SimpleNamespace(run=lambda *_, **__: {"tcp://one": True})
    with pytest.raises(OSError, match="it cannot be read"):
        cluster._result(distributed, client, _Ended("error", OSError("it cannot be read")), plan.tasks()[0], "tcp://a")


@pytest.mark.parametrize("when", ["submit", "as_completed"])
def test_a_scheduler_that_dies_before_the_runs_are_with_it_is_that_line_too(plan: Plan, when: str) -> None:
    import distributed

    from agent.study import cluster

    def gone(*_: object, **__: object) -> object:
        raise distributed.client.ClosedClientError("Client is closed") if when == "submit" else SILENT

    client = SimpleNamespace(scheduler_info=lambda: {"workers": []}, submit=gone, loop=None)
    if when == "as_completed":
        client.submit = lambda *_, **__: object()
    seen = SimpleNamespace(as_completed=gone, client=distributed.client)
    with pytest.raises(StudyError, match="scheduler tcp://here: found it is gone"):
        list(cluster._done(seen, client, plan.tasks(), "tcp://here", lambda _: None))


def test_a_client_that_cannot_say_goodbye_to_a_dead_scheduler_hides_no_line(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    from agent.study import cluster

    def close() -> None:
        raise SILENT

    def submit(*_: object, **__: object) -> object:
        raise CancelledError("gone")

    client = SimpleNamespace(scheduler_info=lambda: {"workers": []}, submit=submit, loop=None, close=close)
    monkeypatch.setattr(cluster, "_require_answer", lambda *_: None)
    monkeypatch.setattr(cluster, "_client", lambda *_: client)
    with pytest.raises(StudyError, match="scheduler tcp://here: found it is gone"):
        list(cluster.on_cluster(plan.tasks(), "tcp://here"))


def test_a_scheduler_whose_last_worker_goes_is_told_once_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    from agent.study import cluster

    clock = SimpleNamespace(s=0.0)
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: clock.s, sleep=lambda _: None))
    workers: list[str] = []
    asked: list[float] = []
    told: list[str] = []

    def scheduler_info() -> dict[str, list[str]]:
        asked.append(clock.s)
        if clock.s == 15.0:
            raise OSError("it is gone")
        return {"workers": workers}

    watch = cluster._Watch(SimpleNamespace(scheduler_info=scheduler_info), "tcp://here", told.append)
    watch.look("yet")
    watch.look("yet")
    for clock.s in (4.0, 5.0, 6.0, 10.0):
        workers[:] = ["one"] if clock.s < 10.0 else []
        watch.wait()
    clock.s = 14.0
    watch.seen()
    for clock.s in (15.0, 19.0):
        watch.wait()
    assert asked == [0.0, 0.0, 5.0, 10.0, 19.0]
    clock.s = 15.0
    watch.look("any more")
    words = "start some with `dask worker tcp://here`"
    assert told == [f"scheduler tcp://here has no workers {when}: {words}" for when in ("yet", "any more")]


class _Waited:
    """Work of which the third run never comes; a person who has waited presses Ctrl-C."""

    def __init__(self, results: Sequence[RunResult]) -> None:
        self._results, self.ended = results, False

    def __call__(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, RunResult]]:
        try:
            yield from zip(tasks[:2], self._results, strict=False)
            signal.raise_signal(signal.SIGINT)
            pytest.fail("not heard")
        finally:
            self.ended = True


def test_a_stop_waits_for_no_run(tmp_path: Path, plan: Plan, results: list[RunResult]) -> None:
    work = _Waited(results)
    with stop_flag() as stop:
        outcome = run_study(plan, tmp_path, partial(until, stop, work), stop, Told())
        assert (work.ended, outcome.interrupted, outcome.document["runs"]) == (True, True, 2)
        assert not list(until(stop, work, plan.tasks())), "it was asked for before"


def test_a_study_that_nobody_stops_has_all_its_runs_and_what_they_raise(plan: Plan, results: list[RunResult]) -> None:
    def failing(tasks: Sequence[Task]) -> Iterator[tuple[Task, RunResult]]:
        yield tasks[0], results[0]
        raise StudyError("a run", found="a defect", expected="none", remedy="mend it")

    with stop_flag() as stop:
        known = list(zip(plan.tasks(), results, strict=True))
        assert list(until(stop, lambda _: iter(known), plan.tasks())) == known
        with pytest.raises(StudyError, match="a defect"):
            list(until(stop, failing, plan.tasks()))
