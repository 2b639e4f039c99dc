"""C1: the arms of a host, and its clock."""

from __future__ import annotations

from datetime import UTC, date, datetime, time, tzinfo
from pathlib import Path

import pytest

import configs
from agent.config.cell import load_cell
from agent.host.clock import ClockState
from agent.modes import Mode
from agent.operator import local, words
from agent.operator.error import ControlError
from agent.operator.message import Request
from agent.operator.table import Verb
from agent.operator.words import Here, on_its_day, start_arms, tell_arms
from tests.support.operated_arms import DEAD, Arm, serving

PAPER = configs.CELLS_DIR / "paper.toml"
GOOD = ClockState(synchronised=True, max_error_s=2e-4)
TWO_HOSTS = ["arms.left.host=one.lab", "arms.right.host=two"]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the agents of cell `paper` are, and none that run as services."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("agent.host.paths.SERVICES_DIR", tmp_path / "services")
    folder = tmp_path / "coop" / "paper"
    folder.mkdir(parents=True)
    return folder


def test_all_arms_means_those_of_this_host(home: Path) -> None:
    cell = load_cell(PAPER, TWO_HOSTS)
    assert list(local.places(cell, [], [], "one")) == ["left"]
    assert list(local.places(cell, [], [], "two.lab")) == ["right"]
    assert list(local.places(cell, ["right"], [], "one")) == ["right"], "an arm that is named is meant"
    assert list(local.places(load_cell(PAPER), [], [], "three")) == ["left", "right"], "no host: every host"
    floats = ['floating.arms=["left"]', "floating.holding=true", "floating.others_move=true"]
    assert list(local.places(load_cell(PAPER, floats), [], [])) == ["right"], "who floats listens to nobody"
    with pytest.raises(ControlError, match=r"arms of host three: found left on one\.lab, right on two, expected"):
        local.places(cell, [], [], "three")
    arm = Arm(home / "right.control", Mode.TRACK)
    with serving([arm]):
        assert tell_arms(cell, Verb.STOP, [], [], "two") == "right holds the object where it is"
    assert arm.heard == (False, [Verb.STOP])


def test_a_start_without_one_of_this_hosts_arms_is_refused(home: Path) -> None:
    cell = load_cell(PAPER)
    arm = Arm(home / "left.control", Mode.READY, cell.fingerprint)
    with (
        serving([arm]),
        pytest.raises(ControlError, match=r"start: found right: does not answer \(nothing at .*/right.control or "),
    ):
        start_arms(cell, None, 60.0, [], Here(GOOD, "one"), print)
    assert arm.heard == (False, [])


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_word_to_arms_that_are_elsewhere_says_where_it_looked_and_who_has_other_places(
    home: Path, missing: int
) -> None:
    """missing: of the cell's folder and the one around it, which nobody has made before a first start."""
    for folder in (home, home.parent)[:missing]:
        folder.rmdir()
    with pytest.raises(ControlError, match=r"does not answer \(nothing at ") as raised:
        tell_arms(load_cell(PAPER), Verb.STOP, ["left"], [])
    assert str(home / "left.control") in str(raised.value)
    elsewhere = "; agents of another user, XDG_RUNTIME_DIR or cell name listen elsewhere"
    assert raised.value.remedy.endswith(elsewhere)
    home.mkdir(parents=True, exist_ok=True)
    with serving([Arm(home / "left.control", DEAD)]), pytest.raises(ControlError) as raised:
        tell_arms(load_cell(PAPER), Verb.STOP, ["left"], [])
    assert elsewhere not in str(raised.value), "its place is known"


def test_a_service_that_lives_counts_before_what_an_agent_by_hand_has_left(home: Path, tmp_path: Path) -> None:
    (tmp_path / "services" / "left").mkdir(parents=True)
    dead, alive = Arm(home / "left.control", DEAD), Arm(tmp_path / "services" / "left" / "left.control", Mode.HOLD)
    with serving([dead, alive]):
        assert (
            tell_arms(load_cell(PAPER), Verb.RELEASE, ["left"], [])
            == "left switches its torque off, and its agent ends"
        )
    assert alive.heard == (False, [Verb.RELEASE])


