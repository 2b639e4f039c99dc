"""P1, P2, P7 with real processes on a real pseudo terminal: a guard holds the arm of a killed or stopped agent.

How soon, in virtual time: `tests/unit/guard/test_takeover.py`.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.doctor.host import fifo_granted
from agent.guard.agent_end import AgentEnd
from agent.guard.guarded import HAND_OVER_AFTER
from agent.guard.line import GuardError, Word
from agent.guard.takeover import EMULATED_STALE_NS
from agent.host.unix_socket import WAIT_S
from agent.log.read import read_log
from agent.modes import Mode
from agent.operator.ask import ask_arms
from agent.operator.message import Reply, Request
from agent.operator.table import Verb
from agent.safety import Flag
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextReader
from agent.telemetry.row.event import Event
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import Kind
from tests.support.command import coop
from tests.support.coop import COOP
from tests.support.stalls import Kernel, despite_stalls

PATIENCE_S = 90.0
SOME_ROWS = 40
GIVEN_UP_S = 4.0  # longer than an arm that is limp is brought back after, with emulated servos
AWAY_S = 1.5  # longer than until the port is first tried again, shorter than it is waited for
# hands over a kept descriptor: argument 1 is its number, the rest is the command
AS_A_MANAGER_DOES = """
import os, sys
os.dup2(int(sys.argv[1]), 3)
os.environ.update(LISTEN_FDS="1", LISTEN_FDNAMES="port", LISTEN_PID=str(os.getpid()))
os.execv(sys.argv[2], sys.argv[2:])
"""
# an agent whose step fails after some cycles
FAILING = """
from agent import runner
works, left = runner.step, [60]
def step(*arguments):
    left[0] -= 1
    return works(*arguments) if left[0] else 1 / 0
runner.step = step
from agent.cli.main import main
main()
"""
# an agent that is told to end when its law is ready, the last thing before its torque
STOPPED = """
import os, signal
from agent.process import agent
builds = agent._law
def law(*arguments):
    os.kill(os.getpid(), signal.SIGTERM)
    return builds(*arguments)
