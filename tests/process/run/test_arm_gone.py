"""P8 with real processes: agent and guard of one arm are killed, the other arms hold, and the log shows it.

Servos are emulated and answer on pseudo terminals; each arm has a guard, an agent and telemetry, as services run them.
How soon is printed (`pytest -rP`), not asserted: the list of faults bounds it in virtual time.
"""

from __future__ import annotations

import os
import resource
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import configs
from agent.config.cell import Cell, load_cell
from agent.doctor.host import fifo_granted
from agent.faults.catalogue import Shown, row
from agent.host.ready_line import READY, values_of
from agent.log.columns import Table
from agent.log.read import RunLog, read_log
from agent.modes import Mode, mode_name
from agent.report.series import grasp_wrenches, internal_wrenches
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from tests.soak.watch import say
from tests.support.command import coop
from tests.support.coop import COOP
from tests.support.stalls import Stalled, despite_stalls, stalled, stalled_rows

pytestmark = [pytest.mark.realtime, pytest.mark.long]  # in virtual time: `coop faults inject CELL P8`

PATIENCE_S = 120.0
LOOK_S = 2.0  # behind the fault
GUARD, AGENT = 81, 80  # real-time priorities, as of the services
SERVOS = 90  # emulated ones need a core when real ones do not
NS = 1e-9


class Host:
    """Processes of one cell on this host; all of them end with the test."""

    def __init__(self, cell: Cell, file: Path, folder: Path) -> None:
        self.cell, self.file, self.folder = cell, file, folder
        self.environment = os.environ | {"XDG_RUNTIME_DIR": str(folder)}
        self.words = (folder / "words").open("a")
        self.log = folder / "run.mcap"
        self.processes: list[subprocess.Popen[str]] = []
        self.real_time = fifo_granted()

    def start(self, command: str, *arguments: str | Path) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            (*COOP, command, str(self.file), *map(str, arguments)), cwd=self.folder, env=self.environment, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=self.words,
        )  # fmt: skip
        self.processes.append(process)
        if command in ("guard", "agent"):  # as their units have it: a real-time thread that does not sleep is ended
            resource.prlimit(process.pid, resource.RLIMIT_RTTIME, (50_000, 100_000))
        return process

    def said(self, process: subprocess.Popen[str]) -> dict[str, str]:
        """What a process says when it is ready."""
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith(READY), f"{line}\n{(self.folder / 'words').read_text()}"
        return values_of(line)

    def of(self, arm: str, suffix: str) -> Path:
        return self.folder / f"{arm}.{suffix}"

    def arm(self, command: str, arm: str, priority: int, *more: str | Path) -> subprocess.Popen[str]:
        """The guard or the agent of an arm."""
        port = ("--port", self.folder / "ports" / arm, "--driver", "dynamixel", "--emulated")
        pace = ("--priority", str(priority)) if self.real_time else ()
        return self.start(command, "--arm", arm, *port, "--control", self.of(arm, "control"), *pace, *more)

    @property
    def controls(self) -> list[str | Path]:
        return [word for arm in self.cell.arms for word in ("--control", self.of(arm.name, "control"))]

    def rows(self, arm: str, last: int | None = None) -> NDArray[np.void]:
        """All rows of an arm, or the last ones."""
        with RingReader(self.of(arm, "ring"), AGENT_STATE) as reader:
            count = reader.written if last is None else last
            return np.frombuffer(reader.read_at(reader.written - count, count).payload, AGENT_STATE.dtype)

    def motion_s(self, arm: str) -> float:
        """Since the common start; negative before it.  An arm that holds by itself fails the test."""
        last = self.rows(arm, last=1)[-1]
        assert last["mode"] in (Mode.READY, Mode.TRACK), f"{arm} is in {mode_name(last['mode'])} before anybody died"
        return float(last["t"]) if last["mode"] == Mode.TRACK else -1.0

    def stalled(self) -> str:
        """Why this machine is too slow for the cell; empty where it is not."""
        return stalled_rows(
            {arm.name: self.rows(arm.name) for arm in self.cell.arms if self.of(arm.name, "ring").exists()}
        )

    def wait(self, what: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < deadline, (self.folder / "words").read_text()
            time.sleep(0.01)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()
        self.words.close()


@dataclass(frozen=True)
class Running:
    """What was started, guards and agents by arm."""

    guards: Mapping[str, subprocess.Popen[str]]
    agents: Mapping[str, subprocess.Popen[str]]
    telemetry: Sequence[subprocess.Popen[str]]
    emulator: subprocess.Popen[str]
    recorder: subprocess.Popen[str]


def shown(cell: str) -> Shown:
    p8 = row("P8")
    assert p8 is not None
    (found,) = (run for run in p8.runs if run.cell == cell)
    return found


@pytest.mark.fault("P8")
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["paper_real", "two_wx200", "three_wx250s", "four_wx250s"])
def test_the_others_hold_the_object_of_an_arm_whose_agent_and_guard_are_killed(name: str, tmp_path: Path) -> None:
    despite_stalls(lambda folder: in_folder(name, folder))(tmp_path)


def in_folder(name: str, folder: Path) -> None:
    file = configs.CELLS_DIR / f"{name}.toml"
    host = Host(load_cell(file), file, folder)
    try:
        running = started(host)
        try:
            killed_ns = killed(host, running)
        except AssertionError as error:
            if why := host.stalled():
                raise Stalled(why) from error
            raise
        ended(running)
        judge(host, killed_ns)
    finally:
        host.close()


