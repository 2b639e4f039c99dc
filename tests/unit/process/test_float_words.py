"""What an arm that moves while others float is told: a common start and a stop, while it may be told anything."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent.modes import Mode
from agent.operator.message import Request
from agent.operator.table import Verb
from agent.process import float_words
from agent.process.float_words import Words
from drivers.clock import MonotonicClock, utc_offset_ns

CELL: Any = SimpleNamespace(fingerprint="ab" * 32)
IN_NS = 5_000_000_000


class Arm:
    """Words of one arm on a socket of its own."""

    def __init__(self, path: Path, *, emulated: bool = True, accepts_late: bool = False) -> None:
        self.path, self.said = path, list[str]()
        options: Any = SimpleNamespace(arm="right", allow_no_realtime=accepts_late, emulated=emulated)
        tell: Any = SimpleNamespace(event=lambda _, text, **__: self.said.append(text))
        self.signals: Any = SimpleNamespace(stopped=False, released=False, stops=0)
        self.words = Words(path, CELL, options, self.signals, MonotonicClock(), tell)

    def told(self, verb: Verb, **more: Any) -> tuple[bool, bool, str]:
        """Whether it takes the word, whether it is to stop then, and why it refuses; of a start it is asked first."""
        if verb is Verb.START:
            more |= {"token": "mine", "asked_ns": time.monotonic_ns()}
            asked = self._told(verb, prepare=True, **more)
            if not asked[0]:
                return asked
        return self._told(verb, **more)

    def _told(self, verb: Verb, **more: Any) -> tuple[bool, bool, str]:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as person:
            person.settimeout(5.0)
            person.connect(str(self.path))
            person.send(Request(verb, CELL.fingerprint, **more).encode())
            stops = self.words.stops()
            answer = json.loads(person.recv(4096))
        return answer["ok"], stops, answer.get("found", "")


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Arm]:
    made = Arm(tmp_path / "right.control")
    with closing(made.words):
        yield made
    assert not made.path.exists()


def test_a_start_is_taken_once_it_has_torque_and_maps_to_its_clock(arm: Arm) -> None:
    start_ns = time.time_ns() + IN_NS
    assert arm.told(Verb.START, start_utc_ns=start_ns)[0] is False, "its torque is off"
    assert arm.words.start_ns() is None
    arm.words.ready()
    assert arm.told(Verb.START, start_utc_ns=start_ns) == (True, False, "")
    found = arm.words.start_ns()
    assert found == pytest.approx(start_ns - utc_offset_ns(), abs=50e6)


def test_it_stops_by_word_and_by_signal_and_a_release_does_nothing(arm: Arm) -> None:
    arm.words.ready()
    assert not arm.words.stops()
    arm.words.entered(Mode.TRACK)
    assert arm.told(Verb.RELEASE)[:2] == (False, False)
    assert arm.told(Verb.STOP)[:2] == (True, True)
    other = Arm(arm.path.with_name("other.control"))
    with closing(other.words):
        other.signals.stopped = True
        assert other.words.stops()


def test_it_listens_no_more_once_it_stands(arm: Arm) -> None:
    arm.words.ready()
    arm.words.entered(Mode.TRACK)
    assert arm.path.is_socket()
    arm.words.entered(Mode.STAND)
    assert not arm.path.exists()


@pytest.mark.parametrize(
    ("real", "accepts_late", "refused"),
    [(False, False, "SCHED_OTHER"), (False, True, "after READY"), (True, False, "after READY")],
)
def test_a_real_arm_is_started_with_real_time_and_after_its_torque_at_rest_was_looked_at(
    real: bool, accepts_late: bool, refused: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: Any = SimpleNamespace(real=real, text="SCHED_OTHER")
    monkeypatch.setattr(float_words, "granted", lambda: found)
    arm = Arm(tmp_path / "right.control", emulated=False, accepts_late=accepts_late)
    with closing(arm.words):
        arm.words.ready()
        taken, _, why = arm.told(Verb.START, start_utc_ns=time.time_ns() + IN_NS // 10)
        assert not taken
        assert refused in why
        if refused == "after READY":
            assert arm.told(Verb.START, start_utc_ns=time.time_ns() + IN_NS)[0]
