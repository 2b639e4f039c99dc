"""How a run ends, and what everyone is told."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.process.build import wait_no_longer
from agent.telemetry.ring.writer import RingWriter, RowsUntaken
from agent.telemetry.row.sample import AGENT_STATE
from drivers.interface import ConnectError, DriverError, StaleStateError, WaitEnded
from sim_backend.physics.spec import PlantError
from sim_backend.served.driver import SimDriver
from sim_backend.served.options import ArmVanished, LostArm
from sim_backend.served.protocol import MessageKind, header_only
from tests.support.plant.served_plant import SERVOS, TAU, ServedPlant, cycle, cycling


def command_absurdly(drivers: list[SimDriver]) -> None:
    for _ in range(10):
        for d in drivers:
            d.read()
            d.write(np.full(3, 1e190))


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


def test_arm_that_vanishes_ends_the_run_and_is_named_to_everyone(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.enabled()
        cycle([left, right], 7)
        right._link.close()  # as the kernel does for a killed process
        with pytest.raises(DriverError, match=r"arm right vanished at tick [78]"):
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
        left._out.head(MessageKind.COMMAND, 41, 0)
        left.write(TAU)
        served.join()
        assert "it answered tick 41 instead of 0" in str(served.error)


def test_stopped_plant_says_so(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.enabled()
        cycle([left, right], 3)
        served.stop()
        with pytest.raises(DriverError, match="the run is over: found the plant ended at tick"):
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


def test_an_arm_that_is_asked_for_something_waits_for_no_state_and_goes_on_with_the_next(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.driver("left"), served.driver("right")
        for driver in (left, right):
            driver.connect()
        left.enable()
        looks = iter((False, True))
        left.heed(lambda: next(looks))
        with pytest.raises(WaitEnded, match=r"arm left: found no state yet"):
            left.read()
        assert left.counters.timeouts == 0
        left.heed(lambda: True)
        right.enable()
        while True:
            with contextlib.suppress(WaitEnded):
                left.read()
                break
        left.write(TAU)


def test_rows_of_an_arm_wait_for_nobody_once_it_is_asked_for_something_or_its_plant_is_gone(tmp_path: Path) -> None:
    pressed = [False]
    with RingWriter(tmp_path / "left.ring", AGENT_STATE, "left", slots=64) as ring:
        for _ in range(32):
            ring.commit()
        with ServedPlant(tmp_path) as served:
            left = served.driver("left")
            left.connect()
            wait_no_longer(left, ring, lambda: pressed[0])
            with pytest.raises(RowsUntaken):
                ring.wait_for_space(0.1)
            pressed[0] = True
            ring.wait_for_space(60.0)
            pressed[0] = False
            assert not left.gone
        assert left.gone
        ring.wait_for_space(60.0)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"abc", "3 bytes that mean nothing"),
        (header_only(MessageKind.COMMAND), "a command of 24 bytes instead of 48"),
        (header_only(MessageKind.HELLO), "it said HELLO out of turn"),
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


def test_state_of_the_wrong_size_is_counted_and_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        assert left._link is not None
        monkeypatch.setattr(left._link, "_state_size", 8)
        with pytest.raises(StaleStateError, match="a message of kind 9 and 96 bytes"):
            left.read()
        assert left.counters.corrupt == 1


def test_torque_for_a_plant_that_has_gone_tells_why(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, names=("left",)) as served:
        (left,) = served.enabled()
        left.read()
        served.stop()
        with pytest.raises(DriverError, match="the run is over"):
            left.write(TAU)
