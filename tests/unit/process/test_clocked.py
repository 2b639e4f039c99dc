"""C4: a clock that nobody corrects any more drifts, and an arm that shares time with other hosts holds in time."""

from __future__ import annotations

import ctypes
import math
import struct
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.config.cell import load_cell
from agent.host import clock as host_clock
from agent.host.clock import UNKNOWN, ClockState, from_tracking, read_clock, read_file, read_kernel
from agent.process import clocked
from agent.process.clocked import ClockWatch, read_here, shares_time
from tests.support.runner_rig import paper

LOST = ClockState(synchronised=False, max_error_s=0.0)
SECOND_NS = 1_000_000_000


@dataclass
class Rig:
    """A clock watch that looks once in two cycles, in a time that the test moves."""

    state: ClockState = LOST
    ns: int = 0
    held: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.watch = ClockWatch(lambda: self.ns, self.held.append, 2, lambda: self.state)

    def run(self, seconds: int) -> None:
        for _ in range(seconds):
            self.ns += SECOND_NS
            self.watch.beat()
            self.watch.beat()


@pytest.mark.fault("C4")
def test_without_correction_the_bound_grows_by_100_ppm_and_the_arm_holds_above_5_ms() -> None:
    rig = Rig()
    rig.watch.given(1e-3)
    rig.run(39)
    assert rig.watch.bound_s == pytest.approx(4.9e-3)
    assert rig.held == []
    rig.run(2)
    assert rig.held == ["the clock may be off by 5.1 ms, 5 ms are allowed"]


def test_a_start_by_somebody_who_knows_the_time_less_well_takes_nothing_away() -> None:
    rig = Rig()
    rig.watch.given(1e-3)
    rig.run(10)
    rig.watch.given(3e-3)
    assert rig.watch.bound_s == pytest.approx(2e-3)
    rig.watch.given(5e-4)
    assert rig.watch.bound_s == pytest.approx(5e-4)


def test_a_clock_that_is_corrected_stays_known() -> None:
    rig = Rig(ClockState(synchronised=True, max_error_s=8e-4))
    rig.watch.given(1e-3)
    rig.run(600)
    assert rig.watch.bound_s == 8e-4
    rig.state = ClockState(synchronised=True, max_error_s=0.5)  # a bad answer is no worse than the drift since the last
    rig.run(10)
    assert rig.watch.bound_s == pytest.approx(1.8e-3)
    assert rig.held == []


def test_before_a_start_and_after_one_by_somebody_who_has_not_looked_nothing_is_held() -> None:
    rig = Rig()
    rig.run(100)
    rig.watch.given(None)
    rig.run(100)
    assert (rig.watch.bound_s, rig.held) == (math.inf, [])


def test_only_arms_on_several_hosts_share_time() -> None:
    here = load_cell(configs.CELLS_DIR / "paper.toml", ["arms.left.host=one"])
    assert shares_time(here, here.arm("left"))
    assert not shares_time(paper(), paper().arm("left"))


def test_a_file_tells_while_it_is_fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """C1."""
    file = tmp_path / "clock.json"
    good = ClockState(synchronised=True, max_error_s=3e-4)
    now_ns = 10 * SECOND_NS
    monkeypatch.setattr(host_clock.time, "time_ns", lambda: now_ns)
    file.write_bytes(good.encode(now_ns - 5 * SECOND_NS))
    assert read_clock(file) == good
    for odd in (good.encode(now_ns - 5 * SECOND_NS - 1), good.encode(now_ns + 6 * SECOND_NS), UNKNOWN.encode(now_ns)):
        file.write_bytes(odd)
        assert read_file(file) == UNKNOWN
    negative, huge = (good.encode(now_ns).replace(b"0.0003", text) for text in (b"-1", b"1" + 400 * b"0"))
    endless = good.encode(now_ns).replace(str(now_ns).encode(), b"Infinity")
    for odd in (b"", b"{}", b"[]", negative, huge, endless, 100_000 * b"[", b"\xff"):
        file.write_bytes(odd)
        assert read_file(file) == UNKNOWN
    assert read_file(tmp_path / "none") == UNKNOWN