agent._law = law
from agent.cli.main import main
main()
"""
# the command with what it loads loaded, while the servos start; its words come on standard input
LOADING = """
import json, os, sys
from agent.host.unix_socket import WAIT_S
from agent.host.starting import settle
settle()
import agent.process.agent, agent.process.guard
from agent.cli.main import main
words, more = json.loads(sys.stdin.readline())
os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
os.environ.update(more)
sys.argv[1:] = words
main()
"""


class Host:
    """Emulated servos of two_wx200 and whoever is started beside them; all of them end with the test."""

    def __init__(self, folder: Path, loading: int = 2) -> None:
        """loading: how many of guard and agent are begun at once."""
        self.folder = folder
        self.arm_is = ("--emulated",)
        (folder / "session").mkdir()
        self.environment = {k: v for k, v in os.environ.items() if k != "RUNTIME_DIRECTORY"}
        self.environment["XDG_RUNTIME_DIR"] = str(folder / "session")
        self.ring = folder / "left.ring"
        self.words = (folder / "words").open("a")
        self.processes: list[subprocess.Popen[str]] = []
        self.manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.manager.bind(str(folder / "notify"))
        self.kept: int | None = None
        self.cell = folder / "cell.toml"
        self.loading = [self._begun((sys.executable, "-c", LOADING), subprocess.PIPE) for _ in range(loading)]

    def start(
        self, *arguments: str | Path, prefix: tuple[str, ...] = (), program: tuple[str, ...] = COOP, **more: str
    ) -> subprocess.Popen[str]:
        words = [*map(str, arguments)]
        if words[0] in ("guard", "agent") and program is COOP and not prefix and self.loading:
            process = self.loading.pop()
            assert process.stdin is not None
            process.stdin.write(json.dumps([words, more]) + "\n")
            process.stdin.close()
        else:
            process = self._begun((*prefix, *program, *words), subprocess.DEVNULL, **more)
        self.said(process)
        return process

    def _begun(self, command: tuple[str, ...], stdin: int, **more: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            command, cwd=self.folder, env=self.environment | more, text=True, stdin=stdin, stdout=subprocess.PIPE,
            stderr=self.words, pass_fds=() if self.kept is None else (self.kept,),
        )  # fmt: skip
        self.processes.append(process)
        return process

    def said(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("READY "), (self.folder / "words").read_text()

    def guard(self, *more: str, prefix: tuple[str, ...] = ()) -> subprocess.Popen[str]:
        return self.start(
            "guard", self.cell, "--arm", "left", "--port", self.folder / "ports/left", *self.arm_is,
            "--driver", "dynamixel", "--socket", self.folder / "left.guard", "--control", self.folder / "left.control",
            "--post-mortem", self.folder / "post_mortem", *more,
            prefix=prefix, NOTIFY_SOCKET=str(self.folder / "notify"),
        )  # fmt: skip

    def agent(self, *more: str, program: tuple[str, ...] = COOP, begins: bool = True) -> subprocess.Popen[str]:
        process = self.start(
            "agent", self.cell, "--arm", "left", "--port", self.folder / "ports/left", *self.arm_is, "--driver",
            "dynamixel", "--guard", self.folder / "left.guard", "--control", self.folder / "left.control",
            "--ring", self.ring, *more, program=program,
        )  # fmt: skip
        if begins:  # has torque
            self.said(process)
        return process

    def kept_port(self) -> int:
        """The descriptor that the service manager would keep."""
        self.manager.settimeout(PATIENCE_S)
        assert self.manager.recv(1000) == b"READY=1\nSTATUS=loads", "before anything else: its agent loads meanwhile"
        while True:
            text, fds, _, _ = socket.recv_fds(self.manager, 1000, 1)
            if fds:
                assert text == b"FDSTORE=1\nFDNAME=port"
                return fds[0]

    def rows(self) -> np.ndarray:
        with RingReader(self.ring, AGENT_STATE) as reader:
            assert reader.writer_alive or reader.finished, "no reader ever finds the ring without a writer"
            return np.frombuffer(reader.read_at(0, reader.written).payload, AGENT_STATE.dtype)

    def events(self) -> list[Event]:
        reader = TextReader(self.ring)
        found = [Event.from_json(text) for kind, text in reader.read_new() if kind is Kind.EVENT]
        reader.close()
        return found

    def told(self) -> list[str]:
        return [event.text for event in self.events()]

    def wait(self, what: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < deadline, "\n".join([*self.told(), (self.folder / "words").read_text()])
            time.sleep(0.02)

    def close(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()
        self.manager.close()
        self.words.close()
        if self.kept is not None:
            os.close(self.kept)


def in_real_time(*more: str, settings: str = "") -> Callable[[Callable[[Host], None]], Callable[[Path], None]]:
    """A test on a host, and again on another where the emulated servos had no core when they were to answer.

    more: of `coop emulate`; settings: what the cell file has besides two_wx200.
    """

    def on_hosts(test: Callable[[Host], None]) -> Callable[[Path], None]:
        @pytest.mark.realtime
        @pytest.mark.timeout(400)
        @despite_stalls
        def on_host(tmp_path: Path) -> None:
            host, kernel = Host(tmp_path), Kernel()
            host.cell.write_text((configs.CELLS_DIR / "two_wx200.toml").read_text() + settings)
            try:
                emulator = host.start("emulate", host.cell, *more, "--ports", tmp_path / "ports")
                with kernel.heard(emulator.pid):
                    test(host)
            finally:
                host.close()

        return on_host

    return on_hosts


def of_hold(rows: np.ndarray) -> np.ndarray:
    return rows[rows["mode"] == Mode.HOLD]


def commanded(rows: np.ndarray) -> np.ndarray:
    """(k,) whether a row's torque went out."""
    found: np.ndarray = np.isfinite(rows["tau_sent"][:, :3]).all(axis=1)
    return found