@pytest.mark.parametrize(
    ("clock", "two_hosts", "outcome"),
    [
        (GOOD, True, "clock of this host: synchronised, error at most 0.2 ms"),
        (ClockState(True, 1.1e-3), True, "error at most 1.1 ms; WARNING: above 1 ms arms press on each other"),
        (ClockState(True, 5e-3), True, "WARNING"),
        (ClockState(True, 5.1e-3), True, None),
        (ClockState(False, 1e-4), True, None),
        (ClockState(True, float("nan")), True, None),
        (ClockState(False, 16.0), False, "not synchronised, error at most 16 s; without effect where one host"),
    ],
)
@pytest.mark.parametrize("named", [False, True], ids=["of this host", "sockets named"])
@pytest.mark.fault("C1")
def test_a_start_on_several_hosts_needs_their_time(
    home: Path, clock: ClockState, two_hosts: bool, outcome: str | None, named: bool
) -> None:
    """C1, C2: refused before anybody is asked; without effect where one host has all arms."""
    cell = load_cell(PAPER, TWO_HOSTS if two_hosts else ["arms.left.host=one", "arms.right.host=one"])
    here = ["left"] if two_hosts else ["left", "right"]
    arms = [Arm(home / f"{name}.control", Mode.READY, cell.fingerprint) for name in here]
    sockets = [home / f"{name}.control" for name in here] if named else []
    told: list[str] = []
    with serving(arms):
        if outcome is None:
            with pytest.raises(
                ControlError, match=r"clock of this host: found .*, expected synchronised, error ≤ 5 ms"
            ):
                start_arms(cell, None, 60.0, sockets, Here(clock, "one"), told.append)
        else:
            start_arms(cell, None, 60.0, sockets, Here(clock, "one"), told.append)
            assert outcome in told[0]
    assert [arm.heard for arm in arms] == [(outcome is not None, [])] * len(arms)


@pytest.mark.fault("C1")
def test_a_start_by_sockets_from_a_host_that_the_cell_does_not_name_needs_the_time_too(tmp_path: Path) -> None:
    bad = Here(ClockState(True, 5.1e-3), "three")
    with pytest.raises(ControlError, match="clock of this host: found "):
        start_arms(load_cell(PAPER, TWO_HOSTS), None, 60.0, [tmp_path / "left.control"], bad, print)


@pytest.mark.parametrize(
    ("at", "in_s", "complaint", "code"),
    [
        (None, None, "no instant, or two", 2),  # of the command line, as a wrong option is
        ("10:00:00", 1.0, "no instant, or two", 2),
        ("noon", None, "'noon'", 2),
        (None, 0.01, "at least 0.05 s from now", 7),
    ],
)
def test_an_instant_that_makes_no_sense_is_one_line(
    home: Path, at: str | None, in_s: float | None, complaint: str, code: int
) -> None:
    """C5."""
    with pytest.raises(ControlError, match=complaint) as refused:
        start_arms(load_cell(PAPER), at, in_s, [], Here(GOOD), print)
    assert refused.value.exit_code == code


@pytest.mark.parametrize(("clock", "told"), [(GOOD, 2e-4), (ClockState(synchronised=False, max_error_s=16.0), None)])
def test_arms_are_told_how_far_the_clock_may_be_off_where_that_is_known(
    home: Path, monkeypatch: pytest.MonkeyPatch, clock: ClockState, told: float | None
) -> None:
    given = list[Request]()
    monkeypatch.setattr(words, "start_together", lambda _, request: given.append(request))
    start_arms(load_cell(PAPER), None, 60.0, [], Here(clock), print)
    assert [request.clock_bound_s for request in given] == [told]


@pytest.mark.parametrize(
    ("now", "at", "ahead_s"),
    [
        ("23:59:50", "00:00:10", 20.0),  # or of two hosts the one that is told a moment later would start alone
        ("00:00:05", "23:59:58", -7.0),  # has passed, and is no start in a day
        ("23:59:50", "23:59:55", 5.0),
        ("00:00:05", "00:00:20", 15.0),
        ("23:00:01", "00:00:00", 3599.0),
        ("23:00:00", "00:00:00", -82800.0),
        ("14:00:00", "01:00:00", -46800.0),
        ("01:00:00", "23:00:00", 79200.0),
    ],
)
def test_a_time_around_midnight_is_of_the_day_that_is_near(now: str, at: str, ahead_s: float) -> None:
    there = datetime.combine(date(2026, 11, 30), time.fromisoformat(now), UTC)
    assert (on_its_day(time.fromisoformat(at), there) - there).total_seconds() == ahead_s


def test_a_start_on_the_other_side_of_midnight_is_given(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Late(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Late:
            return cls(2199, 12, 31, 23, 59, 50, tzinfo=tz)

    monkeypatch.setattr(words, "datetime", Late)
    cell = load_cell(PAPER)
    arms = [Arm(home / f"{name}.control", Mode.READY, cell.fingerprint) for name in ("left", "right")]
    with serving(arms):
        said = start_arms(cell, "00:00:10", None, [], Here(GOOD), print)
    assert said == "2 arms start at 00:00:10.000000 UTC"
    assert [arm.heard for arm in arms] == [(True, [])] * 2
