"""What a stop does to guards that hold the arms of a session in their agents' places, to the end of their loops.

The guard's own loop, session and control socket on emulated servos, until every guard has ended by itself.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import configs
from agent.config.cell import load_cell
from agent.modes import Mode
from agent.operator.session_table import SESSION
from agent.operator.table import Verb
from tests.support.servos.phase_rig import At, PhaseRun, Step
from tests.support.servos.stopped_guards import StoppedGuards
from tests.unit.test_phases import QUICK

CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", QUICK)
HOLD, LOWER, RELEASE, PARK, HALT, REST = Mode.HOLD, Mode.LOWER, Mode.RELEASE, Mode.PARK, Mode.HALT, Mode.REST
HOME = [
    Step(RELEASE, Verb.PARK, PARK, 0.8),
    Step(REST, Verb.RELEASE, None, 0.1),
]


def kill(rig: PhaseRun) -> None:
    rig.kill()


def sigterm(rig: PhaseRun) -> None:
    rig.interrupt()


def way(rig: StoppedGuards, arm: str, begins: Mode) -> list[Mode]:
    """The modes of a guard's rows, from that in which it stood."""
    modes = [mode for _, mode in rig.arms[arm].modes]
    return modes[modes.index(begins) :]


def ended_in(rig: StoppedGuards, arm: str) -> Mode:
    summary = rig.arms[arm].summary
    assert summary is not None
    return summary.mode


@pytest.mark.parametrize("hold", [False, True])
def test_a_stop_of_a_guard_that_holds_the_object_goes_on_holding_and_every_word_leads_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, hold: bool
) -> None:
    """Of emulated servos too, and however the guard was started: as its agent answers the same word."""
    steps = [
        Step(Mode.READY, Verb.START, Mode.TRACK, 0.5),
        Step(Mode.TRACK, kill, HOLD, 1.0),
        Step(HOLD, Verb.STOP, HOLD, 0.3),
        Step(HOLD, Verb.STOP, HOLD, 0.3),
        Step(HOLD, sigterm, HOLD, 0.3),
        Step(HOLD, Verb.LOWER, LOWER, 0.3),
        Step(LOWER, Verb.STOP, HOLD, 0.2),
        Step(HOLD, Verb.LOWER, LOWER, 0.2),
        Step(LOWER, Verb.RELEASE, RELEASE, 0.8),
        *HOME,
    ]
    rig = StoppedGuards(CELL, At.GRIPPED, steps, tmp_path, monkeypatch, hold=hold)
    assert rig.ended == dict.fromkeys(rig.arms, True), rig.mode
    for name in rig.arms:
        assert way(rig, name, HOLD) == [HOLD, LOWER, HOLD, LOWER, RELEASE, PARK, REST]
        assert ended_in(rig, name) is Mode.OFF
    stops = [reply for _, verb, reply in rig.replies if verb is Verb.STOP]
    assert stops
    for reply in stops:
        assert reply.ok
        assert reply.details["drops_on_stop"] is False, "what the answer to a stop says"
    assert SESSION[Verb.STOP][HOLD].becomes is HOLD
    below_m = rig.height(rig.step_ns[2]) - min(z for ns, z in rig.heights if rig.step_ns[2] <= ns < rig.step_ns[5])
    assert below_m < 2e-3, "held, not let go"


@pytest.mark.parametrize("hold", [False, True])
def test_a_stop_of_a_guard_that_stands_and_one_that_gives_back_ends_in_one_mode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, hold: bool
) -> None:
    """HALT goes on standing; RELEASE holds as long as its gripper has not begun to open."""
    steps = [
        Step(Mode.READY, kill, HOLD, 0.6),
        Step(HOLD, Verb.RELEASE, RELEASE, 0.3),
        Step(RELEASE, Verb.STOP, HOLD, 0.1),
        Step(HOLD, Verb.RELEASE, RELEASE, 0.3),
        Step(RELEASE, Verb.STOP, HALT, 0.8),
        Step(HALT, Verb.STOP, HALT, 0.3),
        Step(HALT, sigterm, HALT, 0.3),
        Step(HALT, Verb.PARK, PARK, 0.3),
        Step(PARK, Verb.STOP, HALT, 0.1),
        Step(HALT, Verb.RELEASE, None, 0.3),
    ]
    rig = StoppedGuards(CELL, At.GRIPPED, steps, tmp_path, monkeypatch, hold=hold)
    assert rig.ended == dict.fromkeys(rig.arms, True), rig.mode
    for name in rig.arms:
        assert way(rig, name, HOLD) == [HOLD, RELEASE, HOLD, RELEASE, HALT, PARK, HALT]
        assert ended_in(rig, name) is Mode.OFF


@pytest.mark.parametrize("hold", [False, True])
def test_a_guard_of_no_session_ends_with_a_stop_or_with_the_release_behind_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, hold: bool
) -> None:
    """As of an arm without a gripper: emulated it lets go at a stop, with `--hold` it holds until it is released."""
    steps = [Step(Mode.READY, kill, HOLD, 0.6), Step(HOLD, Verb.STOP, HOLD if hold else None, 0.3)]
    if hold:
        steps += [Step(HOLD, sigterm, HOLD, 0.3), Step(HOLD, Verb.RELEASE, None, 0.3)]
    rig = StoppedGuards(CELL, At.GRIPPED, steps, tmp_path, monkeypatch, hold=hold, session=False)
    assert rig.ended == dict.fromkeys(rig.arms, True), rig.mode
    for name in rig.arms:
        assert way(rig, name, HOLD) == [HOLD]
        assert ended_in(rig, name) is Mode.OFF
    assert {reply.details["drops_on_stop"] for _, _, reply in rig.replies} == {not hold}