def check_taken_over(
    host: Host, guard: subprocess.Popen[str], agent: subprocess.Popen[str], cause: str, code: int = -signal.SIGKILL
) -> None:
    """The guard holds, in the agent's ring, as its only writer; a release ends it; the post-mortem reads."""
    before = len(host.rows())
    host.wait(lambda: agent.poll() == code)
    host.wait(lambda: len(host.rows()) > before + SOME_ROWS and len(of_hold(host.rows())) > SOME_ROWS)
    host.wait(lambda: bool(commanded(host.rows()[before + SOME_ROWS :]).any()))  # also after watchdogs that had fired
    (taken,) = [event for event in host.events() if event.text.endswith("the guard holds the arm")]
    assert taken.text.startswith(cause)
    hung = cause == "the agent hung"
    rows = host.rows()
    last = rows[rows["stamp_ns"] <= taken.data["stamp_ns"]][-1]  # of the agent
    least_s, most_s = hung * EMULATED_STALE_NS * 1e-9, 1e-9 * (taken.data["stamp_ns"] - int(last["stamp_ns"]))
    assert least_s <= taken.data["last_row_s"] <= most_s + 1e-6, "how old the agent's last row was"
    released = coop("release", host.cell, "--control", host.folder / "left.control", cwd=host.folder)
    assert released.code == 0, released.err
    assert guard.wait(PATIENCE_S) == 0
    rows = host.rows()
    assert (rows["sequence"] == np.arange(len(rows))).all(), "two never write"
    held = np.flatnonzero(rows["mode"] == Mode.HOLD)
    assert (rows["mode"][held[0] :] == Mode.HOLD).all()
    assert any(text.startswith("run ended in OFF") for text in host.told())
    (file,) = (host.folder / "post_mortem").glob("*-left-post-mortem.mcap")
    log = read_log(file)
    assert not log.problems
    np.testing.assert_array_equal(log.agents["left"]["q"], rows["q"][: len(log.agents["left"])])
    assert len(log.agents["left"]) > held[0], "the first cycles of the hold are in it"
    assert cause in log.metadata["post_mortem"]["cause"]


@pytest.mark.fault("P2")
@in_real_time()
def test_a_stopped_agent_is_ended_and_held_for(host: Host) -> None:
    guard = host.guard()
    stranger = AgentEnd(host.folder / "left.guard", load_cell(host.cell).fingerprint)
    with pytest.raises(GuardError, match=r"found KeyError 'driver'.*start agent and guard from one release"):
        stranger.ask(Word.WATCH)
    stranger.close()
    agent = host.agent()
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    agent.send_signal(signal.SIGSTOP)
    check_taken_over(host, guard, agent, "the agent hung")


@pytest.mark.fault("P1")
@pytest.mark.long  # a killed agent is held for in the same way below, and in virtual time
@in_real_time()
def test_an_agent_that_fails_by_an_error_is_held_for_and_says_why(host: Host) -> None:
    guard = host.guard()
    agent = host.agent(program=(sys.executable, "-c", FAILING))
    check_taken_over(host, guard, agent, "the agent has died", code=1)
    assert "ZeroDivisionError: division by zero; the guard goes on" in host.told()
    assert "Traceback" in (host.folder / "words").read_text()


def test_an_agent_that_is_told_to_end_before_it_has_torque_ends_without_and_its_guard_has_nothing_to_hold(
    tmp_path: Path,
) -> None:
    host = Host(tmp_path, loading=1)
    host.cell.write_text((configs.CELLS_DIR / "two_wx200.toml").read_text())
    try:
        host.start("emulate", host.cell, "--ports", tmp_path / "ports")
        host.wait((tmp_path / "ports/left").exists)
        guard = host.guard()
        agent = host.agent("--hold", program=(sys.executable, "-c", STOPPED), begins=False)
        assert agent.wait(PATIENCE_S) == 130
        assert "found a stop before its torque came on" in (tmp_path / "words").read_text()
        assert len(host.rows()) == 0
        guard.terminate()
        assert guard.wait(PATIENCE_S) == 0
    finally:
        host.close()


