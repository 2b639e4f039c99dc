"""What a study runs, and the file in which its finished runs wait."""

from __future__ import annotations

import json
import math
import os
import resource
from dataclasses import replace
from pathlib import Path

import pytest

import configs
from agent.atomic import WriteError
from agent.config.cell import ConfigError
from agent.config.schema.fault import FaultKind
from agent.study.lab import Laboratory, Run
from agent.study.measure import RunResult, run_once
from agent.study.plan import Plan, load_plan, seed_of
from agent.study.provenance import provenance
from agent.study.store import RUNS_FILE, Store, StudyError
from agent.study.work import here, perform
from drivers.interface import Refusal
from tests.support.study import PAPER, SHORT, cell_file


@pytest.fixture(scope="module")
def plan() -> Plan:
    return load_plan(PAPER, runs=3, seed=4, overrides=SHORT)


@pytest.fixture(scope="module")
def results(plan: Plan) -> list[RunResult]:
    return [result for _, result in here(plan.tasks())]


def test_a_cell_alone_is_a_study_of_two_hundred_runs() -> None:
    plan = load_plan(Path("two_wx200"))
    assert [c.file.name for c in plan.cells] == ["two_wx200"]
    assert (plan.runs, plan.seed, plan.faults) == (200, 0, ())
    assert len(plan.tasks()) == 200


def test_a_study_file_names_cells_beside_it_and_shipped_ones(tmp_path: Path) -> None:
    cell_file(tmp_path)
    study = tmp_path / "study.toml"
    study.write_text(
        'format = 1\ncells = ["short.toml", "two_models"]\nruns = 7\nseed = 3\nduration_s = 30.0\n'
        'set = ["tolerance.base_m=0.004"]\n[[faults]]\nkind = "limp"\narm = "left"\nat_s = 2.0\n'
    )
    plan = load_plan(study)
    assert [c.file.name for c in plan.cells] == ["paper", "two_models"]
    assert {c.file.duration_s for c in plan.cells} == {30.0}
    assert {c.file.tolerance.base_m for c in plan.cells} == {0.004}
    assert (plan.runs, plan.seed) == (7, 3)
    assert [(f.kind, f.arm, f.at_s) for f in plan.faults] == [(FaultKind.LIMP, "left", 2.0)]
    tasks = plan.tasks()
    assert [t.key for t in tasks] == [(c, i) for c in (0, 1) for i in range(7)]
    other = load_plan(study, runs=2, seed=9, duration_s=25.0, overrides=["tolerance.base_m=0.001"])
    assert (other.runs, other.seed, other.cells[0].file.duration_s) == (2, 9, 25.0)
    assert other.cells[0].file.tolerance.base_m == 0.001


