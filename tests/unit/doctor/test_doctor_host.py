"""The doctor on ports and hosts, and its verdict as a whole."""

from __future__ import annotations

import errno
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

import configs
from agent.config.cell import ConfigError, load_cell
from agent.doctor import host
from agent.doctor.doctor import Diagnosis, DoctorOptions, diagnose
from agent.doctor.port import before_opening, latency_timer
from agent.host.clock import ClockState
from agent.host.latency import Histogram, Latency
from agent.host.realtime import RealTime
from agent.verify.finding import Finding, Verdict, exit_code, worst
from drivers.dynamixel.arm_map import ArmMap
from sim_backend.wire.timing import BusTiming
from tests.support.servos.dxl_rig import build
from tests.support.servos.tool_rig import examined

TWO_WX200 = configs.CELLS_DIR / "two_wx200.toml"


def findings(diagnosis: Diagnosis, verdict: Verdict) -> list[Finding]:
    return [f for f in diagnosis.findings if f.verdict is verdict]


# --- ports -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def pty() -> Iterator[str]:
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


@contextmanager
def without_rights(path: str) -> Iterator[None]:
    """Nobody may open the port; root, who may open anything, becomes nobody meanwhile."""
    mode, root = Path(path).stat().st_mode, os.geteuid() == 0
    Path(path).chmod(0)
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
        Path(path).chmod(mode)


def one_problem(path: str) -> Finding:
    (finding,) = before_opening(path, "left")
    assert finding.verdict is Verdict.REFUSED
    return finding


def test_a_port_that_can_be_used_is_ok(pty: str) -> None:
    (finding,) = before_opening(pty, "left")
    assert finding.verdict is Verdict.OK
    assert f"group {Path(pty).group()}" in finding.found


def test_a_missing_port_lists_what_is_there() -> None:
    finding = one_problem("/dev/coop-not-there")
    assert (finding.found, finding.wanted) == ("nothing of that name", "a serial port")
    assert "ports here" in finding.remedy


def test_missing_rights_name_the_way_to_them(pty: str) -> None:
    with without_rights(pty):
        finding = one_problem(pty)
    assert "no permission" in finding.found
    assert "install the udev rule" in finding.remedy, "nobody has any there, its group neither"


def test_a_program_without_a_lock_is_named_as_the_user_of_the_port(pty: str) -> None:
    script = f"import os, sys; os.open({pty!r}, os.O_RDWR | os.O_NOCTTY); print('open', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "open\n"
        finding = one_problem(pty)
        other.communicate("")
    assert f"({other.pid})" in finding.found
    assert before_opening(pty, "left")[0].verdict is Verdict.OK


def test_a_name_that_moves_with_the_socket_is_a_warning(monkeypatch: pytest.MonkeyPatch, pty: str) -> None:
    monkeypatch.setattr("agent.doctor.port._SHIFTING", (pty,))
    assert [f.verdict for f in before_opening(pty, "left")] == [Verdict.OK, Verdict.WARNING]


@pytest.mark.parametrize(
    ("before_ms", "opened_ms", "verdict", "found"),
    [
        (None, None, Verdict.OK, "not an FTDI adapter"),
        (1, 1, Verdict.OK, "1 ms"),
        (16, 1, Verdict.WARNING, "16 ms until a program asks for 1 ms"),
        (16, 16, Verdict.REFUSED, "16 ms"),
    ],
)
def test_latency_timer_before_and_after_opening(before_ms, opened_ms, verdict: Verdict, found: str) -> None:
    finding = latency_timer(before_ms, opened_ms, "left")
    assert finding.verdict is verdict
    assert found in finding.found
    assert ("udev" in finding.remedy) == (verdict is not Verdict.OK)


# --- host ------------------------------------------------------------------------------------------------------------


def measured(late_s: float) -> Latency:
    """A latency test of a loaded host whose latest cycle was so late."""
    histogram = Histogram()
    histogram.add(late_s)
    return Latency(0, "6.12.1", 4, 300.0, 200.0, True, RealTime("SCHED_FIFO", 80, 1), histogram)


FIT = host.HostFacts(
    fifo=True, rtprio_limit=80, memlock_bytes=math.inf, governors=frozenset({"performance"}), preempt_rt=True,
    kernel="6.12.1", cores=4, clock=ClockState(True, 2e-4), log_folder=Path("/runs"),
    log_free_bytes=2**34, versions="all", latency=measured(2e-3),
)  # fmt: skip


def test_a_fit_host_has_nothing_but_ok() -> None:
    assert worst(host.judge(FIT, arms=2, log_bytes=1e8, rate_hz=200.0)) is Verdict.OK


@pytest.mark.parametrize(
    ("change", "what", "found", "verdict"),
    [
        ({"fifo": False, "rtprio_limit": 0}, "real-time priority", r"refused \(RLIMIT_RTPRIO 0\)", Verdict.WARNING),
        ({"memlock_bytes": 8 * 2.0**20}, "locked memory", "8 MB", Verdict.WARNING),
        ({"preempt_rt": False}, "kernel", r"6.12.1, not PREEMPT_RT", Verdict.WARNING),
        ({"governors": frozenset({"performance", "powersave"})}, "governor", "performance, powersave", Verdict.WARNING),
        ({"cores": 1}, "processor cores", "1", Verdict.WARNING),
        ({"clock": ClockState(False, 16.0)}, "clock", "not synchronised, error at most 16 s", Verdict.WARNING),
        ({"clock": ClockState(True, 5e-3)}, "clock", "synchronised, error at most 5 ms", Verdict.WARNING),
        ({"latency": None}, "wake-up latency", "not measured", Verdict.WARNING),
        ({"latency": measured(3e-3)}, "wake-up latency", r"unfit: late ≤ 3.00 ms, .* SCHED_FIFO 80", Verdict.WARNING),
        ({"log_free_bytes": 10}, "room for logs in /runs", r"0.00 GB", Verdict.REFUSED),
    ],
)
def test_each_shortcoming_of_a_host_is_one_line(change: dict, what: str, found: str, verdict: Verdict) -> None:
    (finding,) = (f for f in host.judge(replace(FIT, **change), 2, 1e8, 200.0) if f.verdict is not Verdict.OK)
    assert what in finding.what
    assert re.search(found, finding.found)
    assert finding.verdict is verdict
    assert finding.remedy


