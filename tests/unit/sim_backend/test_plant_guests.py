"""Real arms' twins at the plant: what they are told, and what becomes of them when their agent has gone."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from drivers.interface import ConnectError
from sim_backend.hil.coupling import TwinState
from sim_backend.hil.guest import ServedTwin
from sim_backend.served.link import INFO_KEYS
from sim_backend.served.protocol import MessageKind, words
from tests.support.plant.plant_cells import PLANAR_JOINTS
from tests.support.plant.served_plant import CONFIG_ID, TAU, ServedPlant

WATCHDOG_S = 0.1


def guest(served: ServedPlant, arm: str = "left", config_id: int = CONFIG_ID) -> ServedTwin:
    return ServedTwin(served.path, arm, PLANAR_JOINTS, config_id, WATCHDOG_S)


def until(found: Callable[[], TwinState | None]) -> TwinState:
    """The next state; time enough for a machine that stalls."""
    deadline_s = time.monotonic() + 10.0
    while (state := found()) is None:
        assert time.monotonic() < deadline_s, "no state"
        time.sleep(0.001)
    return state


def test_a_guest_is_refused_where_time_waits_for_answers(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError, match=r"in lockstep.*--real-time"):
        guest(served).connect()


def test_a_guest_of_another_cell_is_refused_and_so_is_a_plant_that_is_not_there(tmp_path: Path) -> None:
    with (
        ServedPlant(tmp_path, lockstep=False) as served,
        pytest.raises(ConnectError, match="cell of arm left: found 00000001"),
    ):
        guest(served, config_id=1).connect()
    with pytest.raises(ConnectError, match=r"found No such file.*start the plant of this cell first"):
        guest(served).connect()
    served.path = tmp_path / ("x" * 150)
    with pytest.raises(ConnectError, match="found AF_UNIX path too long"):
        guest(served).connect()


def test_a_guest_is_told_true_motion_and_its_grasps_torque_and_waits_for_nothing(tmp_path: Path) -> None:
    with ServedPlant(tmp_path, lockstep=False) as served:
        twin, partner = guest(served), served.driver("right")
        assert "simulated plant" in twin.connect()
        partner.connect()
        twin.enable()
        assert twin.newest() is None, "the plant has not started, and nobody waits for it"
        partner.enable()
        twin.command(TAU, 0.5 * TAU)
        states = [until(twin.newest) for _ in range(40)]
        assert [s.stamp_ns for s in states] == sorted({s.stamp_ns for s in states})
        assert max(float(np.abs(s.grasp).max()) for s in states) > 0.01, "the object pulls"
        lsb = served.spec.arms[0].actuator.position_lsb_rad
        assert np.abs(np.rint(states[-1].q / lsb) * lsb - states[-1].q).max() > 1e-9, "not as an encoder counts"
        told = [s.grasp / served.spec.arms[0].actuator.torque_lsb_Nm for s in states]
        assert max(float(np.abs(np.rint(t) - t).max()) for t in told) > 1e-3, "not as a current is counted"
        twin.close()
        assert twin.newest() is None


class Told:
    """A connection on which three states have come since anybody looked."""

    def __init__(self) -> None:
        self.stamp_ns, self.q, self.dq, self.grasp = 0, np.zeros(3), np.zeros(3), np.zeros(3)

    def receive(self, flags: int) -> MessageKind | None:
        assert flags == socket.MSG_DONTWAIT
        self.stamp_ns += 5
        self.q[:], self.dq[:], self.grasp[:] = self.stamp_ns, -self.stamp_ns, 0.1 * self.stamp_ns
        return MessageKind.STATE if self.stamp_ns <= 15 else None

    say_and_forget, close = staticmethod(lambda _: None), staticmethod(lambda: None)


def test_of_states_that_came_together_the_last_counts_and_what_pulled_over_all_of_them(tmp_path: Path) -> None:
    twin = ServedTwin(tmp_path, "left", PLANAR_JOINTS, CONFIG_ID, WATCHDOG_S)
    twin._link = Told()  # type: ignore[assignment]
    state = twin.newest()
    assert state is not None
    assert (state.stamp_ns, state.q.tolist(), state.dq.tolist()) == (15, [15.0] * 3, [-15.0] * 3)
    np.testing.assert_allclose(state.grasp, 1.5)
    np.testing.assert_allclose(state.pulled, 1.0)
    assert twin.newest() is None


def fills_up(twin: ServedTwin) -> int:
    """After how many torques a twin has ended."""
    for told in range(100_000):
        if twin.ended is not None:
            return told
        twin.command(TAU, TAU)
    raise AssertionError("a queue without an end")


@pytest.mark.timeout(60)  # who waits does so for ever here
def test_a_plant_that_hangs_ends_a_twin_and_lets_no_real_arm_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim_backend.hil.guest.CONNECT_TIMEOUT_S", 1e6)
    path = tmp_path / "plant.sock"
    info = dict.fromkeys(INFO_KEYS, 0) | {"description": "a plant that hangs"}
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as plant, ThreadPoolExecutor(1) as beside:
        plant.bind(str(path))
        plant.listen()
        twin = ServedTwin(path, "left", PLANAR_JOINTS, CONFIG_ID, WATCHDOG_S)
        connecting = beside.submit(twin.connect)
        connection, _ = plant.accept()
        with connection:
            connection.recv(4096)
            connection.send(words(MessageKind.INFO, **info))
            assert connecting.result() == "a plant that hangs"
            twin.enable()
            assert fills_up(twin) > 100, "a plant that pauses is not one that hangs"
            assert "one that reads nothing any more" in str(twin.ended)
            assert twin.newest() is None
            twin.ended = None
            twin.enable()
            assert "one that reads nothing any more" in str(twin.ended), "nor with this word"
            twin.close()


def test_a_guest_that_vanishes_keeps_its_torque_for_its_watchdog_and_the_others_go_on(tmp_path: Path) -> None:
    applied: list[tuple[int, float]] = []
    with ServedPlant(
        tmp_path, lockstep=False, on_tick=lambda tick, _, seen: applied.append((tick, float(seen.tau_applied[0])))
    ) as served:
        twin, partner = guest(served), served.driver("right")
        twin.connect()
        partner.connect()
        twin.enable()
        partner.enable()
        for _ in range(20):
            until(twin.newest)
            twin.command(TAU, 0.5 * TAU)
        assert twin._link is not None
        gone = applied[-1][0]
        twin._link.close()  # as a process that is killed: without a word
        while applied[-1][0] < gone + 100:
            partner.read()
            partner.write(-TAU)
    torque = dict(applied)
    kept = [tick for tick in torque if tick > gone and torque[tick] != 0.0]
    assert max(kept) - gone >= 0.1 * 200, "the watchdog's time, and the delay"
    assert torque[max(kept)] == pytest.approx(0.5 * TAU[0], rel=0.02), "what lasts of it"
    assert torque[max(torque)] == 0.0
    assert served.error is None
    assert served.summary is not None
    assert served.summary.lost_arms == ("left",)


def test_a_guest_that_lets_go_is_limp_at_once(tmp_path: Path) -> None:
    applied: list[float] = []
    with ServedPlant(tmp_path, lockstep=False, on_tick=lambda *a: applied.append(float(a[2].tau_applied[0]))) as served:
        twin, partner = guest(served), served.driver("right")
        twin.connect()
        partner.connect()
        twin.enable()
        partner.enable()
        for _ in range(10):
            until(twin.newest)
            twin.command(TAU, 0.5 * TAU)
        assert applied[-1] != 0.0
        twin.limp()
        twin.command(TAU, 0.5 * TAU)
        for _ in range(10):
            partner.read()
            partner.write(-TAU)
        assert applied[-1] == 0.0
        twin.close()
