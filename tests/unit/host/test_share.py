"""Which cores the parts of a run keep to, and what one memory layout leaves behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from agent.host.share import cores_of_run, keep_to, one_memory_layout

ADDR_NO_RANDOMIZE = 0x0040000


FOUR_CORES = {3, 5, 7, 9}


@pytest.mark.parametrize(
    ("arms", "allowed", "turn", "plant", "each", "rest"),
    [
        (2, {0}, 0, {0}, [{0}, {0}], {0}),
        (2, {0, 1}, 0, {0}, [{0}, {0}], {1}),
        (2, {0, 1}, 7, {1}, [{1}, {1}], {0}),
        (3, FOUR_CORES, 6, {7}, [{7}, {7}, {7}], {3, 5, 9}),
        (1, {4, 6}, 0, {4}, [{4}], {6}),
        (4, {0, 1}, 1, {0, 1}, [{0}, {1}, {0}, {1}], {0, 1}),
        (4, FOUR_CORES, 1, FOUR_CORES, [{3}, {5}, {7}, {9}], FOUR_CORES),
    ],
)
def test_up_to_three_arms_share_a_core_with_the_plant_and_more_take_one_each(
    arms: int, allowed: set[int], turn: int, plant: set[int], each: list[set[int]], rest: set[int]
) -> None:
    assert cores_of_run(arms, allowed, turn) == (plant, tuple(each), rest)


def test_every_thread_of_a_process_is_kept_and_one_that_ended_is_nobody() -> None:
    core = frozenset(sorted(os.sched_getaffinity(0))[:1])
    code = "import threading, time; threading.Thread(target=time.sleep, args=(60,)).start(); print(flush=True)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout is not None
            child.stdout.readline()
            keep_to(child.pid, core)
            threads = [int(thread.name) for thread in Path(f"/proc/{child.pid}/task").iterdir()]
            assert len(threads) == 2
            assert [os.sched_getaffinity(thread) for thread in threads] == [core, core]
        finally:
            child.kill()
    keep_to(child.pid, core)


def personality() -> int:
    return int(Path("/proc/self/personality").read_text(), 16)


def of_a_child() -> int:
    code = "import pathlib; print(pathlib.Path('/proc/self/personality').read_text())"
    return int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout, 16)


def test_one_memory_layout_is_for_what_is_started_within() -> None:
    before = personality()
    with one_memory_layout():
        if not personality() & ADDR_NO_RANDOMIZE:
            pytest.skip("this host does not let a process choose its memory layout")
        assert of_a_child() & ADDR_NO_RANDOMIZE
    assert personality() == before
    assert not of_a_child() & ADDR_NO_RANDOMIZE


def test_the_layout_is_given_back_after_an_error() -> None:
    before = personality()
    with pytest.raises(RuntimeError, match="inside"), one_memory_layout():
        raise RuntimeError("inside")
    assert personality() == before