def test_a_machine_without_governors_is_not_blamed() -> None:
    assert worst(host.judge(replace(FIT, governors=frozenset()), 2, 1e8, 200.0)) is Verdict.OK


def test_reading_the_host_changes_nothing_of_it(tmp_path: Path) -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    facts = host.read_facts(tmp_path / "not" / "there", "v")
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before
    assert facts.log_folder == tmp_path
    assert not (tmp_path / "not").exists()
    assert facts.cores >= 1
    assert facts.log_free_bytes > 0
    assert facts.clock.max_error_s > 0.0


# --- the whole -------------------------------------------------------------------------------------------------------


def diagnosis_of(cell_overrides: list[str], *arms: str, ports: Path | None = None) -> Diagnosis:
    told: list[str] = []
    return diagnose(load_cell(TWO_WX200, cell_overrides), DoctorOptions(arms, ports), told.append)


def test_ports_that_are_not_there_are_problems_of_their_arms_alone(tmp_path: Path) -> None:
    diagnosis = diagnosis_of([], ports=tmp_path)
    wrong = findings(diagnosis, Verdict.REFUSED)
    assert [(f.where, f.what) for f in wrong] == [(a, f"port {tmp_path}/{a}") for a in ("left", "right")]
    assert diagnosis.exit_code == 2


def test_an_arm_of_a_session_is_looked_for_at_its_rest_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[ArmMap, ArmMap]] = []
    monkeypatch.setattr("agent.doctor.doctor.before_opening", lambda *_: [])
    monkeypatch.setattr(
        "agent.doctor.doctor.examine_line", lambda arm, _port, _clock, _out, started: asked.append((arm, started))
    )
    diagnosis_of([], "left", ports=tmp_path)
    diagnosis_of(["session.lift_m=0.02"], "left", ports=tmp_path)
    assert [[any(j.at_rest for j in arm.joints) for arm in maps] for maps in asked] == [[False, False], [True, False]]


def test_only_the_named_arm_is_looked_at(tmp_path: Path) -> None:
    assert {f.where for f in diagnosis_of([], "right", ports=tmp_path).findings} == {"host", "cell", "right"}
    with pytest.raises(ConfigError, match="found 'middle', expected left or right"):
        diagnosis_of([], "middle", ports=tmp_path)


def test_a_file_that_is_no_port_is_a_problem(tmp_path: Path) -> None:
    (tmp_path / "left").write_text("")
    (finding,) = findings(diagnosis_of([], "left", ports=tmp_path), Verdict.REFUSED)
    assert finding.found == "not a terminal device"


def test_what_the_check_of_the_cell_refuses_is_a_problem_of_the_cell(tmp_path: Path) -> None:
    diagnosis = diagnosis_of(["rate_hz=500"], "left", ports=tmp_path)
    assert {f.what for f in findings(diagnosis, Verdict.REFUSED) if f.where == "cell"} == {
        "rate on the servo bus (left)", "rate on the servo bus (right)",
    }  # fmt: skip
    unreachable = diagnosis_of(["object.p_start_m=[3.0, 0.0, 0.3]"], "left", ports=tmp_path)
    assert any("unreachable" in f.found for f in findings(unreachable, Verdict.REFUSED))


def test_exit_code_is_that_of_the_worst_line() -> None:
    ok, warning, problem = (Finding("w", "h", "f", "w", v, "r") for v in Verdict)
    assert [exit_code(f) for f in ((), (ok,), (ok, warning), (problem, warning, ok))] == [0, 0, 1, 2]


def test_json_has_every_line_and_the_figures() -> None:
    diagnosis = examined(build(timing=BusTiming()))
    document = diagnosis.document()
    assert (document["schema"], document["verdict"]) == (1, "ok")
    assert len(document["findings"]) == len(diagnosis.findings)
    assert set(document["findings"][0]) == {"what", "where", "found", "wanted", "verdict", "remedy"}
    cycle = document["cycles"]["left"]
    assert cycle["measured"]["reads"] == 200
    assert abs(cycle["measured"]["read_median_s"] / cycle["computed"]["read_mean_s"] - 1.0) < 0.15


def test_errno_of_a_directory_is_told(tmp_path: Path) -> None:
    assert os.strerror(errno.EISDIR) in one_problem(str(tmp_path)).found


def test_every_line_is_explained_in_the_documentation() -> None:
    page = (Path(__file__).parents[3] / "docs" / "doctor.md").read_text()
    lines = [*host.judge(FIT, 2, 1e8, 200.0), *examined(build(timing=BusTiming())).findings]
    for finding in lines:
        assert finding.what.removesuffix(f" in {FIT.log_folder}") in page, finding.what
