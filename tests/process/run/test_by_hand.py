"""The processes of a cell, one by one, on a host that nobody has prepared: they work, or say what they wait for."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

import configs
from agent.config.files import load_files
from agent.host.ready_line import values_of
from agent.log.read import read_log
from agent.modes import Mode
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.command import coop
from tests.support.documents import ROOT
from tests.support.loaded import Loaded
from tests.support.ports import free_port

PAPER = configs.CELLS_DIR / "paper.toml"
Process = subprocess.Popen[str] | Loaded
HEAVY = ("pinocchio", "scipy", "matplotlib")
SECONDS, ROWS = 0.5, 100
LONG_S = 300.0  # of a run that is to be stopped before its end

# the command itself, and at its end what it has loaded
PROGRAM = f"""
import atexit, sys
atexit.register(lambda: sys.stderr.write("loaded: " + " ".join(m for m in {HEAVY} if m in sys.modules)))
from agent.cli.main import main
main()
"""

SLOWLY = {  # gains for a loop that a machine full of others' work keeps up with
    "rate_hz": 60.0, "k_p_per_s": 40.6, "k_eps_rad_per_s": 30.0, "k_p_rate_per_s": 4.5, "k_eps_rate_rad_per_s": 5.0,
    "position_gain": 1.0, "velocity_gain": 1.0, "velocity_from_position_per_s": 7.93, "k_v_N_s_per_m": 0.923,
    "k_v_Nm_s_per_rad": 0.151,
}  # fmt: skip
JOINTS = tuple(load_files(PAPER).arms[0].entry.controlled)


class Host:
    """A host with the environment of the test; every process is ended on the way out."""

    def __init__(self, folder: Path, **environment: str) -> None:
        self.folder = folder
        self.runtime = environment.get("XDG_RUNTIME_DIR", "")
        self._environment = {k: v for k, v in os.environ.items() if k not in ("XDG_RUNTIME_DIR", "RUNTIME_DIRECTORY")}
        self._environment |= environment
        self._processes: list[Process] = []

    def start(self, *arguments: str) -> Loaded:
        process = Loaded(*arguments, cwd=self.folder, env=self._environment)
        self._processes.append(process)
        return process

    def start_anew(self, *arguments: str) -> subprocess.Popen[str]:
        """Which says at its end what it has loaded."""
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *arguments], cwd=self.folder, env=self._environment,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._processes.append(process)
        return process

    def share(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Words that this process says are said in that session, too."""
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        monkeypatch.setenv("XDG_RUNTIME_DIR", self.runtime)

    def close(self) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.kill()
            process.communicate()


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Host]:
    """A user's session: XDG_RUNTIME_DIR is there and empty."""
    (tmp_path / "session").mkdir()
    host = Host(tmp_path, XDG_RUNTIME_DIR=str(tmp_path / "session"))
    yield host
    host.close()


@pytest.fixture
def short_session(tmp_path: Path) -> Iterator[Host]:
    """The same in a folder whose name is as short as that of a real session: sockets' names have 107 characters."""
    with TemporaryDirectory(prefix="s") as folder:
        host = Host(tmp_path, XDG_RUNTIME_DIR=folder)
        yield host
        host.close()


def cell_named(name: str, folder: Path, duration_s: float = SECONDS) -> str:
    path = folder / "cell.toml"
    text = PAPER.read_text().replace('name = "paper"', f'name = "{name}"')
    path.write_text(text.replace("duration_s = 100.0", f"duration_s = {duration_s}"))
    return str(path)


def ready(process: Process) -> str:
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("READY "), process.communicate()
    return line


def ended(process: Process) -> str:
    """The words of a process that ends well."""
    _, words = process.communicate(timeout=90)
    assert process.returncode == 0, words
    return words


def test_a_run_by_hand_needs_no_path_and_loads_no_solver_where_none_is_used(session: Host) -> None:
    cell = cell_named("paper", session.folder)
    recorder = session.start_anew("record", cell, "--listen", "tcp/127.0.0.1:0")
    plant = session.start("plant", cell)
    endpoint = values_of(ready(recorder))["endpoint"]
    ready(plant)
    telemetry = [
        session.start_anew("telemetry", cell, "--member", member, "--connect", endpoint, "--lockstep")
        for member in ("plant", "left", "right")
    ]
    for process in telemetry:
        ready(process)
    agents = [session.start("agent", cell, "--arm", arm) for arm in ("left", "right")]
    for simulated in (*agents, plant):
        ended(simulated)
    light = [ended(process) for process in telemetry]
    recorder.terminate()
    light.append(ended(recorder))
    (path,) = (session.folder / "runs").glob("*.mcap")
    log = read_log(path)
    assert log.complete
    assert {arm: len(rows) for arm, rows in log.agents.items()} == {"left": ROWS, "right": ROWS}
    assert log.run_info()["plane_normal"] == pytest.approx([0, 0, 1]), (
        "what models are needed for is there all the same"
    )
    for words in light:
        assert words.splitlines()[-1].split(":")[1].strip() == "", words


