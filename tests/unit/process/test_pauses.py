"""A run that waits at instants: it tells of each, waits for a word that comes after that, and not against a stop."""

from __future__ import annotations

import threading

import pytest

from agent.process.pauses import WAITS, PauseError, Pauses, instants_of


class Person:
    """Who answers: with a release to each of the first `answers` pauses, then with a stop."""

    def __init__(self, answers: int) -> None:
        self.released = True  # of before: it counts for nothing
        self.stopped = False
        self.told: list[str] = []
        self._answers = answers

    def tell(self, text: str) -> None:
        assert not self.released, "an earlier release would end this pause"
        self.told.append(text)
        threading.Timer(0.01, self._answer).start()

    def _answer(self) -> None:
        if len(self.told) <= self._answers:
            self.released = True
        else:
            self.stopped = True

    def __call__(self) -> bool:
        return self.stopped


def test_it_waits_once_at_each_instant_and_not_before() -> None:
    person = Person(answers=3)
    pauses = Pauses((0.1, 0.1, 2.5), person.tell, person)
    for t_ns, told in ((-4_000_000_000, 0), (99_999_999, 0), (100_000_000, 2), (2_480_000_000, 2), (2_500_000_000, 3)):
        pauses.reached(t_ns)
        assert person.told == [WAITS] * told, t_ns
    pauses.reached(9_000_000_000)
    assert len(person.told) == 3
    assert person.released
    assert not person.stopped


def test_a_stop_ends_the_wait() -> None:
    person = Person(answers=0)
    Pauses((0.0,), person.tell, person).reached(0)
    assert person.told == [WAITS]
    assert not person.released
    assert person.stopped


def test_an_instant_that_seconds_cannot_say_is_not_passed_by() -> None:
    person = Person(answers=1)
    Pauses((1.1,), person.tell, person).reached(round(5.1e9) - 4_000_000_000)  # 5.1 - 4.0 < 1.1
    assert person.told


@pytest.mark.parametrize("text", ["", "soon", "1.0,", "2.0,1.0", "nan", "inf"])
def test_what_are_no_instants_is_refused(text: str) -> None:
    with pytest.raises(PauseError, match=r"--pauses: found .*rising; write 1\.0,2\.5"):
        instants_of(text, lockstep=True)


def test_only_simulated_time_waits() -> None:
    assert instants_of("1.0,2.5,2.5", lockstep=True) == (1.0, 2.5, 2.5)
    with pytest.raises(PauseError, match="at the pace of the wall clock"):
        instants_of("1.0", lockstep=False)
