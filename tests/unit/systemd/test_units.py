"""What the systemd units promise is written in them, and every command line is one that `coop` has."""

from __future__ import annotations

import functools
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import typer

from agent.cli.main import whole
from agent.host.paths import SERVICES_DIR, control_in, guard_in, plant_socket_in, ring_in, ring_path
from tests.support.systemd.unit_files import (
    CASES,
    CHOICES,
    SERVICES,
    SIMULATED,
    SYSTEMD,
    Unit,
    command,
    install,
    one,
    read_unit,
    words,
)

AGENT_DROP_IN = "coop-agent@.service.d/50-several-hosts.conf"
NETWORKLESS = ("coop-agent@left", "coop-guard@left", "coop-rings", "coop-plant")


On = Callable[..., Path]


@pytest.fixture(scope="module")
def on(tmp_path_factory: pytest.TempPathFactory) -> On:
    """The host on which these choices were installed; what changes one makes its own."""

    @functools.cache
    def installed(*choices: str) -> Path:
        root = tmp_path_factory.mktemp("host")
        install(root, *choices)
        return root

    return installed


@pytest.fixture
def host(on: On) -> Path:
    return on()


@pytest.fixture
def simulated_host(on: On) -> Path:
    return on("simulated")


@pytest.mark.parametrize("name", NETWORKLESS)
def test_no_network_where_an_arm_is_commanded(simulated_host: Path, name: str) -> None:
    unit = read_unit(simulated_host, name)
    assert one(unit, "PrivateNetwork") == "yes"
    assert words(unit, "RestrictAddressFamilies") in ({"AF_UNIX"}, {"none"})
    assert words(unit, "IPAddressDeny") == {"any"}
    assert not unit["IPAddressAllow"]


@pytest.mark.parametrize("name", sorted(set(SERVICES) - {"coop-guard@left"}))
def test_only_the_guard_reaches_a_device(host: Path, name: str) -> None:
    unit = read_unit(host, name)
    assert not unit["DeviceAllow"]
    assert one(unit, "PrivateDevices") == "yes"
    assert one(unit, "DevicePolicy") == "closed"
    assert "dialout" not in words(unit, "SupplementaryGroups")


def test_the_guard_reaches_usb_serial_adapters_and_nothing_else(host: Path, simulated_host: Path) -> None:
    guard = read_unit(host, "coop-guard@left")
    assert guard["DeviceAllow"] == ["char-ttyUSB rw", "char-ttyACM rw"]
    assert one(guard, "DevicePolicy") == "closed"
    assert words(guard, "SupplementaryGroups") == {"dialout"}
    assert not read_unit(simulated_host, "coop-guard@left")["DeviceAllow"]


@pytest.mark.parametrize("choices", CHOICES.values(), ids=CHOICES)
def test_agent_and_guard_meet_and_the_guard_is_there_first_and_last(on: On, choices: tuple[str, ...]) -> None:
    root = on(*choices)
    agent, guard = (read_unit(root, name) for name in ("coop-agent@left", "coop-guard@left"))
    assert _option(agent, "--guard") == _option(guard, "--socket")
    assert "coop-guard@left.service" in words(agent, "After") & words(agent, "Wants")
    for key in ("Requires", "BindsTo"):  # a guard that comes back would start its agent again
        assert "coop-guard@left.service" not in words(agent, key)
    assert _option(guard, "--control") == str(Path(_option(agent, "--ring")).with_suffix(".control"))
    for key in ("User", "Group", "RuntimeDirectory", "RuntimeDirectoryMode", "RuntimeDirectoryPreserve"):
        assert one(agent, key) == one(guard, key), key
    assert _option(guard, "--post-mortem") == f"/var/lib/{one(guard, 'StateDirectory')}"


def test_a_killed_or_hanging_guard_comes_back_with_its_port_and_a_refused_one_does_not(host: Path) -> None:
    guard = read_unit(host, "coop-guard@left")
    assert one(guard, "Restart") == "on-abnormal"
    assert one(guard, "RestartForceExitStatus") == "1", "a crash; refusals have other codes"
    assert one(guard, "RestartSec") == "100ms"
    assert int(one(guard, "FileDescriptorStoreMax")) >= 1
    assert one(guard, "WatchdogSec") == "500ms"
    assert int(_option(guard, "--priority")) > int(_option(read_unit(host, "coop-agent@left"), "--priority"))
    assert int(one(guard, "LimitRTPRIO")) == int(_option(guard, "--priority"))