def test_seeds_are_of_study_and_run_and_shared_by_the_cells() -> None:
    seeds = [seed_of(s, i) for s in range(3) for i in range(50)]
    assert len(set(seeds)) == 150
    assert seed_of(1, 2) == seed_of(1, 2)
    tasks = load_plan(PAPER, runs=2, seed=5, overrides=SHORT).tasks()
    assert [t.seed for t in tasks] == [seed_of(5, 0), seed_of(5, 1)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = 1\ncells = []\n", "cells"),
        ('format = 1\ncells = ["paper"]\nruns = 0\n', "runs"),
        ('format = 1\ncells = ["paper"]\nrun = 1\n', "did you mean runs"),
        ('format = 2\ncells = ["paper"]\n', "format"),
        ('format = 1\ncells = ["nowhere"]\n', "nowhere"),
        ('format = 1\ncells = ["paper"]\n[[faults]]\nkind = "limp"\narm = "middle"\nat_s = 1.0\n', "middle"),
        ('format = 1\ncells = ["paper"]\n[[faults]]\nkind = "limb"\narm = "left"\nat_s = 1.0\n', "limp"),
        (
            'format = 1\ncells = ["paper"]\nduration_s = 25.0\n[[faults]]\nkind = "limp"\narm = "left"\nat_s = 25.0\n',
            "faults: limp left at 25 s, in cell paper: found 25 s in runs of 25 s, whose last cycle is at 24.995 s",
        ),
        (
            """format = 1\ncells = ["paper"]\nset = ["simulation.fault=[{kind='open', arm='right', at_s=100.0}]"]\n""",
            "simulation.fault: open right at 100 s, in cell paper: found 100 s in runs of 100 s, whose last",
        ),
        ('format = 1\ncells = ["paper"]\nduration_s = 5.0\n', "transient of 20 s"),
        (
            'format = 1\ncells = ["paper"]\nduration_s = 21.0\nset = ["simulation.observe_rate_hz=0.15"]\n',
            "0.15 Hz: the object is last seen at 19.995 s, expected to see it after the transient of 20 s;",
        ),
        ('format = 1\ncells = ["paper"]\nset = ["simulation.reality.seed=1"]\n', "draws one for each run"),
        (
            'format = 1\ncells = ["two_models", "paper", "two_models"]\n',
            "cells of name two_models: found 2 in one study",
        ),
    ],
)
def test_a_study_that_cannot_be_meant_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(Refusal) as caught:
        load_plan(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "fault",
    [
        '[[faults]]\nkind = "limp"\narm = "left"\nat_s = 24.995\n',
        """set = ["simulation.fault=[{kind='limp', arm='left', at_s=24.995}]"]\n""",
    ],
    ids=["of the study", "of the cell"],
)
def test_a_fault_in_the_last_cycle_happens(tmp_path: Path, fault: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(f'format = 1\ncells = ["paper"]\nduration_s = 25.0\n{fault}')
    plan = load_plan(path)
    run = Run(Laboratory(plan.cells[0]), None, plan.faults)
    run.tick = run.ready_ticks + 25 * 200 - 1
    run.advance()
    assert run.places[0].limp


def test_a_name_that_no_file_can_have_is_none_of_a_cell(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(f'format = 1\ncells = ["{"x" * 9000}"]\n')
    with pytest.raises(ConfigError, match=r"^cells in study\.toml: found x{119}…, no file in .*beside the study"):
        load_plan(path)


def test_a_cell_of_the_current_folder_alone_is_none_of_the_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    cell_file(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "two_models").write_text("not what ships")
    monkeypatch.chdir(tmp_path / "elsewhere")
    path = tmp_path / "study.toml"
    path.write_text('format = 1\ncells = ["short.toml"]\n')
    with pytest.raises(ConfigError, match=r"cells in study\.toml: found short\.toml, no file in .*beside the study"):
        load_plan(path)
    path.write_text('format = 1\ncells = ["two_models"]\n')
    assert [c.file.name for c in load_plan(path).cells] == ["two_models"]
    path.write_text(f'format = 1\ncells = ["elsewhere/short.toml", "{tmp_path}/elsewhere/short.toml"]\n')
    with pytest.raises(ConfigError, match="cells of name paper: found 2"):
        load_plan(path)


@pytest.mark.parametrize("in_file", [False, True], ids=["of a cell", "of a study"])
@pytest.mark.parametrize(
    ("key", "value"),
    [("runs", 0), ("runs", 100_001), ("seed", -1), ("seed", 2**63), ("duration_s", 0.0), ("duration_s", 1.1e6)],
)
def test_what_a_command_gives_keeps_the_bounds_of_a_study_file(
    tmp_path: Path, key: str, value: float, in_file: bool
) -> None:
    study = tmp_path / "study.toml"
    study.write_text(f'format = 1\ncells = ["paper"]\n{key} = {value}\n')
    with pytest.raises(ConfigError, match=f"^{key} in study.toml: found {value}"):
        load_plan(study)
    study.write_text('format = 1\ncells = ["paper"]\nruns = 3\nseed = 4\nduration_s = 30.0\n')
    with pytest.raises(ConfigError, match=f"^{key} in the command: found {value}"):
        load_plan(study if in_file else PAPER, **{key: value})  # type: ignore[arg-type]


def test_a_file_that_is_neither_is_refused_as_a_cell(tmp_path: Path) -> None:
    path = tmp_path / "torn.toml"
    for text in ("cells = [", "a = " + "9" * 5000, "a = " + "[" * 5000):
        path.write_text(text)
        with pytest.raises(ConfigError, match=r"torn\.toml: found .*, expected TOML"):
            load_plan(path)
    with pytest.raises(ConfigError, match="nowhere"):
        load_plan(Path("nowhere"))


def test_finished_runs_come_back_as_they_were(tmp_path: Path, plan: Plan, results: list[RunResult]) -> None:
    with Store(tmp_path / "new" / "folder", plan) as store:
        for task, result in zip(plan.tasks(), results, strict=True):
            store.add(task, result)
    with Store(tmp_path / "new" / "folder", plan) as store:
        assert store.results == {(0, i): result for i, result in enumerate(results)}


def test_a_run_whose_line_was_cut_off_counts_as_none_and_the_file_goes_on(
    tmp_path: Path, plan: Plan, results: list[RunResult]
) -> None:
    with Store(tmp_path, plan) as store:
        store.add(plan.tasks()[0], results[0])
        store.add(plan.tasks()[1], results[1])
    path = tmp_path / RUNS_FILE
    path.write_bytes(path.read_bytes()[:-20])
    with Store(tmp_path, plan) as store:
        assert store.results == {(0, 0): results[0]}
        store.add(plan.tasks()[2], results[2])
    with Store(tmp_path, plan) as store:
        assert store.results == {(0, 0): results[0], (0, 2): results[2]}
    assert all(json.loads(line) for line in path.read_text().splitlines())


def test_who_keeps_a_study_locked_is_named(tmp_path: Path, plan: Plan) -> None:
    held = rf"found another `coop study` .* lock of process {os.getpid()} \("
    with Store(tmp_path, plan), pytest.raises(StudyError, match=held):
        Store(tmp_path, plan)


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"seed": 5}, "found runs of seed 4, not 5, expected"),
        ({"overrides": [*SHORT, "tolerance.base_m=0.002"]}, "found runs of other cells, or another duration, expected"),
    ],
)
def test_runs_of_another_study_are_not_mixed_in_and_what_differs_is_told(
    tmp_path: Path, plan: Plan, other: dict[str, object], told: str
) -> None:
    with Store(tmp_path, plan):
        pass
    changed = load_plan(PAPER, **({"runs": 3, "seed": 4, "overrides": SHORT} | other))  # type: ignore[arg-type]
    with pytest.raises(StudyError, match=told):
        Store(tmp_path, changed)
    with Store(tmp_path, replace(plan, runs=50)) as more:
        assert more.results == {}


