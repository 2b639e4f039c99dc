"""When the plant's time passes, and which torque acts."""

from __future__ import annotations

import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.interface import DriverError
from sim_backend.physics.actuator import ActuatorSpec, TorqueCommand
from sim_backend.physics.calendar import Limpness
from sim_backend.physics.delay import DelayLine, stretches
from sim_backend.physics.plant import Plant
from sim_backend.physics.snapshot import Observation
from sim_backend.physics.spec import PlantError
from sim_backend.served.driver import SimDriver
from tests.support.plant.plant_cells import planar_cell
from tests.support.plant.served_plant import SERVOS, TAU, ServedPlant, cycle


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


@pytest.mark.parametrize(("delay", "ahead"), [(0, 0), (1, 1), (2, 1)])
def test_time_waits_for_the_slowest_arm(tmp_path: Path, delay: int, ahead: int) -> None:
    """Where a torque acts a cycle late, the next state is known without it; the one behind that is not."""
    with ServedPlant(tmp_path, servos=replace(SERVOS, delay_s=delay * 5e-3)) as served:
        left, right = served.enabled()
        for tick in range(ahead + 1):
            assert left.read().stamp_ns == tick * 5_000_000
            left.write(TAU)
        right.read()
        got: list[int] = []
        reader = threading.Thread(target=lambda: got.append(left.read().stamp_ns))
        reader.start()
        reader.join(0.1)
        assert reader.is_alive()
        right.write(TAU)
        reader.join(10.0)
        assert got == [(ahead + 1) * 5_000_000]


def test_the_plant_goes_on_as_far_as_the_torques_are_known(tmp_path: Path) -> None:
    """A torque that acts 3 ms after its sample: 3 ms of the period pass before anybody has answered."""
    with ServedPlant(tmp_path, servos=replace(SERVOS, delay_s=0.003)) as served:
        left, right = served.enabled()
        cycle([left, right], 3)
        left.read()
        left.write(TAU)
        right.read()
        deadline = time.monotonic() + 10.0
        while served.plant.t < 0.0179 and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.02)
        assert served.plant.t == pytest.approx(0.018)
        right.write(TAU)
        assert left.read().stamp_ns == 20_000_000


def stamps_ns(arm: SimDriver, cycles: int) -> list[int]:
    stamps = []
    for _ in range(cycles):
        stamps.append(arm.read().stamp_ns)
        arm.write(TAU)
    return stamps


