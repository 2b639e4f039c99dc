"""The simulated cell on a booted systemd: the units of a real host, with the drop-ins that only change the driver."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.summary import Summary

from agent.log.read import RunLog, read_log
from tests.support.systemd.machine import Machine, booted, missing
from tests.support.systemd.unit_files import OPTIONAL, SIMULATED, SYSTEMD, install
from tests.support.telemetry.cell_certificates import fill_in, make_certificates

pytestmark = [
    pytest.mark.skipif(bool(missing()), reason=missing()),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl to make certificates"),
]

CELL = SYSTEMD.parent / "configs/cells/paper.toml"
ARMS = ("left", "right")
AGENTS, GUARDS = (tuple(f"coop-{what}@{arm}.service" for arm in ARMS) for what in ("agent", "guard"))


@contextmanager
def cell(scratch: Path) -> Iterator[Machine]:
    files = scratch / "files"
    install(files, "simulated")
    (files / "etc/coop").mkdir(exist_ok=True)
    shutil.copy(CELL, files / "etc/coop/cell.toml")
    with booted(files, scratch) as machine:
        machine.run("systemctl", "enable", *AGENTS, "coop-recorder.service")
        yield machine


def becomes_one_of_several_hosts(machine: Machine, scratch: Path) -> None:
    """From the next start on everything goes over TLS."""
    files = scratch / "several"
    install(files, "simulated", "several-hosts")
    _write_keys(files, make_certificates(scratch / "certificates"))
    shutil.copytree(files, machine.root, dirs_exist_ok=True)
    machine.run("systemctl", "daemon-reload")


def _write_keys(files: Path, certificates: Path) -> None:
    (files / "etc/hosts").write_text("127.0.0.1 localhost recorder.cell\n")
    keys, zenoh = files / "etc/coop/keys", files / "etc/coop/zenoh"
    keys.mkdir()
    shutil.copy(certificates / "cell.pem", zenoh / "ca.pem")
    for name in (*ARMS, "plant", "recorder"):
        shutil.copy(certificates / f"{name}.key", keys / f"{name}.pem")
        shutil.copy(certificates / f"{name}.pem", zenoh)
        template = zenoh / ("recorder.json5" if name == "recorder" else "arm.json5")
        (zenoh / f"{name}.json5").write_text(_with_plant(fill_in(template.read_text(), name)))


def _with_plant(configuration: str) -> str:
    """The recorder's table with the simulated plant, which no real cell has, under the rule of the right arm."""
    keys = '"coop/paper/right/**", "coop/paper/right/**/@adv/**"'
    more = configuration.replace(keys, f"{keys}, {keys.replace('right', 'plant')}")
    return more.replace('["arm-right"]', '["arm-right", "plant"]')


def logs(machine: Machine) -> list[Path]:
    return sorted((machine.root / "var/lib/coop/runs").glob("*.mcap"))


def start(machine: Machine) -> None:
    """Start the cell and let it move, once its log has begun."""
    before = len(logs(machine))
    machine.run("systemctl", "start", "coop.target")
    for unit in set(SIMULATED) - set(OPTIONAL):
        assert machine.show(unit, "ActiveState") == "active", machine.journal(unit)
    wait_for_logs(machine, before + 1)
    machine.run("sleep", "1")


def wait_for_logs(machine: Machine, count: int) -> None:
    """Wait until the recorder has begun so many logs."""
    deadline = time.monotonic() + 30.0
    while len(logs(machine)) < count:
        assert time.monotonic() < deadline, machine.journal("coop-recorder.service")
        time.sleep(0.05)


def stop(machine: Machine) -> None:
    """Stop the cell and wait for the last process."""
    machine.run("systemctl", "stop", "coop.target")
    for unit in ("coop-recorder.service", "coop-rings.service"):
        machine.wait_for(unit, "ActiveState", "inactive")


def completeness(log: Path) -> dict[str, str]:
    with log.open("rb") as file:
        (found,) = [record for record in make_reader(file).iter_metadata() if record.name == "completeness"]
    return found.metadata