@pytest.mark.parametrize("choices", CHOICES.values(), ids=CHOICES)
def test_an_agent_is_never_started_again_by_itself(on: On, choices: tuple[str, ...]) -> None:
    root = on(*choices)
    assert one(read_unit(root, "coop-agent@left"), "Restart") == "no"
    target = (root / "etc/systemd/system/coop.target").read_text()
    assert "\n[Install]" not in target, "the boot of a host must not start an arm"


def test_an_agent_may_read_its_clock_where_hosts_share_time_and_nowhere_set_it(host: Path, on: On) -> None:
    """C4: without the call an agent knows its clock by the bound of the start alone, and holds 40 s later."""
    several = on("several-hosts")
    alone, together = (read_unit(root, "coop-agent@left") for root in (host, several))
    assert (alone["ProtectClock"], together["ProtectClock"][-1]) == (["yes"], "no")
    assert "adjtimex" not in alone["SystemCallFilter"][-1]
    assert together["SystemCallFilter"][-1].split() == ["adjtimex", "clock_adjtime"]
    assert together["CapabilityBoundingSet"] == [], "an empty set: no CAP_SYS_TIME"


@pytest.mark.parametrize("name", ["coop-agent@left", "coop-guard@left"])
def test_no_time_out_ever_kills_a_process_that_holds(host: Path, name: str) -> None:
    agent = read_unit(host, name)
    assert one(agent, "TimeoutStopSec") == "infinity"
    assert one(agent, "KillSignal") == "SIGTERM"
    assert one(agent, "KillMode") == "mixed"
    assert one(agent, "SystemCallErrorNumber") == "EPERM", "a forbidden system call is refused, not a death"


def test_an_agent_that_hangs_before_it_holds_anything_is_ended(host: Path) -> None:
    agent = read_unit(host, "coop-agent@left")
    assert one(agent, "TimeoutStartFailureMode") == "abort"
    assert one(agent, "TimeoutAbortSec") == "1s"
    assert one(agent, "WatchdogSec") == "100ms"
    assert one(agent, "Type") == "notify"


@pytest.mark.parametrize("name", ["coop-telemetry@left", "coop-recorder"])
def test_telemetry_and_recorder_always_come_back(host: Path, name: str) -> None:
    unit = read_unit(host, name)
    assert one(unit, "Restart") == "always"
    assert one(unit, "RestartSec") == "500ms"
    assert one(unit, "StartLimitIntervalSec") == "0"


def test_the_view_for_ros_reaches_no_ring_no_log_and_no_key(host: Path) -> None:
    unit = read_unit(host, "coop-ros2")
    assert words(unit, "InaccessiblePaths") == {"-/run/coop", "-/var/lib/coop", "-/etc/coop/keys"}
    assert not words(unit, "SupplementaryGroups")
    assert words(unit, "IPAddressAllow") == {"localhost"}
    assert one(unit, "User") not in {one(read_unit(host, n), "User") for n in SERVICES[:3]}


def test_the_log_begins_before_the_agent_and_ends_after_it(simulated_host: Path) -> None:
    after = {name: words(read_unit(simulated_host, name), "After") for name in SIMULATED}
    assert {"coop-telemetry@left.service", "coop-plant.service"} <= after["coop-agent@left"]
    assert {"coop-recorder.service", "coop-rings.service"} <= after["coop-telemetry@left"]
    assert "ssh.service" in after["coop-agent@left"], "a HOLD that delays a shutdown must leave a way in"


@pytest.mark.parametrize("name", SERVICES)
def test_every_unit_stops_with_the_cell(host: Path, name: str) -> None:
    assert "coop.target" in words(read_unit(host, name), "PartOf")


@pytest.mark.parametrize("name", sorted({*SERVICES, "coop-plant"} - {"coop-rings"}))
def test_a_unit_that_is_asked_to_end_before_it_has_begun_has_not_failed(simulated_host: Path, name: str) -> None:
    listens = name.startswith(("coop-recorder", "coop-telemetry"))  # rows that are missing are no failure
    assert one(read_unit(simulated_host, name), "SuccessExitStatus") == ("1 130" if listens else "130")


# Two units, one file