@pytest.mark.long  # what it says beforehand: tests/unit/process/test_agent_order.py
@pytest.mark.skipif(not fifo_granted(), reason="this host gives no real-time priority, without which no row is in time")
@in_real_time()
def test_a_release_of_an_arm_that_is_taken_for_a_real_one_ends_its_agent_and_leaves_its_guard(host: Host) -> None:
    """Its guard waits for a row no longer than a real arm's does, less than switching the torque off takes."""
    host.arm_is = ("--priority", "80")
    guard = host.guard()
    agent = host.agent("--allow-no-realtime")
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    released = coop("release", host.cell, "--control", host.folder / "left.control", cwd=host.folder)
    assert released.code == 0, released.err
    assert agent.wait(PATIENCE_S) == 0, host.told()
    assert host.told()[-1].startswith("run ended in OFF")
    assert guard.poll() is None
    guard.terminate()
    assert guard.wait(PATIENCE_S) == 0, "it had nothing to hold"


@pytest.mark.fault("P14")
@pytest.mark.long  # in virtual time, cut anywhere: tests/unit/guard/test_watched.py
@in_real_time()
def test_an_arm_is_held_where_the_ring_that_agent_and_guard_share_is_cut(host: Host) -> None:
    """The agent dies of it: it stores its rows into a map of the file."""
    guard = host.guard()
    agent = host.agent()
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    before, size = len(host.rows()), host.ring.stat().st_size
    with RingReader(host.ring, AGENT_STATE) as listener:  # as telemetry does all along
        host.ring.write_bytes(b"")
        assert agent.wait(PATIENCE_S) == -signal.SIGBUS
        host.wait(lambda: listener.written > before + 2 * SOME_ROWS)
        assert guard.poll() is None
        rows = np.frombuffer(listener.read_last(2 * SOME_ROWS).payload, AGENT_STATE.dtype)
        host.wait(lambda: bool(commanded(np.frombuffer(listener.read_last(1).payload, AGENT_STATE.dtype)).all()))
    assert (np.diff(rows["sequence"].astype(int)) == 1).all()
    assert (rows["mode"][-SOME_ROWS:] == Mode.HOLD).all()
    cause = f"the agent has died: its ring was cut to 0 of {size} bytes"
    assert f"{cause}: the guard holds the arm" in host.told()
    arms = {"left": [host.folder / "left.control"]}
    status = ask_arms(arms, Request(Verb.STATUS), PATIENCE_S)["left"]
    assert isinstance(status, Reply)
    assert status.reason == cause, "which `coop status` and the terminal of a run on real arms say"
    released = coop("release", host.cell, "--control", host.folder / "left.control", cwd=host.folder)
    assert released.code == 0, released.err
    assert guard.wait(PATIENCE_S) == 0
    assert f"mode OFF {cause}" in (host.folder / "words").read_text(), "in its journal, as a service"
    (file,) = (host.folder / "post_mortem").glob("*-left-post-mortem.mcap")
    log = read_log(file)
    assert cause in log.metadata["post_mortem"]["cause"]
    kept = log.agents["left"]
    assert (kept["mode"] != Mode.HOLD).any(), "the agent's last rows, which the guard had seen"
    assert (kept["mode"] == Mode.HOLD).any()


@pytest.mark.fault("P7")
@in_real_time()
def test_a_killed_guard_is_noticed_comes_back_with_the_port_and_holds_for_a_killed_agent(host: Host) -> None:
    guard = host.guard()
    host.kept = host.kept_port()
    agent = host.agent()
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    guard.kill()
    guard.wait()
    host.wait(lambda: len(of_hold(host.rows())) > SOME_ROWS)
    assert any("the guard is gone: nobody takes over" in text for text in host.told())
    assert "holds: the guard is gone" in host.told()
    assert agent.poll() is None, "the agent itself holds"
    guard = host.guard(prefix=(sys.executable, "-Sc", AS_A_MANAGER_DOES, str(host.kept)))
    host.wait(lambda: "the guard is back and watches" in host.told())
    agent.kill()
    check_taken_over(host, guard, agent, "the agent has died")