@pytest.mark.parametrize("key", ["numpy", "sources"])
def test_runs_of_another_version_or_source_are_not_mixed_in(tmp_path: Path, plan: Plan, key: str) -> None:
    with Store(tmp_path, plan):
        pass
    path = tmp_path / RUNS_FILE
    ours = f'"{key}": "{provenance()[key]}"'
    assert ours in path.read_text()
    path.write_text(path.read_text().replace(ours, f'"{key}": "1.0"'))
    with pytest.raises(StudyError, match=rf"found runs of {key} 1\.0, not "):
        Store(tmp_path, plan)


@pytest.mark.parametrize(
    "mine", [b"not json\n", b"not json", b'{"cells": ["mine"]}', b"\0", b"[" * 10**5 + b"\n"],
    ids=["text", "cut text", "another's", "binary", "too deep"],
)  # fmt: skip
def test_a_file_of_runs_that_is_none_is_refused_and_kept(tmp_path: Path, plan: Plan, mine: bytes) -> None:
    path = tmp_path / RUNS_FILE
    path.write_bytes(mine)
    with pytest.raises(StudyError, match=r"line 1 of .*runs\.jsonl: found no run of a study.*--out, or give --force"):
        Store(tmp_path, plan)
    assert path.read_bytes() == mine
    with Store(tmp_path, plan, anew=True):
        assert not path.read_bytes().startswith(mine)


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"seed": 5}, "run 0 of paper with seed 5, of another study"),
        ({"index": 1}, "run 1 of paper with seed "),
        ({"cell": "two_wx200"}, "run 0 of two_wx200 with seed "),
        ({"cell_place": 1}, "run 0 of paper with seed "),
        ({"cell_place": [0]}, "no run of a study"),
        ({"index": -1}, "no run of a study"),
        ({"position_error_m": "abc"}, "no run of a study"),
        ({"position_error_m": None}, "no run of a study"),
        ({"position_error_m": math.nan}, "no run of a study"),
        ({"lost_s": math.inf}, "no run of a study"),
        ({"lost": 0}, "no run of a study"),
        ({"why": 3}, "no run of a study"),
    ],
)
def test_a_line_that_is_no_run_of_this_study_is_refused_and_kept(
    tmp_path: Path, plan: Plan, results: list[RunResult], changes: dict[str, object], found: str
) -> None:
    with Store(tmp_path, plan) as store:
        store.add(plan.tasks()[0], results[0])
    path = tmp_path / RUNS_FILE
    first, run = path.read_text().splitlines()
    path.write_text(f"{first}\n{json.dumps(json.loads(run) | changes)}\n")
    before = path.read_bytes()
    with pytest.raises(StudyError, match=rf"line 2 of .*runs\.jsonl: found {found}.*--out, or give --force"):
        Store(tmp_path, plan)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"faults": [{"kind": "limp"}]}, "found runs of other faults, expected"),
        ({"versions": {"numpy": "0.1"}}, "numpy 0.1, not "),
        ({"versions": 5}, "sources None, not "),
        ({"more": 1}, "found runs of another study, expected"),
    ],
)
def test_of_a_study_of_other_versions_or_faults_it_is_told_which(
    tmp_path: Path, plan: Plan, changes: dict[str, object], told: str
) -> None:
    with Store(tmp_path, plan):
        pass
    path = tmp_path / RUNS_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | changes) + "\n")
    with pytest.raises(StudyError, match=told):
        Store(tmp_path, plan)


