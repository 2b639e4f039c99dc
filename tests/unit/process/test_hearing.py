"""Where words to a guard's hold are heard: not beside the dead agent's socket, and again where somebody else has it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from agent.host.process_handle import ProcessHandle
from agent.operator.error import ControlError
from agent.operator.socket import ControlSocket, Standing
from agent.process import hearing
from agent.process.hearing import AGAIN_S, FIRST_CYCLES, Hearing
from agent.process.tellers import Teller
from agent.telemetry.row.event import Level
from drivers.dynamixel.arm_map import WATCHDOG_S

FINGERPRINT = "0123456789abcdef"
RATE_HZ = 50.0
PERIOD = round(AGAIN_S * RATE_HZ)


class Bench:
    def __init__(self, folder: Path, stack: ExitStack, *, ended: bool, path: bool = True) -> None:
        self.path = folder / "left.control"
        self.told: list[tuple[Level, str]] = []
        self.agent = SimpleNamespace(ended=ended)
        tell: Any = SimpleNamespace(event=lambda level, text: self.told.append((level, text)))
        self.hearing = Hearing(
            self.path if path else None, FINGERPRINT, Standing("left"), cast(ProcessHandle, self.agent),
            cast(Teller, tell), stack, RATE_HZ,
        )  # fmt: skip

    def looks(self, cycles: int) -> list[int]:
        """In which of so many cycles words came to be heard."""
        return [cycle for cycle in range(cycles) if self.hearing.look() is not None]

    def served(self) -> ControlSocket:
        """By somebody else."""
        return ControlSocket(self.path, FINGERPRINT, Standing("left"))


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def test_words_are_heard_from_the_begin_where_the_agent_has_ended(tmp_path: Path, stack: ExitStack) -> None:
    bench = Bench(tmp_path, stack, ended=True)
    assert bench.hearing.begin() is not None
    assert bench.told == []
    stack.close()
    assert not bench.path.exists(), "closed with the hold"


@pytest.mark.fault("P1")
def test_an_agent_that_gives_its_memory_back_has_its_socket_until_then(tmp_path: Path, stack: ExitStack) -> None:
    """Nobody is told that no word is heard: it is a matter of some ten milliseconds."""
    bench = Bench(tmp_path, stack, ended=False)
    with closing(bench.served()):
        assert bench.hearing.begin() is None
        assert bench.looks(3 * PERIOD) == []
    bench.agent.ended = True
    assert bench.hearing.look() is not None
    assert bench.told == []


def test_where_somebody_begins_beside_it_a_hold_tries_again_in_each_of_its_first_cycles(
    tmp_path: Path, stack: ExitStack
) -> None:
    bench = Bench(tmp_path, stack, ended=False)
    assert bench.hearing.begin() is None
    bench.agent.ended = True
    with closing(bench.served()):
        assert bench.looks(FIRST_CYCLES - 1) == []
        assert bench.told == []
    assert bench.looks(1) == [0]
    assert bench.told == []


@pytest.mark.parametrize("ended", [True, False])
def test_a_hold_that_hears_no_words_says_so_once_tries_again_each_second_and_says_that_it_hears(
    tmp_path: Path, stack: ExitStack, ended: bool
) -> None:
    bench = Bench(tmp_path, stack, ended=ended)
    with closing(bench.served()):
        assert bench.hearing.begin() is None
        bench.agent.ended = True
        assert bench.looks(FIRST_CYCLES + 2 * PERIOD) == []
        ((level, text),) = bench.told
        assert level is Level.ERROR
        assert text.startswith("no word reaches this hold, SIGUSR1 to process ")
    assert len(bench.looks(PERIOD)) == 1
    assert bench.told[1:] == [(Level.INFO, "words reach this hold from here on")]


@pytest.mark.parametrize("ended", [True, False])
def test_a_hold_that_is_to_hear_no_words_makes_no_socket(tmp_path: Path, stack: ExitStack, ended: bool) -> None:
    bench = Bench(tmp_path, stack, ended=ended, path=False)
    assert bench.hearing.begin() is None
    assert bench.looks(2 * PERIOD) == []
    assert list(tmp_path.iterdir()) == []


def test_a_socket_is_waited_for_before_the_first_cycle_alone_and_tried_for_in_twenty_and_then_once_a_second(
    tmp_path: Path, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []

    def refused(*given: Any) -> None:
        waits.append(given[-1])
        raise ControlError("socket", found="a file", expected="none", remedy="remove it")

    monkeypatch.setattr(hearing, "ControlSocket", refused)
    bench = Bench(tmp_path, stack, ended=False)
    bench.agent.ended = True
    assert bench.looks(20) == []
    assert (waits, len(bench.told)) == ([0.0] * 20, 1)
    assert bench.looks(49) == []
    assert waits == [0.0] * 20
    assert bench.looks(51) == []
    assert (waits, len(bench.told)) == ([0.0] * 22, 1)
    waits.clear()
    late = Bench(tmp_path, stack, ended=True)
    assert late.hearing.begin() is None
    assert (waits, len(late.told)) == ([0.02], 1)
    assert waits[0] <= 0.1 * WATCHDOG_S, "the servos wait"
    assert late.looks(49) == []
    assert waits == [0.02]