@pytest.mark.fault("P7")
@pytest.mark.long  # a killed guard is above, one that hangs in virtual time (tests/unit/guard/test_guarded.py)
@in_real_time()
def test_a_stopped_guard_is_noticed_takes_nothing_over_when_it_goes_on_and_holds_for_an_agent_that_dies_then(
    host: Host,
) -> None:
    guard = host.guard()
    agent = host.agent()
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    guard.send_signal(signal.SIGSTOP)
    host.wait(lambda: len(of_hold(host.rows())) > SOME_ROWS)
    assert "holds: the guard hangs" in host.told()
    (told,) = [text for text in host.told() if text.startswith("the guard hangs (no look for ")]
    assert told.endswith("nobody takes over should this process end, and the arm falls limp then")
    guard.send_signal(signal.SIGCONT)
    host.wait(lambda: "the guard works again and watches" in host.told())
    before = len(host.rows())
    host.wait(lambda: len(host.rows()) > before + 2 * SOME_ROWS)
    assert (agent.poll(), guard.poll()) == (None, None)
    assert (host.rows()["mode"][before:] == Mode.HOLD).all(), "nothing leads back"
    agent.kill()
    check_taken_over(host, guard, agent, "the agent has died")


@pytest.mark.fault("B4")
@pytest.mark.long  # the same without a guard: tests/process/drivers/test_dxl_driver_wire.py
@in_real_time("--control", "faults")
def test_an_arm_whose_adapter_is_unplugged_for_a_while_comes_back_in_hold_through_its_guard(host: Host) -> None:
    host.guard()
    agent = host.agent()
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as emulator:
        fault = {"kind": "port_loss", "arm": "left", "duration_s": AWAY_S}
        emulator.sendto(json.dumps(fault).encode(), str(host.folder / "faults"))
    host.wait(lambda: bool((host.rows()["flags"] & Flag.RESUMED.value).any()))
    before = len(host.rows())
    host.wait(lambda: bool(commanded(host.rows()[before:]).any()))
    assert agent.poll() is None
    assert (host.rows()["mode"][before:] == Mode.HOLD).all()
    released = coop("release", host.cell, "--control", host.folder / "left.control", cwd=host.folder)
    assert released.code == 0, released.err
    assert agent.wait(PATIENCE_S) == 0
    assert list((host.folder / "post_mortem").iterdir()) == [], "the agent never was gone"


@pytest.mark.long  # tests/unit/guard/test_guarded.py has the agent, tests/unit/process/test_guard_looks.py the guard
@in_real_time()
def test_an_agent_that_is_asked_to_end_leaves_the_hold_to_its_guard(host: Host) -> None:
    guard = host.guard("--hold")
    agent = host.agent("--hold")
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    guard.send_signal(signal.SIGSTOP)
    agent.terminate()
    host.wait(lambda: len(of_hold(host.rows())) > HAND_OVER_AFTER + SOME_ROWS)
    assert agent.poll() is None, "a guard that stands still has not said yes"
    guard.terminate()  # and it wakes as one that was asked to end itself
    guard.send_signal(signal.SIGCONT)
    assert agent.wait(PATIENCE_S) == 0
    before = len(host.rows())
    host.wait(lambda: len(host.rows()) > before + 3 * SOME_ROWS)
    assert guard.poll() is None, "asked to end, it holds until a release"
    assert "the agent was asked to end (SIGTERM: it was told to end): the guard holds the arm" in host.told()
    released = coop("release", host.cell, "--control", host.folder / "left.control", cwd=host.folder)
    assert released.code == 0, released.err
    assert guard.wait(PATIENCE_S) == 0
    assert list((host.folder / "post_mortem").iterdir()) == [], "nothing has failed"


@pytest.mark.fault("P1")
@in_real_time()
def test_an_arm_is_held_where_no_word_can_be_heard_and_a_signal_releases_it(host: Host) -> None:
    guard = host.guard("--hold")
    agent = host.agent()
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    reader = os.open(host.folder, os.O_RDONLY)
    fcntl.flock(reader, fcntl.LOCK_SH)  # whoever may read the folder can: no arm waits for that
    guard.send_signal(signal.SIGUSR1)  # while it holds nothing, as one that was meant for all guards of a host
    before = len(host.rows())
    host.wait(lambda: len(host.rows()) > before + SOME_ROWS)
    agent.kill()
    host.wait(lambda: len(of_hold(host.rows())) > SOME_ROWS)
    assert guard.poll() is None
    (told,) = [text for text in host.told() if text.startswith("no word reaches")]
    assert told.startswith(f"no word reaches this hold, SIGUSR1 to process {guard.pid} releases it: control socket")
    assert np.diff(host.rows()["stamp_ns"]).max() < 1e9 * WAIT_S, "the arm is not kept waiting for the folder"
    os.close(reader)
    host.wait(lambda: "words reach this hold from here on" in host.told())
    guard.send_signal(signal.SIGUSR1)
    assert guard.wait(PATIENCE_S) == 0


