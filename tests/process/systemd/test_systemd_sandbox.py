"""What the kernel enforces on our units, asked from inside them, and how they stop: on a booted systemd."""

from __future__ import annotations

import json
import sysconfig
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.systemd.machine import Machine, booted, missing
from tests.support.systemd.unit_files import install

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing())

PLACES = "/etc/coop /etc/coop/keys /var/lib/coop/runs /home /run /run/coop/hang/hang.ring /run/coop/kernel"
WATCHDOG_S = 2.0  # an own process strokes it, and this machine may stand still for a second


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    scratch = tmp_path_factory.mktemp("machine")
    files = scratch / "files"
    install(files)
    (files / "etc/coop/keys").mkdir(parents=True)
    (files / "etc/coop/cell.toml").touch()
    program = (Path(__file__).parents[2] / "support" / "systemd" / "probe.py").read_text()
    (files / "opt/probe.py").parent.mkdir()
    (files / "opt/probe.py").write_text(program)
    python = f"/opt/python/bin/python{sysconfig.get_python_version()} /opt/probe.py"
    for unit, what in (("coop-agent@", "%i"), ("coop-telemetry@", "kernel"), ("coop-recorder", "kernel")):
        drop_in = files / f"etc/systemd/system/{unit}.service.d/probe.conf"
        drop_in.parent.mkdir()
        environment = "Environment=PYTHONHOME=/opt/python LD_LIBRARY_PATH=/opt/python/lib"
        drop_in.write_text(f"[Service]\n{environment}\nExecStart=\nExecStart={python} {what} {PLACES}\n")
    # they stroke their watchdogs, and this machine may stop for longer than the 100 ms of an agent's, and than the
    # second in which one that hangs says where
    waits = f"WatchdogSec={WATCHDOG_S}"
    for what, wait in (("kernel", waits), ("hold", waits), ("hang", "TimeoutAbortSec=20")):
        patient = files / f"etc/systemd/system/coop-agent@{what}.service.d/patient.conf"
        patient.parent.mkdir()
        patient.write_text(f"[Service]\n{wait}\n")
    (files / "etc/systemd/system/ssh.service").write_text("[Service]\nExecStart=/usr/bin/sleep infinity\n")
    off = "[Unit]\nDefaultDependencies=no\nRequires=shutdown.target\nAfter=shutdown.target\n"
    (files / "etc/systemd/system/off.target").write_text(off)
    with booted(files, scratch) as machine:
        machine.run("systemctl", "start", "coop-agent@hang.service")
        yield machine


def what_the_kernel_says(machine: Machine, unit: str) -> dict[str, str]:
    machine.run("systemctl", "restart", unit)
    this_start = f"_SYSTEMD_INVOCATION_ID={machine.show(unit, 'InvocationID')}"
    deadline = time.monotonic() + 20.0
    while not (lines := machine.run("journalctl", "--output=cat", this_start).splitlines()):
        assert time.monotonic() < deadline, machine.journal(unit)
        time.sleep(0.05)
    found: dict[str, str] = json.loads(lines[-1])
    return found


SHARED = {
    "CapEff": "0000000000000000",
    "CapBnd": "0000000000000000",
    "NoNewPrivs": "1",
    "Seccomp": "2",
    "clock": "EPERM",
    "write and execute": "EPERM",
    "namespace": "EPERM",
    "AF_PACKET": "EAFNOSUPPORT",
    "write /etc/coop": "EROFS",
    "read /etc/coop/keys": "EACCES",
    "write /home": "EACCES",
    "write /run": "EROFS",
}


def test_the_agent_has_no_network(machine: Machine) -> None:
    found = what_the_kernel_says(machine, "coop-agent@kernel.service")
    network = {name: found[name] for name in ("AF_UNIX", "AF_INET", "AF_INET6", "AF_NETLINK")}
    assert network == {
        "AF_UNIX": "ok",
        "AF_INET": "EAFNOSUPPORT",
        "AF_INET6": "EAFNOSUPPORT",
        "AF_NETLINK": "EAFNOSUPPORT",
    }
    pid = machine.show("coop-agent@kernel.service", "MainPID")
    ours, its = (machine.run("readlink", f"/proc/{process}/ns/net") for process in ("1", pid))
    assert its != ours


def test_the_agent_can_do_its_work_and_nothing_else(machine: Machine) -> None:
    found = what_the_kernel_says(machine, "coop-agent@kernel.service")
    assert {name: found[name] for name in SHARED} == SHARED
    assert found["read /etc/coop"] == "ok"
    assert found["read /var/lib/coop/runs"] == "EACCES"
    assert found["write /run/coop/kernel"] == "ok"
    assert found["write /run/coop/hang/hang.ring"] == "EROFS", "another arm's ring"
    assert found.get("real time", "ok") == "ok"


def test_telemetry_reads_the_ring_and_writes_nothing(machine: Machine) -> None:
    found = what_the_kernel_says(machine, "coop-telemetry@hang.service")
    assert {name: found[name] for name in SHARED} == SHARED
    assert found["read /run/coop/hang/hang.ring"] == "ok"
    assert found["write /run/coop/hang/hang.ring"] == "EACCES"
    assert found["read /var/lib/coop/runs"] == "EACCES"
    assert found["AF_INET"] == "ok"


def test_the_recorder_writes_logs_and_knows_no_ring(machine: Machine) -> None:
    found = what_the_kernel_says(machine, "coop-recorder.service")
    assert {name: found[name] for name in SHARED} == SHARED
    assert found["write /var/lib/coop/runs"] == "ok"
    assert found["read /run/coop/hang/hang.ring"] == "EACCES"
    assert found["AF_INET"] == "ok"


def test_a_hanging_agent_is_ended_named_and_not_started_again(machine: Machine) -> None:
    unit = "coop-agent@hang.service"
    machine.wait_for(unit, "ActiveState", "failed")
    assert machine.show(unit, "Result") == "watchdog"
    assert machine.show(unit, "NRestarts") == "0"
    assert "in endless_loop" in machine.journal(unit), "the journal says where it hung"
    assert machine.run("cat", "/run/coop/hang/hang.ring") == "last words", "the black box stays"


@pytest.mark.fault("P6")
def test_a_stopped_agent_holds_until_a_person_releases_it(machine: Machine) -> None:
    unit = "coop-agent@hold.service"
    machine.run("systemctl", "start", unit)
    machine.run("systemctl", "stop", "--no-block", unit)
    machine.wait_for(unit, "StatusText", "HOLD")
    time.sleep(1.5 * WATCHDOG_S)
    assert machine.show(unit, "ActiveState") == "deactivating", machine.show(unit, "Result")
    machine.run("systemctl", "kill", "--signal=SIGUSR1", unit)
    machine.wait_for(unit, "ActiveState", "inactive")
    assert machine.show(unit, "Result") == "success"


def test_a_shutdown_waits_for_a_hold_and_leaves_a_way_in(machine: Machine) -> None:
    unit = "coop-agent@hold.service"
    machine.run("systemctl", "start", "ssh.service", unit)
    machine.run("systemctl", "start", "--no-block", "--job-mode=replace-irreversibly", "off.target")
    machine.wait_for(unit, "StatusText", "HOLD")
    time.sleep(1.5 * WATCHDOG_S)
    assert machine.show(unit, "ActiveState") == "deactivating", machine.show(unit, "Result")
    assert machine.show("ssh.service", "ActiveState") == "active"
    machine.run("systemctl", "kill", "--signal=SIGUSR1", unit)
    machine.wait_for("ssh.service", "ActiveState", "inactive")
