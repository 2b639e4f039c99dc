"""Logs of whole runs, recorded over the network by the real processes, replay bit for bit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from agent.log.read import RunLog, read_log
from tests.process.conftest import PAPER_RUN_S, SHORT, WAITING, RunOf
from tests.support.command import coop

BOX = ("three_wx250s", "--duration", 0.7, "--no-report")
HELD = ("paper", "--set", "safety.tracking_error_max_m=0.0002", *SHORT)
RUNS = {
    "waiting before the start, alignment": WAITING,
    "a hold": HELD,
}
MORE = {
    "six joints, internal force, adaptive": (*BOX, "--set", 'controller.kind="adaptive"'),
    "adaptive": ("paper_adaptive", "--set", "simulation.object_mass_error=1.0", *SHORT),
    "six joints, internal force": BOX,
}


def test_a_run_of_two_arms_is_verified(paper_runs: tuple[Path, Path]) -> None:
    done = coop("replay", "--verify", paper_runs[0] / "run.mcap", "--json")
    document = json.loads(done.out)
    assert (done.code, document["equal"], document["rows_different"]) == (0, True, 0)
    assert document["rows_compared"] == 2 * 200 * PAPER_RUN_S


@pytest.mark.parametrize(
    "words",
    [*RUNS.values(), *(pytest.param(words, marks=pytest.mark.long) for words in MORE.values())],
    ids=[*RUNS, *MORE],
)
def test_every_kind_of_run_is_verified_from_its_first_row_and_from_its_middle(
    run_of: RunOf, words: tuple[str | float, ...]
) -> None:
    require_verified(run_of(*words))


def test_the_run_that_waits_is_one_of_arms_that_align(run_of: RunOf) -> None:
    for rows in read_log(run_of(*WAITING) / "run.mcap").agents.values():
        assert rows["t"][0] < 0.0
        assert rows["shift"][-1, :3].any(), "the verdicts on this run are of alignment, too"


@pytest.mark.realtime
@pytest.mark.timeout(400)
def test_a_run_of_the_real_driver_from_rest_to_rest_is_verified(whole_run: tuple[Path, RunLog]) -> None:
    run, log = whole_run
    require_verified(run, len(log.agents[next(iter(log.agents))]) // 2)


def require_verified(run: Path, row: int = 71) -> None:
    first, *_, last = read_log(run / "run.mcap").agents
    for begin in ((), ("--row", str(row), "--arm", first), ("--from", "0.5", "--arm", last)):
        verified = coop("replay", "--verify", run / "run.mcap", *begin)
        assert verified.code == 0, verified.out + verified.err
        assert "differ" not in verified.out


def test_a_log_cut_anywhere_is_verified_as_far_as_it_goes(tmp_path: Path, paper_runs: tuple[Path, Path]) -> None:
    data, path = (paper_runs[0] / "run.mcap").read_bytes(), tmp_path / "cut.mcap"
    compared = []
    for k in range(1, 12):
        path.write_bytes(data[: len(data) * k // 12])
        done = coop("replay", "--verify", path, "--json")
        assert done.code in (0, 2), done.out
        if done.code == 0:
            document = json.loads(done.out)
            assert (document["equal"], document["complete"]) == (True, False)
            compared.append(document["rows_compared"])
        else:
            assert done.err.startswith("coop: ")
    assert len(compared) > 5
    assert compared == sorted(compared)
    assert compared[0] > 0


def test_two_runs_of_one_cell_are_the_same_and_another_cell_is_not(
    run_of: RunOf, paper_runs: tuple[Path, Path]
) -> None:
    a, b = (folder / "run.mcap" for folder in paper_runs)
    assert coop("replay", a, "--same-as", b).code == 0
    done = coop("replay", a, "--same-as", run_of(*HELD) / "run.mcap")
    assert done.code == 1
    assert "first difference: row 0 of left" in done.out