@pytest.mark.parametrize("choices", CHOICES.values(), ids=CHOICES)
def test_agent_and_telemetry_mean_the_same_ring(
    on: On, monkeypatch: pytest.MonkeyPatch, choices: tuple[str, ...]
) -> None:
    root = on(*choices)
    agent, telemetry = (read_unit(root, name) for name in ("coop-agent@left", "coop-telemetry@left"))
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"/run/{one(agent, 'RuntimeDirectory')}")
    rings = {_option(agent, "--ring"), _option(telemetry, "--ring")}
    assert rings == {str(ring_path("any", "left"))}
    assert one(agent, "RuntimeDirectoryPreserve") == "yes", "the ring is the black box"


@pytest.mark.parametrize(("choices", "name"), CASES)
def test_units_name_what_processes_meet_by_as_the_commands_do(on: On, choices: tuple[str, ...], name: str) -> None:
    root = on(*choices)
    left, plant = SERVICES_DIR / "left", SERVICES_DIR / "plant"
    known = {ring_in(left, "left"), control_in(left, "left"), guard_in(left, "left")}
    known |= {ring_in(plant, "plant"), plant_socket_in(plant)}
    (line,) = read_unit(root, name)["ExecStart"]
    found = {Path(word) for word in line.split() if Path(word).parent in (left, plant)}
    assert found <= known, found - known
    assert found or not name.startswith(("coop-agent", "coop-guard", "coop-telemetry", "coop-plant"))


def test_plant_and_agent_mean_the_same_socket(simulated_host: Path) -> None:
    plant, agent, telemetry = (
        read_unit(simulated_host, name) for name in ("coop-plant", "coop-agent@left", "coop-telemetry@plant")
    )
    assert _option(plant, "--socket") == _option(agent, "--plant-socket")
    assert _option(plant, "--ring") == _option(telemetry, "--ring")
    assert _option(plant, "--socket").startswith(f"/run/{one(plant, 'RuntimeDirectory')}/")
    assert one(plant, "User") == one(agent, "User"), "the plant serves nobody else"


def test_the_ring_is_shared_by_its_group_alone(host: Path) -> None:
    agent, telemetry, recorder = (
        read_unit(host, n) for n in ("coop-agent@left", "coop-telemetry@left", "coop-recorder")
    )
    assert one(agent, "Group") in words(telemetry, "SupplementaryGroups")
    assert one(agent, "UMask") == "0027"
    assert one(agent, "RuntimeDirectoryMode") == "0750"
    assert len({one(unit, "User") for unit in (agent, telemetry, recorder)}) == 3
    assert one(agent, "Group") not in words(recorder, "SupplementaryGroups") | words(recorder, "Group")


# The command line is the one `coop` has


@pytest.mark.parametrize(("choices", "name"), [case for case in CASES if "rings" not in case[1]])
def test_coop_understands_its_command_line(on: On, choices: tuple[str, ...], name: str) -> None:
    root = on(*choices)
    program, verb, *arguments = command(read_unit(root, name))
    assert program == "/opt/coop/bin/coop"
    group = whole()
    context = typer.Context(group)
    found = group.get_command(context, verb)  # type: ignore[attr-defined]
    assert found is not None, verb
    parsed = found.make_context(verb, arguments)  # raises UsageError for an unknown option or a bad value
    assert str(parsed.params["cell"]) == "/etc/coop/cell.toml"


def test_the_simulated_agent_differs_in_driver_and_priority(host: Path, on: On) -> None:
    root = on("simulated")
    real, simulated = (read_unit(where, "coop-agent@left") for where in (host, root))
    assert {key for key in real | simulated if real[key] != simulated[key]} == {
        "Requires", "After", "ExecStart", "WatchdogSec",
    }  # fmt: skip
    extra = ["--real-time", "--plant-socket", _option(simulated, "--plant-socket")]
    priority = ["--priority", _option(real, "--priority")]  # a desktop or a virtual machine need not grant it
    assert sorted(w for w in command(simulated) if w not in extra) == sorted(
        "sim" if w == "dynamixel" else w for w in command(real) if w not in priority
    )


def test_the_agent_of_a_rehearsal_has_a_plant_and_no_network_and_waits_for_a_persons_word(host: Path, on: On) -> None:
    root = on("rehearsal")
    real, rehearsing = (read_unit(where, "coop-agent@left") for where in (host, root))
    assert {key for key in real | rehearsing if real[key] != rehearsing[key]} == {
        "Requires", "After", "ExecStart", "ReadWritePaths",
    }  # fmt: skip
    assert "--driver" not in command(rehearsing), "[hil] of the cell says which arms are real"
    assert "--gripper-empty" not in command(rehearsing), "a unit is not a person"
    assert _option(rehearsing, "--gripper-word") == "/run/coop/gripper-empty/left"
    plant = read_unit(root, "coop-plant")
    assert _option(rehearsing, "--plant-socket") == _option(plant, "--socket")
    assert "sim" in command(read_unit(root, "coop-recorder"))