def test_an_arm_that_comes_back_gets_the_present_state_and_nobody_gets_one_twice(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left, right = served.enabled()
        cycle([left, right], 3)
        right.disable()
        cycle([left], 4)
        right.enable()
        # an arm waits for nobody: it may be enabled while the plant waits for the left one's answer
        with ThreadPoolExecutor() as both:
            lefts, rights = both.map(lambda arm: stamps_ns(arm, 4), (left, right))
        assert np.diff(lefts).tolist() == np.diff(rights).tolist() == [5_000_000] * 3
        assert abs(rights[0] - lefts[0]) <= 5_000_000


@pytest.mark.parametrize("delay", [0, 1])
def test_a_run_of_so_many_ticks_gives_so_many_states(tmp_path: Path, delay: int) -> None:
    with ServedPlant(tmp_path, names=("left",), servos=replace(SERVOS, delay_s=delay * 5e-3), ticks=3) as served:
        (left,) = served.enabled()
        cycle([left], 3)
        with pytest.raises(DriverError, match="expected a run of 3 ticks"):
            cycle([left], 1)
        served.join()
        assert served.summary is not None
        assert served.summary.ticks == 3


@pytest.mark.parametrize("delay_s", [0.0, 5e-3])
def test_the_state_of_the_moment_carries_the_stamp_of_that_moment(tmp_path: Path, delay_s: float) -> None:
    true: dict[int, bytes] = {}

    def note(_tick: int, stamp_ns: int, seen: Observation) -> None:
        true[stamp_ns] = seen.q[3:].tobytes()

    with ServedPlant(tmp_path, servos=ActuatorSpec.of(3, delay_s=delay_s), on_tick=note) as served:
        left, right = served.enabled()
        cycle([left, right], 5)
        right.disable()
        asked = []
        for _ in range(4):
            cycle([left], 1)
            time.sleep(0.02)  # by now the plant has gone on as far as it can without the left arm
            asked.append(right.read())
        cycle([left], 3)  # until the last instant asked for has been noted
    assert len({s.stamp_ns for s in asked}) > 1
    for state in asked:
        assert state.q.tobytes() == true[state.stamp_ns]


@pytest.mark.parametrize("delay_ms", [0.0, 1.0, 3.3, 5.0, 7.5, 10.0])
def test_lockstep_gives_the_motion_of_the_plant_alone_bit_for_bit(tmp_path: Path, delay_ms: float) -> None:
    servos = replace(SERVOS, delay_s=delay_ms * 1e-3)
    with ServedPlant(tmp_path, servos=servos) as served:
        over_sockets = cycle(served.enabled(), 40)

    plant = Plant(planar_cell(servos))
    line, command = DelayLine(servos.delay_s, 1e-3, 5, 6), TorqueCommand.of(servos)
    alone = []
    for tick in range(40):
        q, dq, tau = plant.reported()
        sent = []
        for part in plant.slices:
            alone.append(q[part].tobytes() + dq[part].tobytes() + tau[part].tobytes())
            sent.append(command(TAU - 0.5 * q[part] - 0.05 * dq[part]))
        line.push(tick, np.concatenate(sent))
        for substep, count in stretches([line], 5):
            if tick * 5 + substep < np.ceil(delay_ms):
                plant.rest(count)
            else:
                plant.advance(line.acting(tick, substep), count)
    assert over_sockets == alone


@pytest.mark.parametrize(
    ("delay_ms", "first", "second"), [(0.0, 1.0, 1.0), (2.0, 0.6, 1.0), (2.5, 0.5, 1.0), (6.0, 0.0, 0.8)]
)
def test_a_torque_acts_from_its_delay_after_the_sample_on(
    tmp_path: Path, delay_ms: float, first: float, second: float
) -> None:
    """A step of torque on one arm without gravity or friction: the share of the first two periods in which it acted."""
    free = ActuatorSpec.of(3, delay_s=delay_ms * 1e-3)
    spec = replace(planar_cell(free, names=("left",)), gravity=np.zeros(3))
    with ServedPlant(tmp_path, names=("left",), spec=spec, supported_start=False) as served:
        (left,) = served.enabled()
        speeds = []
        for _ in range(3):
            speeds.append(left.read().dq.copy())
            left.write(np.array([1e-3, 0.0, 0.0]))
    whole = Plant(spec)
    whole.advance(np.array([1e-3, 0.0, 0.0]), 5)
    per_period = whole.dq[0]
    assert speeds[1][0] == pytest.approx(first * per_period, rel=1e-3, abs=1e-9)
    assert speeds[2][0] - speeds[1][0] == pytest.approx(second * per_period, rel=1e-3)


def test_cell_rests_on_its_support_until_the_first_torque_has_come_through(tmp_path: Path) -> None:
    servos = replace(SERVOS, delay_s=0.01)
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


def test_observation_is_decimated_and_tells_tick_and_stamp(tmp_path: Path) -> None:
    ticks: list[tuple[int, int]] = []
    with ServedPlant(tmp_path, observe_every=4, on_tick=lambda k, stamp_ns, _o: ticks.append((k, stamp_ns))) as served:
        cycle(served.enabled(), 10)
    assert ticks[:3] == [(0, 0), (4, 20_000_000), (8, 40_000_000)]


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
        deadline = time.monotonic() + 10.0
        while applied.count(0.2) < 12:  # however long a machine that stalls takes for it
            assert time.monotonic() < deadline
            time.sleep(0.001)
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


@pytest.mark.parametrize("delay", [0, 1])
def test_a_limp_arm_is_told_no_torque_from_its_cycle_on_whatever_its_agent_says(tmp_path: Path, delay: int) -> None:
    applied: list[np.ndarray] = []
    spec = planar_cell(ActuatorSpec.of(3, delay_s=delay * 5e-3))
    spec = replace(spec, happenings=(Limpness(0.015, "right"),))
    with ServedPlant(tmp_path, spec=spec, on_tick=lambda _k, _t, o: applied.append(o.tau_applied)) as served:
        left, right = served.enabled()
        for _ in range(8):
            for arm in (left, right):
                arm.read()
                assert np.array_equal(arm.write(TAU), TAU)
    acts = [bool(tau[3:].any()) for tau in applied[:7]]
    assert acts == [delay <= tick < 3 + delay for tick in range(7)]
    assert all(tau[:3].any() for tau in applied[delay:8])