def started(host: Host) -> Running:
    """All processes of the cell, whose arms are ready."""
    arms = [arm.name for arm in host.cell.arms]
    emulator = host.start("emulate", "--ports", host.folder / "ports", "--ring", host.of("plant", "ring"))
    recorder = host.start(
        "record", "--out", host.log, "--listen", "tcp/127.0.0.1:0", "--driver", "dynamixel", "--truth"
    )
    endpoint = host.said(recorder)["endpoint"]
    host.said(emulator)
    if host.real_time:
        os.sched_setscheduler(emulator.pid, os.SCHED_FIFO, os.sched_param(SERVOS))
    guards = {
        arm: host.arm("guard", arm, GUARD, "--socket", host.of(arm, "guard"), "--post-mortem", host.folder)
        for arm in arms
    }
    for guard in guards.values():
        host.said(guard)
    agents = {
        arm: host.arm("agent", arm, AGENT, "--guard", host.of(arm, "guard"), "--ring", host.of(arm, "ring"))
        for arm in arms
    }
    telemetry = [
        host.start("telemetry", "--member", member, "--ring", host.of(member, "ring"), "--connect", endpoint)
        for member in (*arms, "plant")
    ]
    for agent in agents.values():
        host.said(agent)
        host.said(agent)  # with its port
    return Running(guards, agents, telemetry, emulator, recorder)


def killed(host: Host, running: Running) -> int:
    """The moment, UTC in ns, at which agent and guard of the first arm were killed; the others have held since."""
    begun = coop("start", host.file, "--in", 1.5, *host.controls, cwd=host.folder)
    assert begun.code == 0, begun.err
    dies, *others = running.agents
    (fault,) = shown(host.file.stem).faults
    host.wait(lambda: host.motion_s(dies) >= fault.at_s)
    killed_ns = time.time_ns()
    running.guards[dies].kill()
    running.agents[dies].kill()
    time.sleep(LOOK_S)
    released = coop("release", host.file, *host.controls, cwd=host.folder)
    assert dies in released.err, "who did not answer is named"
    for arm in others:
        assert running.agents[arm].wait(PATIENCE_S) == 0, (host.folder / "words").read_text()
    return killed_ns


def ended(running: Running) -> None:
    """The log is whole."""
    running.emulator.terminate()
    for process in (running.emulator, *running.telemetry):
        process.wait(PATIENCE_S)
    running.recorder.terminate()
    running.recorder.wait(PATIENCE_S)


def judge(host: Host, killed_ns: int) -> None:
    """What the log shows, by the bounds that the list has for this cell."""
    within, log = shown(host.file.stem).within, read_log(host.log)
    dies, *others = (arm.name for arm in host.cell.arms)
    if why := stalled(log, float(log.agents[dies]["t"][-1]) - 0.1):
        raise Stalled(why)
    assert log.agents[dies]["mode"][-1] == Mode.TRACK, "it was killed in its motion"
    held_ns = []
    for arm in others:
        rows = log.agents[arm]
        first = np.flatnonzero(rows["mode"] == Mode.HOLD)[0]
        assert rows["utc_ns"][first] > killed_ns, "nobody held before"
        looked = rows["utc_ns"] < killed_ns + int(LOOK_S / NS)
        assert set(rows["mode"][first:][looked[first:]].tolist()) == {Mode.HOLD}, "and nobody left the hold"
        held_ns.append(int(rows["utc_ns"][first]))
    before_N, after_N, sag_m = forces_and_sag(host.cell, log, killed_ns, min(held_ns))
    times = ", ".join(f"{arm} {(at - killed_ns) * 1e-6:.0f}" for arm, at in zip(others, held_ns, strict=True))
    grown_N, sag_mm = after_N - before_N, sag_m * 1e3
    say(f"{host.file.stem}: held after {times} ms; {before_N:.2f} N and {grown_N:.2f} N more; sag {sag_mm:.1f} mm")
    assert within.sag_m is not None
    assert within.grown_N is not None
    assert sag_m <= within.sag_m
    assert grown_N <= within.grown_N


def forces_and_sag(cell: Cell, log: RunLog, killed_ns: int, held_ns: int) -> tuple[float, float, float]:
    """Largest internal force in the motion until then and behind it, N; fall below the way, and below the hold, m."""
    plant = log.plant
    assert plant is not None
    dies = log.agents[cell.arms[0].name]
    follows = dies[dies["mode"] == Mode.TRACK]
    zero_ns = int(follows["utc_ns"][-1]) - round(float(follows["t"][-1]) / NS)
    plant = plant[plant["utc_ns"].astype(np.int64) < killed_ns + int(LOOK_S / NS)]
    at_ns = plant["utc_ns"].astype(np.int64)
    internal = internal_wrenches(grasp_wrenches(Table.of(plant), len(cell.arms)), plant["quat_object"], None)
    force = np.linalg.norm(internal[:, :, :3], axis=2).max(axis=1)
    up = -cell.gravity / np.linalg.norm(cell.gravity)
    height, trajectory = plant["p_object"] @ up, cell.trajectory()
    at_hold = float(np.interp(held_ns, at_ns, height))
    wanted = [at_hold if at >= held_ns else float(trajectory.at(max((at - zero_ns) * NS, 0.0)).p @ up) for at in at_ns]
    after = at_ns >= killed_ns
    moves = ~after & (at_ns >= zero_ns)
    return float(force[moves].max()), float(force[after].max()), float((np.array(wanted) - height)[after].max())