def test_an_agent_asks_the_file_and_where_that_does_not_know_the_kernel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, kernel = ClockState(synchronised=True, max_error_s=3e-4), ClockState(synchronised=True, max_error_s=2e-3)
    monkeypatch.setattr(clocked, "read_kernel", lambda: kernel)
    monkeypatch.setattr(clocked, "STATE_FILE", tmp_path / "clock.json")
    assert read_here() == kernel, "there is no file"
    for state, found in ((told, told), (replace(told, synchronised=False), kernel)):
        clocked.STATE_FILE.write_bytes(state.encode(time.time_ns()))
        assert read_here() == found


class Kernel:
    """Answers adjtimex as Linux does: the state is the result, the structure filled in."""

    def __init__(self, result: int, status: int, maxerror_us: int) -> None:
        self._result, self._filled = result, (status, maxerror_us)

    def adjtimex(self, reference: Any) -> int:
        asked = bytearray(reference._obj)
        assert not any(asked), "it sets nothing"
        # modes (and 4 bytes for nothing), offset, freq, maxerror, esterror, status: adjtimex(2), of 64 bits
        status, maxerror_us = self._filled
        struct.pack_into("=i4xqqqqi", asked, 0, 0, -7, 3, maxerror_us, 9, status)
        ctypes.memmove(reference, bytes(asked), len(asked))
        return self._result


@pytest.mark.parametrize(
    ("result", "status", "maxerror_us", "expected"),
    [
        (0, 0x2001, 1500, ClockState(synchronised=True, max_error_s=1.5e-3)),
        (4, 0x2001, 0, ClockState(synchronised=True, max_error_s=0.0)),
        (5, 0x0040, 16_000_000, ClockState(synchronised=False, max_error_s=16.0)),
        (5, 0x2041, 700, ClockState(synchronised=False, max_error_s=7e-4)),
        (-1, 0x2001, 1500, UNKNOWN),
    ],
)
def test_the_kernels_bound_is_its_largest_error_in_microseconds_unless_it_says_unsynchronised(
    monkeypatch: pytest.MonkeyPatch, result: int, status: int, maxerror_us: int, expected: ClockState
) -> None:
    monkeypatch.setattr(host_clock.ctypes, "CDLL", lambda *_, **__: Kernel(result, status, maxerror_us))
    found = read_kernel()
    assert found.synchronised is expected.synchronised
    assert found.max_error_s == pytest.approx(expected.max_error_s)


TRACKING = "C0A80001,192.168.0.1,3,1700000000.1,-0.000100,0.00002,0.0001,-9.9,0.001,0.05,0.000600,0.000200,64.2,"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (TRACKING + "Normal\n", ClockState(True, 6e-4)),
        (TRACKING + "Not synchronised\n", ClockState(False, 6e-4)),
        ("506 Cannot talk to daemon\n", None),
        (TRACKING.replace("0.000600", "soon") + "Normal", None),
    ],
)
def test_chronys_bound_is_offset_dispersion_and_half_the_delay(line: str, expected: ClockState | None) -> None:
    found = from_tracking(line)
    if expected is None:
        assert found is None
    else:
        assert found is not None
        assert found.synchronised is expected.synchronised
        assert found.max_error_s == pytest.approx(expected.max_error_s)


def test_chrony_is_asked_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "chronyc"
    program.write_text(f"#!/bin/sh\n[ \"$*\" = '-n -c tracking' ] && echo '{TRACKING}Normal'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    assert read_clock().max_error_s == pytest.approx(6e-4)
    kernel = ClockState(synchronised=True, max_error_s=2e-3)
    monkeypatch.setattr(host_clock, "read_kernel", lambda: kernel)
    program.write_text(f"#!/bin/sh\necho '{TRACKING}Normal'; exit 1\n")
    assert read_clock() == kernel
    monkeypatch.setenv("PATH", str(tmp_path / "without"))
    assert read_clock() == kernel