def test_a_killed_recorder_comes_back_a_killed_agent_does_not_and_the_next_start_is_one_complete_log_over_tls(
    tmp_path: Path,
) -> None:
    """One machine for all of it: each start takes ten seconds of a core."""
    with cell(tmp_path) as machine:
        start(machine)
        agents = [machine.show(unit, "MainPID") for unit in AGENTS]
        machine.run("systemctl", "kill", "--signal=SIGKILL", "coop-recorder.service")
        machine.wait_for("coop-recorder.service", "NRestarts", "1")
        wait_for_logs(machine, 2)
        machine.run("sleep", "2")
        assert [machine.show(unit, "MainPID") for unit in AGENTS] == agents, "the arms do not notice"

        machine.run("systemctl", "kill", "--signal=SIGKILL", GUARDS[1])
        machine.wait_for(GUARDS[1], "NRestarts", "1")
        machine.wait_for(GUARDS[1], "StatusText", "watches the agent")
        machine.wait_for(
            AGENTS[1], "StatusText", "HOLDING the object; `coop release` (or SIGUSR1) once it is supported"
        )

        machine.run("systemctl", "kill", "--signal=SIGKILL", AGENTS[0])
        machine.wait_for(AGENTS[0], "ActiveState", "failed")
        assert machine.show(AGENTS[0], "Result") == "signal"
        machine.run("sleep", "2")
        assert machine.show(GUARDS[0], "ActiveState") == "active", machine.journal(GUARDS[0])
        stop(machine)
        for guard in GUARDS:
            machine.wait_for(guard, "ActiveState", "inactive")
            assert machine.show(guard, "Result") == "success", machine.journal(guard)
        assert len(list((machine.root / "var/lib/coop/post-mortem/left").glob("*.mcap"))) == 1
        assert machine.show(AGENTS[0], "NRestarts") == "0"
        cut, after = logs(machine)
        with cut.open("rb") as file:
            summary = make_reader(file).get_summary()
        log = completeness(after)
        read = read_log(after)
        becomes_one_of_several_hosts(machine, tmp_path)
        check_next_start(machine)
    check_killed(summary, log, read)


def check_next_start(machine: Machine) -> None:
    """On what the processes that were killed have left: one complete log more, and nothing that has failed."""
    before = len(logs(machine))
    start(machine)
    stop(machine)
    assert "recorder.json5" in machine.show("coop-recorder.service", "Environment"), "over TLS"
    assert len(logs(machine)) == before + 1
    complete = completeness(logs(machine)[-1])
    assert complete["complete"] == "true", complete
    for unit in AGENTS:
        assert machine.show(unit, "Result") == "success", machine.journal(unit)
        assert machine.show(unit, "NRestarts") == "0"
    machine.run("systemctl", "start", "coop-recorder.service")
    machine.run("systemctl", "stop", "coop-recorder.service")
    assert machine.show("coop-recorder.service", "Result") == "success", "it was asked to end while it began"


def check_killed(summary: Summary | None, log: dict[str, str], read: RunLog) -> None:
    """The log that was cut short, and what the one behind it says of the agent that died."""
    (died,) = [e for e in read.events if e.text == "the agent has died: the guard holds the arm"]
    assert died.source == "left"
    rows, told_ns = read.agents["left"], died.data["stamp_ns"]
    last = rows[rows["stamp_ns"] <= told_ns][-1]  # of the agent
    assert 0.0 <= died.data["last_row_s"] <= 1e-9 * (told_ns - int(last["stamp_ns"])) + 1e-6, "by the guard's own clock"
    assert summary is not None, "the log that was cut short has been repaired"
    assert summary.statistics is not None
    assert summary.statistics.message_count > 100
    assert log["left.end"] == "finished", "the guard went on in the agent's ring"
    for arm in ARMS:
        assert int(log[f"{arm}.rows_recorded"]) > 200, log