@pytest.mark.parametrize("left", [0, 1, 40, -1])
def test_a_study_whose_first_line_was_cut_off_begins_again(tmp_path: Path, plan: Plan, left: int) -> None:
    with Store(tmp_path, plan):
        pass
    path = tmp_path / RUNS_FILE
    whole = path.read_bytes()
    path.write_bytes(whole[:left])
    with Store(tmp_path, plan) as store:
        assert store.results == {}
    assert path.read_bytes() == whole


def test_no_place_to_write_is_refused_before_a_run(tmp_path: Path, plan: Plan) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(Refusal, match="name another path"):
        Store(tmp_path / "file" / "out", plan)
    (tmp_path / "out" / RUNS_FILE).mkdir(parents=True)
    with pytest.raises(Refusal, match="name another --out"):
        Store(tmp_path / "out", plan)


@pytest.mark.parametrize("room", [100, 500])  # bytes: for half of what the study is of, or half of a run
def test_a_disk_that_is_full_is_told_with_the_file_and_what_is_kept(
    tmp_path: Path, plan: Plan, results: list[RunResult], room: int
) -> None:
    whole = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, whole[1]))
        with pytest.raises(WriteError, match=r"runs\.jsonl.*finished runs are kept"):  # noqa: SIM117
            with Store(tmp_path, plan) as store:
                store.add(plan.tasks()[0], results[0])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, whole)
    assert (tmp_path / RUNS_FILE).stat().st_size == room
    with Store(tmp_path, plan) as store:
        assert store.results == {}


def test_a_task_is_its_run_wherever_it_is_done(plan: Plan, results: list[RunResult]) -> None:
    task = plan.tasks()[1]
    assert perform(task) == results[1] == run_once(Laboratory(plan.cells[0]), 1, seed_of(4, 1))


def test_shipped_cells_can_be_studied() -> None:
    for path in sorted(configs.CELLS_DIR.glob("*.toml")):
        if not path.stem.startswith("identify"):
            assert load_plan(path, runs=1, duration_s=60.0).tasks()
