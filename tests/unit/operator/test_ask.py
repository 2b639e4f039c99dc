"""Whose answer counts where an arm has several places, and one of them is a stranger's."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

import configs
from agent.config.cell import load_cell
from agent.host import paths
from agent.host.paths import control_path, control_paths, make_runtime_dir, ring_path
from agent.modes import Mode
from agent.operator.ask import Reply, Silence, ask_arms
from agent.operator.message import Request
from agent.operator.status import status
from agent.operator.table import Verb
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.command import coop
from tests.support.operated_arms import ABSENT, DEAD, HUNG, PATIENT_S, QUICK_S, Arm, Condition, cell_of, serving
from tests.unit.operator.test_status import CLOCK

CELL = load_cell(configs.CELLS_DIR / "paper.toml")


@pytest.mark.parametrize(
    ("places", "counts"),
    [
        ((Mode.HOLD, HUNG), 1),
        ((HUNG, Mode.HOLD), 0),
        ((Mode.HOLD, Mode.TRACK), 1),
        ((HUNG, Mode.TRACK), 0),
        ((Mode.TRACK, HUNG), 1),
        ((DEAD, Mode.HOLD), 1),
        ((ABSENT, Mode.TRACK), 1),
    ],
)
def test_of_two_places_of_an_arm_the_graver_answer_counts_to_a_release(
    tmp_path: Path, places: tuple[Condition, ...], counts: int
) -> None:
    """One that hangs before one that refuses, that before one that says yes; nobody is nobody."""
    arms = cell_of(tmp_path / "cell", places)
    with serving(arms):
        timeout_s = QUICK_S if HUNG in places else PATIENT_S
        (heard,) = ask_arms({"left": [arm.path for arm in arms]}, Request(Verb.RELEASE), timeout_s).values()
    if places[counts] == HUNG:
        assert heard == Silence("no answer within 0.04 s", hung=True)
    else:
        assert isinstance(heard, Reply)
        assert (heard.arm, heard.ok) == ("ab"[counts], places[counts] is Mode.HOLD)
    told = [arm for arm in arms if arm.condition is Mode.HOLD]
    assert [arm.heard for arm in told] == [(False, [Verb.RELEASE])] * len(told), "whatever the other one says"


@pytest.fixture
def strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Arm, ...]]:
    """Both arms of the cell as another user plays them, with rings, where this user's agents would be."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(paths, "SHARED_DIR", tmp_path)
    monkeypatch.setattr(paths, "SERVICES_DIR", tmp_path / "run")
    make_runtime_dir("paper")
    arms = tuple(Arm(control_path("paper", name), Mode.HOLD) for name in ("left", "right"))
    with ExitStack() as stack:
        for name in ("left", "right"):
            stack.enter_context(RingWriter(ring_path("paper", name), AGENT_STATE, name, ("waist",), slots=2)).commit()
        stack.enter_context(serving(arms))
        monkeypatch.setattr(paths.os, "geteuid", lambda: 12345)
        yield arms


def test_who_plays_both_arms_in_another_users_folder_is_told_nothing_and_believed_nothing(
    strangers: tuple[Arm, ...], tmp_path: Path
) -> None:
    found = f"folder {tmp_path / f'coop-{os.getuid()}'} is one of uid {os.getuid()}, not of uid 12345"
    done = coop("stop", "paper")
    assert (done.code, done.out) == (7, "")
    assert f"{found}: nobody in it is asked; have it removed, or set XDG_RUNTIME_DIR" in done.err.splitlines()[0]
    assert f"left: does not answer ({found}); right: does not answer ({found})" in done.err
    assert [arm.heard for arm in strangers] == [(False, [])] * 2
    document = status(CELL, CLOCK, logs=())
    assert [(arm["mode"], arm["alive"], arm["silence"]) for arm in document["arms"]] == [(None, False, found)] * 2


def test_another_users_folder_keeps_no_word_from_the_agents_that_units_run(strangers: tuple[Arm, ...]) -> None:
    own = [Arm(control_paths("paper", name)[1], Mode.TRACK) for name in ("left", "right")]
    for arm in own:
        arm.path.parent.mkdir(parents=True)
    with serving(own):
        done = coop("stop", "paper")
    assert done.code == 0, done.err
    assert "nobody in it is asked" in done.err
    assert [arm.heard for arm in (*own, *strangers)] == [(False, [Verb.STOP])] * 2 + [(False, [])] * 2