@pytest.mark.fault("P12")
@pytest.mark.long  # in virtual time: tests/unit/guard/test_go_on.py
@in_real_time()
def test_a_guard_that_stood_still_itself_does_not_bring_a_limp_arm_back(host: Host) -> None:
    guard = host.guard("--hold")
    agent = host.agent()
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    guard.send_signal(signal.SIGSTOP)
    agent.kill()
    agent.wait()
    before = len(host.rows())
    time.sleep(GIVEN_UP_S)
    guard.send_signal(signal.SIGCONT)
    assert guard.wait(PATIENCE_S) == 5
    assert len(host.rows()) == before, "nothing was commanded"
    assert any(text.startswith("run ended in FAULT the agent has died, and nobody") for text in host.told())
    assert len(list((host.folder / "post_mortem").glob("*-left-post-mortem.mcap"))) == 1


@pytest.mark.long  # in virtual time: tests/unit/test_phases.py
@in_real_time("--whole", settings="\n[session]\nspeed_max_rad_per_s = 1.0\nease_s = 0.5\n")
def test_an_agent_of_a_session_that_dies_on_its_way_is_parked_by_its_guard(host: Host) -> None:
    guard = host.guard("--hold")
    agent = host.agent("--whole")
    assert say(host, "approach") == "", "\n".join(host.told()) + (host.folder / "words").read_text()
    host.wait(lambda: (host.rows()["mode"] == Mode.APPROACH).sum() > SOME_ROWS)
    agent.kill()
    host.wait(lambda: (host.rows()["mode"] == Mode.HALT).sum() > SOME_ROWS)
    halted = host.rows()
    weight = halted["tau_object"][(halted["mode"] == Mode.HALT) & (halted["flags"] & Flag.STALE.value == 0)]
    assert len(weight) > 0
    assert (weight[:, :3] == 0.0).all(), "it holds nothing"
    assert "the guard holds the arm in its agent's place and leads it back alone" in say(host, "approach")
    assert say(host, "park") == ""
    host.wait(lambda: host.rows()["mode"][-1] == Mode.REST)
    assert say(host, "release") == ""
    assert guard.wait(PATIENCE_S) == 0


@pytest.mark.fault("P7")
@pytest.mark.long  # without processes: test_control_socket.py and test_agent_order.py of unit/
@in_real_time("--whole", settings="\n[session]\nspeed_max_rad_per_s = 1.0\nease_s = 0.5\n")
def test_an_agent_whose_guard_died_at_its_rest_fetches_no_object(host: Host) -> None:
    guard = host.guard("--hold")
    agent = host.agent("--whole")
    host.wait(lambda: len(host.rows()) > SOME_ROWS)
    guard.kill()
    host.wait(lambda: any(text.startswith("the guard is gone") for text in host.told()))
    refused = say(host, "approach")
    assert "refuses in REST: the guard is gone, expected a guard that watches it" in refused
    assert set(host.rows()["mode"].tolist()) == {Mode.REST}
    assert say(host, "release") == ""
    assert agent.wait(PATIENCE_S) == 0


def say(host: Host, word: str) -> str:
    """What is answered to a word that is refused; it is said again while the arm is not done."""
    for _ in range(40):
        done = coop(word, host.cell, "--control", host.folder / "left.control", cwd=host.folder, stdin="")
        if "wait for it" not in done.err and "it has just begun" not in done.err:
            break
        time.sleep(0.1)
    return "" if done.code == 0 else done.err