def test_a_lockstep_cell_by_hand_tells_how_it_is_and_is_stopped_by_a_word(
    session: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.share(monkeypatch)
    cell = cell_named("paper", session.folder, LONG_S)
    plant = session.start("plant", cell)
    ready(plant)
    agents = {arm: session.start("agent", cell, "--arm", arm) for arm in ("left", "right")}
    for arm, agent in agents.items():
        ring = Path(values_of(ready(agent))["ring"])
        assert ring == session.folder / "session" / "coop" / "paper" / f"{arm}.ring"
        with RingReader(ring, AGENT_STATE, acknowledges=True) as reader:
            reader.acknowledge(1 << 40)  # in the place of telemetry, for good
    for agent in agents.values():
        assert "torque=on" in ready(agent)
    refused = coop("start", cell, "--in", "5")
    assert refused.code == 7
    assert "left: refuses in " in refused.err
    shown = coop("status", cell, "--json", "--logs", session.folder)
    assert shown.code == 0, shown.out
    assert [(arm["mode"], arm["same_cell"]) for arm in json.loads(shown.out)["arms"]] in (
        [("READY", True)] * 2, [("TRACK", True)] * 2,
    )  # fmt: skip
    stopped = coop("stop", cell)
    assert stopped.code == 0, stopped.err
    for arm, agent in agents.items():
        words = ended(agent)
        assert f"arm {arm}: " in words
        assert ", mode OFF" in words
        assert int(words.split("arm ")[1].split()[1]) < 200 * LONG_S, "before its end"
    ended(plant)


def test_an_arm_that_waits_for_the_others_ends_in_order_by_a_signal_by_a_word_and_with_its_plant(
    session: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first state of a simulated arm needs all of them, and the others may take a minute to start."""
    session.share(monkeypatch)
    cell = cell_named("paper", session.folder, LONG_S)
    plant = session.start("plant", cell)
    ready(plant)

    def waiting() -> Loaded:
        agent = session.start("agent", cell, "--arm", "left")
        ready(agent)
        assert "torque=on" in ready(agent)
        return agent

    agent = waiting()
    agent.terminate()
    assert ", mode OFF" in ended(agent)
    agent = waiting()
    stopped = coop("stop", cell)
    assert "done: left holds" in stopped.err
    assert ", mode OFF" in ended(agent)
    agent = waiting()
    plant.kill()
    _, words = agent.communicate(timeout=90)
    assert agent.returncode == 5, words


def test_emulated_servos_by_hand_need_no_path(session: Host) -> None:
    emulator = session.start("emulate", str(configs.CELLS_DIR / "two_wx200.toml"), "--ports", "ports")
    folder = session.folder / "session" / "coop" / "two_wx200"
    assert ready(emulator).strip() == f"READY ring={folder / 'plant.ring'}"
    emulator.terminate()
    ended(emulator)


@pytest.mark.paced
def test_the_processes_of_the_first_carry_come_together_as_its_page_starts_them(
    short_session: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On emulated servos, and without the rights to real time."""
    session, folder = short_session, Path(short_session.runtime)
    session.share(monkeypatch)
    cell = session.folder / "cell.toml"
    text = (configs.CELLS_DIR / "two_wx200.toml").read_text() + "\n[session]\n"
    for key, value in SLOWLY.items():
        text = re.sub(rf"^{key} = [\d.]+", f"{key} = {value}", text, flags=re.MULTILINE)
    cell.write_text(text)
    page = (ROOT / "docs/first-carry.md").read_text().split("## 5.")[1].split("## 6.")[0]
    lines = re.findall(r"^    coop (record|telemetry|guard|agent) CELL(.*)$", page, re.MULTILINE)
    assert [word for word, _ in lines] == ["record", "telemetry", "guard", "agent"]
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    servos = ("--driver", "dynamixel", "--emulated", "--port", str(session.folder / "ports/left"))
    more = {"record": ("--listen", endpoint), "telemetry": ("--connect", endpoint), "guard": servos, "agent": servos}
    ready(session.start("emulate", str(cell), "--ports", "ports", "--whole", "--no-timing"))
    started = {}
    for word, rest in lines:
        own = re.sub(r" --priority \d+", "", rest).replace("$XDG_RUNTIME_DIR", str(folder)).replace("NAME", "two_wx200")
        started[word] = session.start(word, str(cell), *own.split(), *more[word])
        if word != "telemetry":  # which waits for a ring
            ready(started[word])
    assert "torque=on" in ready(started["agent"])
    shown = coop("status", cell, "--logs", session.folder / "runs").out
    assert re.search(r"^left +REST .*guard watches", shown), shown
    assert f"recorder in {session.folder / 'runs'}" in shown
    said = coop("guide", cell, "--once")
    assert "next for left: coop release" in said.out, said
    assert coop("release", cell, "--arm", "left").code == 0
    ended(started["agent"])
    for word in ("guard", "telemetry", "record"):
        started[word].send_signal(signal.SIGINT)
        started[word].communicate(timeout=90)
    (path,) = (session.folder / "runs").glob("*.mcap")
    rows = read_log(path).agents["left"]
    assert set(rows["mode"]) <= {Mode.REST, Mode.OFF}
    assert len(rows) > 0


def test_without_a_session_folder_a_plant_starts_in_tmp(tmp_path: Path) -> None:
    name = f"fresh{os.getpid()}"
    folder = Path(f"/tmp/coop-{os.getuid()}/coop/{name}")
    host = Host(tmp_path)
    try:
        assert f"socket={folder}/plant.sock" in ready(host.start("plant", cell_named(name, tmp_path)))
    finally:
        host.close()
        shutil.rmtree(folder, ignore_errors=True)


def test_a_session_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "coop").write_text("in the way")
    host = Host(tmp_path, XDG_RUNTIME_DIR=str(tmp_path))
    plant = host.start("plant", str(PAPER))
    _, words = plant.communicate(timeout=60)
    assert plant.returncode == 2
    assert f"folder {tmp_path / 'coop'}: found File exists" in words.splitlines()[0]
    assert "set XDG_RUNTIME_DIR to a folder that you can write" in words.splitlines()[0]


def test_an_agent_by_hand_without_a_plant_says_what_to_start(session: Host) -> None:
    agent = session.start("agent", str(PAPER), "--arm", "left")
    _, words = agent.communicate(timeout=60)
    assert agent.returncode == 3
    assert "start the plant of this cell first" in words
    assert "Traceback" not in words


def test_telemetry_says_what_it_waits_for(session: Host) -> None:
    telemetry = session.start("telemetry", str(PAPER), "--arm", "left")
    ready(telemetry)
    assert telemetry.stderr is not None
    ring = session.folder / "session" / "coop" / "paper" / "left.ring"
    line = telemetry.stderr.readline()
    assert line.startswith(f"left: waits for the ring {ring}, which `coop agent --arm left` makes"), line
    assert "until it is stopped" in line
    telemetry.terminate()
    ended(telemetry)


@pytest.mark.parametrize("named", [False, True])
def test_telemetry_takes_a_ring_of_an_earlier_run_only_where_it_is_named(session: Host, named: bool) -> None:
    ring = session.folder / "session" / "coop" / "paper" / "left.ring"
    ring.parent.mkdir(mode=0o700, parents=True)
    with RingWriter(ring, AGENT_STATE, "left", JOINTS, slots=2) as agent:
        agent.commit()
        agent.finish()
    place = ("--ring", str(ring)) if named else ()
    telemetry = session.start(
        "telemetry", str(PAPER), "--arm", "left", "--connect", "tcp/127.0.0.1:9", "--lockstep", *place
    )
    ready(telemetry)
    assert telemetry.stderr is not None
    line = telemetry.stderr.readline()
    if named:
        assert line.startswith("left: no recorder at tcp/127.0.0.1:9 has answered"), line
    else:
        assert line.startswith(f"left: waits for the ring {ring}, which"), line
        assert "the one there is an earlier run's, which --ring with that path sends" in line
    telemetry.terminate()
    _, words = telemetry.communicate(timeout=90)
    rows = 1 if named else 0
    assert telemetry.returncode == rows, "1: done, and rows are missing"
    assert f"left: {rows} rows, 0 lost in the ring, {rows} not confirmed by the recorder" in words


@pytest.mark.parametrize(
    ("name", "joints", "found"),
    [("right", JOINTS, "the ring of 'right', expected that of 'left'"), ("left", ("waist",), "joints waist, expected")],
)
def test_telemetry_refuses_the_ring_of_another_arm(
    session: Host, name: str, joints: tuple[str, ...], found: str
) -> None:
    ring = session.folder / "some.ring"
    with RingWriter(ring, AGENT_STATE, name, joints, slots=2):
        telemetry = session.start("telemetry", str(PAPER), "--arm", "left", "--ring", str(ring))
        _, words = telemetry.communicate(timeout=60)
    assert telemetry.returncode == 2
    assert f"telemetry ring {ring}: found {found}" in words


def test_telemetry_without_a_recorder_says_so(session: Host) -> None:
    plant = session.start("plant", str(PAPER))
    ready(plant)
    telemetry = session.start("telemetry", str(PAPER), "--member", "plant", "--connect", "tcp/127.0.0.1:9")
    ready(telemetry)
    assert telemetry.stderr is not None
    line = telemetry.stderr.readline()
    assert line.startswith("plant: no recorder at tcp/127.0.0.1:9 has answered; waits for one until it is stopped"), (
        line
    )
