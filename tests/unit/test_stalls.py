"""What excuses a test in real time: the kernel's word about the machine, and nothing that the software does."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.safety import Flag
from tests.support.stalls import (
    ATTEMPTS,
    MISSED,
    PAUSE,
    PERIOD_NS,
    Kernel,
    Stalled,
    _ran_and_waited_ns,
    crowded,
    despite_stalls,
    slow_rows,
    stalled_rows,
)


@pytest.mark.parametrize("stalls", [0, 1, ATTEMPTS])
def test_a_test_is_made_again_in_another_folder_and_skipped_when_it_is_always_stalled(
    tmp_path: Path, stalls: int
) -> None:
    folders: list[Path] = []

    @despite_stalls
    def attempt(folder: Path) -> None:
        assert list(folder.iterdir()) == []
        folders.append(folder)
        if len(folders) <= stalls:
            raise Stalled("it was late")

    if stalls == ATTEMPTS:
        with pytest.raises(pytest.skip.Exception, match=r"stalled in each of 3 runs: it was late; it was late; it was"):
            attempt(tmp_path)
    else:
        attempt(tmp_path)
    assert len(set(folders)) == min(stalls + 1, ATTEMPTS)


def test_a_failure_without_an_excuse_is_one_at_once(tmp_path: Path) -> None:
    tried: list[Path] = []

    @despite_stalls
    def fails(folder: Path) -> None:
        tried.append(folder)
        assert not tried, "a defect"

    with pytest.raises((AssertionError, pytest.skip.Exception)) as raised:
        fails(tmp_path)
    assert raised.type is AssertionError
    assert len(tried) == 1


@pytest.mark.parametrize(
    ("ran", "waited", "somebody", "stolen", "own", "any_of_them"),
    [
        (1.0, 0.2, 0.5, 0.0, "", ""),
        (1.0, 0.5, 0.5, 0.0, "waited 0.5 s for a core and had one for 1.0 s", ""),
        (1.0, 0.2, 9.5, 0.0, "", "in 9.5 s of 10.0 s somebody waited for a core"),
        (1.0, 0.2, 0.5, 0.3, "took 0.3 s of 10.0 s", "took 0.3 s of 10.0 s"),
    ],
)
def test_a_process_is_excused_when_it_had_no_core(
    monkeypatch: pytest.MonkeyPatch,
    ran: float,
    waited: float,
    somebody: float,
    stolen: float,
    own: str,
    any_of_them: str,
) -> None:
    place = "tests.support.stalls."
    now = [100.0, 7.0, 3.0]  # passed, somebody waited, taken by the host
    monkeypatch.setattr(f"{place}time.monotonic", lambda: now[0])
    monkeypatch.setattr(f"{place}_somebody_waited_s", lambda: now[1])
    monkeypatch.setattr(f"{place}_stolen_s", lambda: now[2])
    monkeypatch.setattr(f"{place}_ran_and_waited_ns", lambda _: (int(ran * 1e9), int(waited * 1e9)))
    kernel = Kernel()
    now[:] = [110.0, 7.0 + somebody, 3.0 + stolen]
    for said, wanted in ((kernel.accuses(1), own), (kernel.accuses(), any_of_them)):
        assert wanted in said
        assert bool(said) == bool(wanted)
    with pytest.raises(Stalled if own else AssertionError), kernel.heard(1):
        raise AssertionError


@pytest.mark.parametrize(("load", "said"), [(7.9, ""), (8.2, "4.1 processes want each core")])
def test_a_machine_is_crowded_by_the_processes_for_each_core(
    monkeypatch: pytest.MonkeyPatch, load: float, said: str
) -> None:
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert crowded() == said


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="this kernel does not say who waits for a core")
def test_the_kernel_is_asked_about_the_threads_of_a_process() -> None:
    ran, waited = _ran_and_waited_ns(os.getpid())
    assert ran > 0 <= waited


def cycles(*at: float, late_s: float = 0.0) -> NDArray[np.void]:
    """Rows of an arm with a state in these periods."""
    rows = np.zeros(len(at), [("stamp_ns", "i8"), ("t", "f8"), ("late_s", "f8"), ("flags", "i8")])
    rows["stamp_ns"], rows["t"], rows["late_s"] = np.array(at) * PERIOD_NS, np.array(at) * PERIOD_NS * 1e-9, late_s
    return rows


def test_rows_tell_what_the_machine_did_and_excuse_nothing_else() -> None:
    good = np.arange(400.0)
    assert stalled_rows({"left": cycles(*good), "right": cycles(*good)}) == ""
    assert stalled_rows({"left": cycles(*good), "right": cycles(*good, late_s=0.011)}) == "right: a cycle 11 ms late"
    silent = cycles(*good)
    silent["flags"][[100, 101, 103]] = Flag.STALE.value
    assert stalled_rows({"left": silent}) == ""
    silent["flags"][102] = Flag.STALE.value
    assert stalled_rows({"left": silent}) == "left: three cycles in a row without a reply"
    assert stalled_rows({"left": silent}, before_s=0.51) == ""


def test_an_arm_of_which_every_other_cycle_is_left_out_is_on_a_slow_machine_and_one_that_paused_is_not() -> None:
    slow = [*range(200), *range(201, 201 + 2 * (MISSED + 1), 2)]
    assert slow_rows({"left": cycles(*slow)}) == f"left: {MISSED + 1} cycles beside 100 without a state"
    assert slow_rows({"left": cycles(*slow[:-1])}) == ""
    paused = [*range(200), *range(199 + PAUSE, 240), *range(239 + PAUSE, 400)]
    assert slow_rows({"left": cycles(*paused)}) == ""
