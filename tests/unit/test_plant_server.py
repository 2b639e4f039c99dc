"""Who may connect, when time passes, and what everyone is told at the end."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.interface import ConnectError, DriverError, StaleStateError
from sim_backend.actuator import DelayLine, TorqueCommand
from sim_backend.driver import SimDriver
from sim_backend.listener import Listener
from sim_backend.options import ArmVanished, LostArm
from sim_backend.plant import Observation, Plant
from sim_backend.protocol import Kind, header_only, words
from sim_backend.spec import PlantError
from tests.unit.plant_cells import PLANAR_JOINTS, planar_cell
from tests.unit.served_plant import CONFIG_ID, SERVOS, ServedPlant

TAU = np.array([0.3, -0.2, 0.1])


def cycle(drivers: list[SimDriver], count: int = 1) -> list[bytes]:
    """Run lockstep cycles with torques that depend on the state; every state as bytes."""
    seen = []
    for _ in range(count):
        states = [d.read() for d in drivers]
        for d, s in zip(drivers, states, strict=True):
            seen.append(s.q.tobytes() + s.dq.tobytes() + s.tau.tobytes())
            d.write(TAU - 0.5 * s.q - 0.05 * s.dq)
    return seen


@contextlib.contextmanager
def cycling(driver: SimDriver) -> Iterator[None]:
    """The driver runs its cycles in the background; in lockstep two arms cannot share a thread unless in step."""
    stop = threading.Event()

    def run() -> None:
        with contextlib.suppress(DriverError):
            while not stop.is_set():
                cycle([driver])

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        driver.disable()  # or it would wait for arms that have stopped
        thread.join(10.0)
        assert not thread.is_alive()


@pytest.mark.parametrize(
    ("arm", "settings", "message"),
    [
        ("middle", {}, r"refuses: arm: found middle, expected one of \['left', 'right'\]"),
        ("left", {"config_id": 1}, "cell of arm left: found 00000001, expected c0ffee42; .*the same cell file"),
        ("left", {"joints": PLANAR_JOINTS[::-1]}, "joints of arm left: found .*wrist_angle"),
    ],
)
def test_wrong_agent_is_refused_with_the_reason(
    tmp_path: Path, arm: str, settings: dict[str, object], message: str
) -> None:
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError, match=message):
        served.driver(arm, **settings).connect()


def test_occupied_arm_is_refused_while_the_run_goes_on(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        drivers = served.enabled()
        cycle(drivers, 3)
        with cycling(drivers[0]), cycling(drivers[1]), pytest.raises(ConnectError, match="already connected"):
            served.driver("right").connect()


def test_stranger_who_talks_nonsense_is_refused_and_does_no_harm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        for message in (b"x", b"\xff" * 300, header_only(Kind.STATE), words(Kind.HELLO, version=99, arm="left")):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as s:
                s.connect(os.fspath(served.path))
                s.send(message)
                assert b"plant protocol" in s.recv(4096)
        cycle(served.enabled(), 2)


def test_other_protocol_version_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_backend.driver.VERSION", 7)
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError, match="found version 7, expected 1"):
        served.driver().connect()


def test_time_does_not_pass_before_every_arm_is_enabled(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.driver("left"), served.driver("right")
        left.connect()
        right.connect()
        left.enable()
        before = right.read()
        time.sleep(0.05)
        after = right.read()
        assert (before.stamp_ns, after.stamp_ns) == (0, 0)
        assert served.plant.t == 0.0
        right.enable()
        assert left.read().stamp_ns == 0
        left.write(TAU)
        right.read()
        right.write(TAU)
        assert left.read().stamp_ns == 5_000_000


def test_time_waits_for_the_slowest_arm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.enabled()
        left.read()
        left.write(TAU)
        right.read()
        got: list[int] = []
        reader = threading.Thread(target=lambda: got.append(left.read().stamp_ns))
        reader.start()
        reader.join(0.1)
        assert reader.is_alive()
        right.write(TAU)
        reader.join(10.0)
        assert got == [5_000_000]


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_lockstep_gives_the_motion_of_the_plant_alone_bit_for_bit(tmp_path: Path, delay: int) -> None:
    servos = replace(SERVOS, delay_cycles=delay)
    with ServedPlant(tmp_path, servos=servos) as served:
        over_sockets = cycle(served.enabled(), 40)

    plant = Plant(planar_cell(servos))
    lines, command = [DelayLine(delay, 3) for _ in range(2)], TorqueCommand.of(servos)
    alone = []
    for tick in range(40):
        q, dq, tau = plant.reported()
        for part, line in zip(plant.slices, lines, strict=True):
            alone.append(q[part].tobytes() + dq[part].tobytes() + tau[part].tobytes())
            line.push(tick, command(TAU - 0.5 * q[part] - 0.05 * dq[part]))
        if tick < delay:
            plant.rest(5)
        else:
            plant.advance(np.concatenate([line.acting(tick) for line in lines]), 5)
    assert over_sockets == alone


def test_cell_rests_on_its_support_until_the_first_torque_has_come_through(tmp_path: Path) -> None:
    servos = replace(SERVOS, delay_cycles=2)
    for supported in (True, False):
        seen: list[Observation] = []
        with ServedPlant(
            tmp_path, servos=servos, supported_start=supported, on_tick=lambda _k, _t, o, s=seen: s.append(o)
        ) as served:
            cycle(served.enabled(), 5)
        speeds = [float(np.abs(o.dq).max()) for o in seen[:4]]
        assert (speeds[:3] == [0.0, 0.0, 0.0]) is supported
        assert speeds[3] > 0.0
        assert [o.t for o in seen[:4]] == pytest.approx([0.0, 0.005, 0.010, 0.015])


def test_observation_is_decimated_and_tells_the_tick(tmp_path: Path) -> None:
    ticks: list[tuple[int, float]] = []
    with ServedPlant(tmp_path, observe_every=4, on_tick=lambda k, t, _o: ticks.append((k, t))) as served:
        cycle(served.enabled(), 10)
    assert [k for k, _ in ticks[:3]] == [0, 4, 8]
    assert [t for _, t in ticks[:3]] == pytest.approx([0.0, 0.02, 0.04])


def test_run_ends_well_when_every_arm_has_said_goodbye(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        drivers = served.enabled()
        cycle(drivers, 20)
        for d in drivers:
            d.disable()
            d.close()
        served.join()
        assert served.error is None
        assert served.summary is not None
        assert 20 <= served.summary.ticks <= 21
        assert served.summary.sim_s == pytest.approx(served.summary.ticks / 200)
        assert served.summary.real_time_factor > 0
        assert not served.path.exists()


def test_arm_that_says_goodbye_early_leaves_the_others_running(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.enabled()
        cycle([left, right], 3)
        right.close()
        cycle([left], 20)
        with cycling(left), pytest.raises(ConnectError, match="an arm whose run is over"):
            served.driver("right").connect()
        left.close()
        served.join()
        assert served.error is None


def test_goodbye_before_the_start_frees_the_arm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        for _ in range(3):
            driver = served.driver("left")
            driver.connect()
            driver.enable()
            driver.close()
        cycle(served.enabled(), 2)


def test_disabled_arm_gets_no_torque_and_time_does_not_wait_for_it(tmp_path: Path) -> None:
    applied: list[np.ndarray] = []
    with ServedPlant(tmp_path, on_tick=lambda _k, _t, o: applied.append(o.tau_applied)) as served:
        left, right = served.enabled()
        cycle([left, right], 5)
        right.disable()
        cycle([left], 20)
        stamp = right.read().stamp_ns
        cycle([left], 5)
        assert right.read().stamp_ns >= stamp
    assert np.abs(applied[4][3:]).max() > 0.01
    assert np.abs(applied[-1][3:]).max() == 0.0
    assert np.abs(applied[-1][:3]).max() > 0.01


def test_read_without_a_write_keeps_the_last_torque_as_a_servo_does(tmp_path: Path) -> None:
    applied: list[np.ndarray] = []
    with ServedPlant(tmp_path, names=("left",), on_tick=lambda _k, _t, o: applied.append(o.tau_applied)) as served:
        (left,) = served.enabled()
        left.read()
        left.write(np.array([0.2, 0.0, 0.0]))
        stamps = [left.read().stamp_ns for _ in range(4)]
    assert stamps == [5_000_000, 10_000_000, 15_000_000, 20_000_000]
    assert [round(float(a[0]), 3) for a in applied[:4]] == [0.0, 0.2, 0.2, 0.2]


def test_second_torque_in_a_tick_is_refused(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        left.read()
        left.write(TAU)
        with pytest.raises(DriverError, match="no state read since the last torque"):
            left.write(TAU)
        left.read()
        left.write(TAU)


def test_arm_that_vanishes_ends_the_run_and_is_named_to_everyone(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.enabled()
        cycle([left, right], 7)
        right._link.close()  # as the kernel does for a killed process
        with pytest.raises(StaleStateError, match=r"arm right vanished at tick [78]"):
            cycle([left], 5)
        with pytest.raises(DriverError, match="arm right vanished"):
            left.read()
        served.join()
        assert isinstance(served.error, ArmVanished)
        assert served.error.arm == "right"
        assert served.error.tick in (7, 8)
        assert not served.path.exists()


def test_arm_that_vanishes_before_the_start_is_named(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left = served.driver("left")
        left.connect()
        left.enable()
        left._link.close()
        served.join()
        assert isinstance(served.error, ArmVanished)
        assert (served.error.arm, served.error.tick) == ("left", 0)


def test_lost_arm_may_go_limp_and_come_back(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, lost_arm=LostArm.GO_LIMP) as served:
        left, right = served.enabled()
        cycle([left, right], 5)
        right._link.close()
        cycle([left], 5)
        guard = served.driver("right")
        with cycling(left):
            guard.connect()
            guard.enable()
            cycle([guard], 5)
            guard.disable()
        for d in (left, guard):
            d.close()
        served.join()
        assert served.summary is not None
        assert served.summary.lost_arms == ("right",)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_torque_that_is_not_finite_on_the_wire_ends_the_run(tmp_path: Path, bad: float) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        left.read()
        left._command = lambda tau: tau  # a client without the check
        left.write(np.array([0.0, bad, 0.0]))
        served.join()
        assert isinstance(served.error, ArmVanished)
        assert "it commanded" in str(served.error)


def test_answer_to_another_tick_ends_the_run(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        left.read()
        left._out.header[1] = 41
        left.write(TAU)
        served.join()
        assert "it answered tick 41 instead of 0" in str(served.error)


def test_stopped_plant_says_so(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.enabled()
        cycle([left, right], 3)
        served.stop()
        with pytest.raises(StaleStateError, match="the run is over: found the plant ended at tick"):
            cycle([left], 3)
        assert served.summary is not None


def test_plant_stops_before_the_start_and_while_an_arm_thinks(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        served.driver("left").connect()
        served.stop()
        assert served.summary is not None
        assert served.summary.ticks == 0
    with ServedPlant(tmp_path) as served:
        served.enabled()[0].read()
        served.stop()
        assert served.summary is not None


def test_plant_ends_after_its_ticks(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, ticks=6) as served:
        drivers = served.enabled()
        assert len(cycle(drivers, 6)) == 12
        with pytest.raises(StaleStateError, match="expected a run of 6 ticks"):
            drivers[0].read()
        served.join()
        assert served.summary is not None
        assert served.summary.ticks == 6


def command_absurdly(drivers: list[SimDriver]) -> None:
    for _ in range(10):
        for d in drivers:
            d.read()
            d.write(np.full(3, 1e190))


def test_unstable_motion_is_told_to_the_agents(tmp_path: Path) -> None:
    servos = replace(SERVOS, tau_max_Nm=np.full(3, 1e200), stall_Nm=np.full(3, 1e200))
    with ServedPlant(tmp_path, servos=servos) as served:
        left, right = served.enabled()
        with pytest.raises(DriverError, match="the motion of the plant"):
            command_absurdly([left, right])
        served.join()
        assert isinstance(served.error, PlantError)


def test_silent_plant_is_a_timeout_that_names_it(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left = served.driver("left", start_timeout_s=0.05)
        left.connect()
        left.enable()
        with pytest.raises(StaleStateError, match=r"plant at .*plant\.sock, arm left: found no state within 0\.05 s"):
            left.read()
        assert left.counters.timeouts == 1


def test_rate_without_a_whole_number_of_substeps_is_refused(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, rate_hz=120.0) as served:
        served.join()
        assert isinstance(served.error, PlantError)
        assert "use 0.000925925925926 s" in str(served.error)
        assert not served.path.exists()


def test_real_time_keeps_the_pace_and_the_last_torque(tmp_path: Path) -> None:
    applied: list[float] = []
    with ServedPlant(
        tmp_path,
        names=("left",),
        lockstep=False,
        on_tick=lambda _k, _t, o: applied.append(float(o.tau_applied[0])),
    ) as served:
        (left,) = served.enabled()
        first = left.read()
        left.write(np.array([0.2, 0.0, 0.0]))
        time.sleep(0.1)
        later = left.read()
        assert abs(later.stamp_ns - time.monotonic_ns()) < 5e9
        elapsed_ticks = (later.stamp_ns - first.stamp_ns) / 5e6
        assert elapsed_ticks >= 10  # the states in between were skipped, not queued
        assert elapsed_ticks == pytest.approx(round(elapsed_ticks), abs=1e-3)
        left.close()
        served.join()
    assert applied.count(0.2) >= 10
    assert served.summary is not None
    assert served.summary.ticks >= elapsed_ticks


def test_real_time_goes_on_without_a_disabled_arm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, lockstep=False) as served:
        left, right = served.enabled()
        left.read()
        right.read()
        right.disable()
        stamps = [left.read().stamp_ns for _ in range(3)]
        assert stamps == sorted(set(stamps))
        assert np.all(np.isfinite(right.read().q))


def test_agent_that_does_not_fetch_its_states_loses_them_and_nothing_else(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, lockstep=False, rate_hz=1000.0) as served:
        left, right = served.enabled()
        right._link._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        deadline = time.monotonic() + 10.0
        while served._thread.is_alive() and time.monotonic() < deadline:
            left.read()
            if served.plant.t > 0.5:
                break
        newest = right.read()
        assert newest.stamp_ns > 0
        for d in (left, right):
            d.close()
        served.join()
        assert served.error is None


def test_socket_is_for_this_user_only_and_gone_afterwards(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        mode = served.path.stat().st_mode
        assert stat.S_ISSOCK(mode)
        assert stat.S_IMODE(mode) == 0o600
    assert not served.path.exists()


def test_living_plant_keeps_its_place(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        with pytest.raises(PlantError, match=r"another plant answers at .*; stop that run"):
            Listener(served.path)
        cycle(served.enabled(), 2)


def test_dead_socket_is_replaced_and_a_file_is_not(tmp_path: Path) -> None:
    path = tmp_path / "plant.sock"
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    dead.bind(os.fspath(path))
    dead.close()
    with Listener(path):
        assert stat.S_ISSOCK(path.stat().st_mode)
    path.write_text("important")
    with pytest.raises(PlantError, match="is not a socket"):
        Listener(path)
    assert path.read_text() == "important"


def test_path_that_a_socket_cannot_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match="at most 107 bytes"):
        Listener(tmp_path / ("x" * 120))
    with pytest.raises(PlantError, match="a path to listen on"):
        Listener(tmp_path / "no" / "such" / "directory")


def test_successor_keeps_its_socket_when_the_old_plant_leaves(tmp_path: Path) -> None:
    path = tmp_path / "plant.sock"
    with Listener(path):
        path.unlink()
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as successor:
            successor.bind(os.fspath(path))
            inode = path.stat().st_ino
    assert path.stat().st_ino == inode


def test_refusal_of_another_id_shows_both_as_fingerprints(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError) as caught:
        served.driver(config_id=CONFIG_ID - 1).connect()
    assert (caught.value.found, caught.value.expected) == ("c0ffee41", "c0ffee42")


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"abc", "3 bytes that mean nothing"),
        (header_only(Kind.COMMAND), "a command of 24 bytes instead of 48"),
        (header_only(Kind.HELLO), "it said HELLO out of turn"),
        (b"\x63" + bytes(47), "an unknown message, kind 99"),
    ],
)
@pytest.mark.parametrize("running", [False, True], ids=["torque off", "running"])
def test_arm_that_talks_nonsense_ends_the_run_with_the_reason(
    tmp_path: Path, message: bytes, reason: str, running: bool
) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        cycle([left], 3)
        if not running:
            left.disable()
        assert left._link is not None
        left._link.send(message)
        served.join()
        assert isinstance(served.error, ArmVanished)
        assert reason in str(served.error)


@pytest.mark.parametrize("answer", [b"", b"hello", header_only(Kind.STATE), words(Kind.INFO, lockstep=True)])
def test_server_that_is_no_plant_is_refused(tmp_path: Path, answer: bytes) -> None:
    path = tmp_path / "other.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as other:
        other.bind(os.fspath(path))
        other.listen()

        def serve_nonsense() -> None:
            with other.accept()[0] as connection:
                connection.recv(4096)
                connection.send(answer)

        thread = threading.Thread(target=serve_nonsense)
        thread.start()
        with pytest.raises(ConnectError, match="expected an introduction; check what serves that socket"):
            SimDriver(path, "left", PLANAR_JOINTS, CONFIG_ID).connect()
        thread.join()


def test_state_of_the_wrong_size_is_counted_and_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        assert left._link is not None
        monkeypatch.setattr(left._link, "_state_size", 8)
        with pytest.raises(StaleStateError, match="a state of 96 bytes"):
            left.read()
        assert left.counters.corrupt == 1


def test_visitor_who_says_nothing_is_shown_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_backend.lobby.INTRODUCTION_S", 0.0)
    with ServedPlant(tmp_path) as served, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as silent:
        silent.connect(os.fspath(served.path))
        silent.settimeout(10.0)
        assert silent.recv(10) == b""


def test_visitor_who_only_looks_does_no_harm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        for _ in range(3):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as s:
                s.connect(os.fspath(served.path))
        cycle(served.enabled(), 2)


def test_another_users_process_is_shown_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_backend.lobby.peer_uid", lambda _: os.geteuid() + 1)
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError, match="run plant and agents as the same user"):
        served.driver().connect()


def test_torque_for_a_plant_that_has_gone_tells_why(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        left.read()
        served.stop()
        with pytest.raises(DriverError, match="the run is over"):
            left.write(TAU)


def test_driver_connects_once(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left = served.driver()
        left.connect()
        with pytest.raises(ConnectError, match="found an open connection"):
            left.connect()


def test_clock_in_lockstep_stands_at_the_last_state_and_never_sleeps(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        left = served.driver()
        assert left.clock.now_ns() == 0
        left.connect()
        left.enable()
        cycle([left], 3)
        assert left.clock.now_ns() == 10_000_000
        left.clock.sleep_until(10**18)
        assert left.clock.now_ns() == 10_000_000


def test_clock_in_real_time_is_monotonic_time(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, names=("left",), lockstep=False) as served:
        left = served.driver()
        left.connect()
        deadline_ns = left.clock.now_ns() + 2_000_000
        left.clock.sleep_until(deadline_ns)
        assert time.monotonic_ns() >= deadline_ns
        left.clock.sleep_until(0)