def test_the_agent_of_a_session_begins_at_rest_and_is_else_the_same(host: Path, on: On) -> None:
    root = on("session")
    real, rested = (read_unit(where, "coop-agent@left") for where in (host, root))
    assert {key for key in real | rested if real[key] != rested[key]} == {"Environment"}
    assert command(rested) == [*command(real), "--whole"]


@pytest.mark.parametrize("two", [("simulated", "rehearsal"), ("session", "simulated"), ("rehearsal", "session")])
def test_an_agent_is_of_one_kind(tmp_path: Path, two: tuple[str, str]) -> None:
    done = subprocess.run(
        ["sh", str(SYSTEMD / "install.sh"), *two],
        env=os.environ | {"DESTDIR": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, list(tmp_path.iterdir())) == (2, [])
    assert f"found '{two[0]}' and '{two[1]}', expected one of them" in done.stderr


def test_agents_load_beside_their_guards_and_plant_and_wait_for_both_no_longer_than_a_start_may_take(
    tmp_path: Path,
) -> None:
    for choice in ("simulated", "rehearsal"):
        install(tmp_path / choice, choice)
        agent, plant = (read_unit(tmp_path / choice, name) for name in ("coop-agent@left", "coop-plant"))
        assert 10.0 <= float(_option(agent, "--wait")) < float(one(agent, "TimeoutStartSec").removesuffix("s"))
        assert "ExecStartPost" not in plant, "nobody waits for the plant before it loads"


# Installing


def test_a_choice_that_is_left_out_is_taken_away_again(tmp_path: Path) -> None:
    install(tmp_path / "never")
    install(tmp_path / "then", "simulated", "several-hosts")
    install(tmp_path / "then", "rehearsal")
    install(tmp_path / "then", "session")
    install(tmp_path / "then")
    never, then = (
        {str(path.relative_to(root)) for path in (root / "etc/systemd").rglob("*") if path.is_file()}
        for root in (tmp_path / "never", tmp_path / "then")
    )
    assert never == then


@pytest.mark.parametrize(
    "path",
    [
        "etc/udev/rules.d/60-coop.rules",
        "etc/coop/zenoh/recorder.json5",
        "etc/systemd/system/coop-telemetry@.service.d/50-several-hosts.conf",
    ],
)
def test_what_was_filled_in_survives_an_update(tmp_path: Path, path: str) -> None:
    install(tmp_path, "several-hosts")
    (tmp_path / path).write_text("filled in")
    install(tmp_path, "several-hosts")
    assert (tmp_path / path).read_text() == "filled in"


ONCE = (
    ("udev/60-coop.rules", "etc/udev/rules.d/60-coop.rules"),
    ("several-hosts/zenoh/arm.json5", "etc/coop/zenoh/arm.json5"),
    (f"several-hosts/{AGENT_DROP_IN}", f"etc/systemd/system/{AGENT_DROP_IN}"),
)


def release(folder: Path, changed: str, line: str) -> Path:
    """Our units as another release has them, in which one file ends with this line."""
    shutil.copytree(SYSTEMD, folder)
    with (folder / changed).open("a") as file:
        file.write(line)
    return folder


@pytest.mark.parametrize(("ours", "path"), ONCE)
def test_what_an_earlier_release_installed_and_nobody_filled_in_is_replaced(
    tmp_path: Path, ours: str, path: str
) -> None:
    earlier, root = release(tmp_path / "earlier", ours, "# of before\n"), tmp_path / "host"
    install(root, "several-hosts", of=earlier)
    assert (root / path).read_text().endswith("# of before\n")
    assert f"replaced {root / path}: it was as an earlier release had installed it" in install(root, "several-hosts")
    assert (root / path).read_bytes() == (SYSTEMD / ours).read_bytes()
    assert install(root, "several-hosts") == ""


@pytest.mark.parametrize(("ours", "path"), ONCE)
@pytest.mark.parametrize("has_copy", [True, False])
def test_what_was_filled_in_under_an_earlier_release_stays_and_is_named_once(
    tmp_path: Path, ours: str, path: str, has_copy: bool
) -> None:
    """Also where that release kept no copy of what it installed, so that nobody knows whether it was filled in."""
    root = tmp_path / "host"
    install(root, "several-hosts", of=release(tmp_path / "earlier", ours, "# of before\n"))
    if has_copy:
        (root / path).write_text("filled in")
    else:
        shutil.rmtree(root / "etc/coop/.as-installed")
    before = (root / path).read_bytes()
    for _ in range(2):
        told = install(root, "several-hosts")
        assert (f"kept {root / path}: filled in on this host" in told) is (_ == 0)
        assert (f"diff {root / path} {SYSTEMD / ours}" in told) is (_ == 0)
        assert (root / path).read_bytes() == before


@pytest.mark.parametrize("without", [(), ("remove",)], ids=["choice left out", "removed"])
def test_a_drop_in_of_an_earlier_release_that_nobody_filled_in_goes_with_its_choice(
    tmp_path: Path, without: tuple[str, ...]
) -> None:
    root = tmp_path / "host"
    earlier = release(tmp_path / "earlier", f"several-hosts/{AGENT_DROP_IN}", "# of before\n")
    install(root, "several-hosts", of=earlier)
    assert "saved" not in install(root, *without)
    assert not list(root.rglob("*50-several-hosts.conf*"))


@pytest.mark.parametrize("without", [(), ("remove",)], ids=["choice left out", "removed"])
def test_addresses_that_were_filled_in_come_back_with_their_choice(tmp_path: Path, without: tuple[str, ...]) -> None:
    units, own = tmp_path / "etc/systemd/system", "50-several-hosts.conf"
    filled = units / "coop-telemetry@.service.d" / own
    install(tmp_path, "several-hosts")
    shipped = filled.read_text()
    filled.write_text(shipped.replace("192.0.2.10", "10.9.9.9"))
    for _ in range(2):
        install(tmp_path, *without)
        kept = {path.relative_to(units) for path in units.rglob(f"{own}*")}
        assert kept == {Path("coop-telemetry@.service.d", f"{own}.saved")}
    install(tmp_path, "several-hosts")
    assert filled.read_text() == shipped.replace("192.0.2.10", "10.9.9.9")
    assert list(units.rglob("*.saved")) == []


@pytest.mark.parametrize("choices", CHOICES.values(), ids=CHOICES)
def test_removing_takes_what_was_installed_and_keeps_what_was_filled_in(
    tmp_path: Path, choices: tuple[str, ...]
) -> None:
    install(tmp_path, *choices)
    units = tmp_path / "etc/systemd/system"
    mine = {units / "coop-agent@.service.d/mine.conf", units / "coop-of-mine.service", tmp_path / "etc/coop/cell.toml"}
    for path in mine:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    keys = {path for path in (tmp_path / "etc/coop").rglob("*") if path.is_file() and path.suffix != ".conf"}
    install(tmp_path, "remove")
    left = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert left == mine | keys | {tmp_path / "etc/udev/rules.d/60-coop.rules"}
    install(tmp_path, "remove")


def test_removing_goes_with_no_other_choice(tmp_path: Path) -> None:
    install(tmp_path)
    before = {path for path in tmp_path.rglob("*") if path.is_file()}
    command = ["sh", str(SYSTEMD / "install.sh"), "remove", "simulated"]
    done = subprocess.run(command, env=os.environ | {"DESTDIR": str(tmp_path)}, capture_output=True, text=True)
    assert (done.returncode, "expected it alone" in done.stderr) == (2, True)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == before


# udev


def test_the_rule_names_adapters_by_serial_number_and_takes_their_latency_away() -> None:
    rule = (SYSTEMD / "udev/60-coop.rules").read_text()
    lines = [line for line in rule.splitlines() if line and not line.startswith("#")]
    for line in lines:
        token = r'[A-Z_]+(\{[\w/]+\})?(==|!=|\+=|=)"[^"]*"'
        assert re.fullmatch(rf"{token}(, {token})*", line), line
    adapters = [line for line in lines if 'ATTRS{idProduct}=="6014"' in line]
    assert all('ATTRS{idVendor}=="0403"' in line for line in adapters)
    assert any('ATTR{device/latency_timer}="1"' in line and 'GROUP="dialout"' in line for line in adapters)
    named = re.findall(r'ATTRS\{serial\}=="\w+", SYMLINK\+="(coop/\w+)"', rule)
    assert named == ["coop/left", "coop/right"], "as in the shipped cell files"


def _option(unit: Unit, name: str) -> str:
    found = command(unit)
    return found[found.index(name) + 1]
