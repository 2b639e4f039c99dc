"""Rows of loops that lost time, fell blind, came back, went from rest to rest or were guided by hand replay as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.config.cell import Cell
from agent.cycles import Patience
from agent.log.read import open_log
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.replay.chain import Chain
from agent.replay.comparison import Comparison
from agent.replay.rows import Window
from agent.replay.source import recorded_cell
from agent.replay.verify import verify
from agent.safety import Flag
from drivers.interface import JointState, Vector
from tests.support.runner_rig import fault, lost_at, paper, period_ns, q_start, run, wandering
from tests.support.session_script import TO_READY, Script, cell, floating, guided, q_grasp, run_of
from tests.support.telemetry.run_log import write_run


def replayed(folder: Path, of: Cell, rows: np.ndarray, begin: int) -> Comparison:
    path = write_run(folder / f"{begin}.mcap", of, {of.arms[0].name: rows})
    with open_log(path) as log:
        return verify(log, recorded_cell(log), Window(from_row=begin))


def held(n: int) -> Event:
    return Event.STOP if n == 15 else Event.RELEASED if n == 40 else Event.NONE


TROUBLES: dict[str, tuple[dict[str, Any], Flag]] = {
    "lost time": ({"oversleeps_ns": {16: 10 * period_ns()}, "patience": Patience(), "ticks": 60}, Flag.GAP),
    "blind": ({"failures": lost_at(*range(15, 24)), "patience": Patience(repeat=3, blind=20), "ticks": 40}, Flag.BLIND),
    "back": ({"operator": held, "returning": {"lapses": frozenset({20})}, "hold_at_end": True}, Flag.RESUMED),
    "fault": ({"failures": {15: fault(False)}}, Flag.NONE),
}


@pytest.mark.parametrize(("of", "flag"), TROUBLES.values(), ids=TROUBLES)
def test_trouble_replays(tmp_path: Path, of: dict[str, Any], flag: Flag) -> None:
    rows = run(q=wandering, **of).rows
    marked = np.flatnonzero(rows["flags"] & flag.value)
    assert len(marked) or not flag
    for begin in (0, *marked[:1].tolist()):
        assert replayed(tmp_path, paper(), rows, begin).equal


def swaying(read: int) -> Vector:
    return q_grasp() + 1e-4 * np.sin(0.7 * read + np.arange(3))


SESSIONS = {
    "there and back": TO_READY | {9: Event.RELEASED, 12: Event.PARK, 15: Event.ARRIVED},
    "stopped on its way": {2: Event.APPROACH, 5: Event.STOP, 8: Event.PARK},
    "held and lowered": TO_READY | {9: Event.STOP, 12: Event.LOWER, 15: Event.RELEASED},
}


@pytest.mark.parametrize("happens", SESSIONS.values(), ids=SESSIONS)
def test_a_session_replays(tmp_path: Path, happens: dict[int, Event]) -> None:
    done = run_of(Script(happens), last=18, q=swaying, start_ns=lambda *_: None)
    assert len(done.modes) > 3
    verdict = replayed(tmp_path, cell(), done.rows, 0)
    assert (verdict.first, verdict.equal) == (None, True)


def test_a_session_that_starts_and_one_that_is_stopped_unseen_replay(tmp_path: Path) -> None:
    script = Script(TO_READY | {20: Event.STOP})
    rows = run_of(script, last=24, q=swaying, start_ns=lambda reads, zero: zero + (reads > 8)).rows
    assert Mode.TRACK in rows["mode"]
    assert replayed(tmp_path, cell(), rows, 0).equal
    unseen = run_of(Script({2: Event.APPROACH, 5: Event.STOP}), last=9, q=swaying, failures=lost_at(5)).rows
    assert replayed(tmp_path, cell(), unseen, 1).equal


def test_an_arm_that_sees_nothing_on_its_way_to_the_object_carries_itself_alone_and_replays(tmp_path: Path) -> None:
    patience = Patience(repeat=3, blind=20)
    rows = run_of(
        Script({2: Event.APPROACH}), last=16, q=swaying, failures=lost_at(*range(6, 14)), patience=patience
    ).rows
    blind = rows[(rows["flags"] & Flag.BLIND.value) > 0]
    assert set(blind["mode"].tolist()) == {Mode.APPROACH, Mode.HALT}
    agent = build_agent(cell(), cell().arms[0])
    seen = rows["memory"][np.flatnonzero(rows["flags"] & Flag.BLIND.value)[0]][: len(q_grasp())]
    np.testing.assert_array_equal(blind["tau_limited"][-1][: len(seen)], agent.model.evaluate(seen, 0.0 * seen).g)
    assert replayed(tmp_path, cell(), rows, 0).equal


@pytest.mark.parametrize("lost", [(), (6,)], ids=["seen", "unseen"])
def test_an_arm_that_a_hand_guides_replays(tmp_path: Path, lost: tuple[int, ...]) -> None:
    rows = guided(lost_at(*lost), observer=True).rows
    assert {Mode.FLOAT, Mode.STAND, Mode.SINK} == set(rows["mode"].tolist())
    assert replayed(tmp_path, floating(), rows, 0).equal


def test_a_row_without_a_state_holds_nothing_whatever_stands_in_it() -> None:
    chain = Chain(build_agent(paper(), paper().arms[0]))
    state = JointState(0, q_start(), np.zeros(3), np.zeros(3))
    with pytest.raises(AssertionError, match="neither started nor restored"):
        chain.pass_row(state, 0.0, Mode.READY, 0)
    chain.start()
    assert chain.pass_row(state, 0.0, Mode.READY, int(Flag.STALE))[0].hold is None
    assert chain.pass_row(state, 0.0, Mode.READY, 0)[0].hold is not None
