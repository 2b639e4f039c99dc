"""What every Driver promises, as tests for whoever has an arm: derive from `DriverContract` and give it a `rig`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.interface import BusCounters, Clock, ConnectError, Driver, DriverError, StaleStateError, Vector

CYCLES = 5


@dataclass
class Rig:
    """One arm on a bench.  The driver is not connected yet; the rig closes what it made."""

    driver: Driver
    clock: Callable[[], Clock]  # of the driver, once connected
    joints: tuple[str, ...]
    tau_small_Nm: Vector  # (n,) harmless on this bench
    another_driver: Callable[[], Driver]  # a second one for the same arm
    go_dark: Callable[[], None] | None  # cut the bus for good; None where that cannot be done


class DriverContract:
    """Tests of one driver; the class that derives has a fixture `rig`."""

    @pytest.fixture
    def enabled(self, rig: Rig) -> Rig:
        rig.driver.connect()
        rig.driver.enable()
        return rig

    def test_connect_describes_the_arm(self, rig: Rig) -> None:
        info = rig.driver.connect()
        assert info.joints == rig.joints
        assert info.tau_max_Nm.shape == (len(rig.joints),)
        assert np.all(info.tau_max_Nm > 0)
        assert info.arm
        assert info.description

    def test_second_driver_of_an_arm_is_refused_and_the_first_goes_on(self, rig: Rig) -> None:
        rig.driver.connect()
        other = rig.another_driver()
        with pytest.raises(ConnectError, match=r"found .+, expected .+; .+"):
            other.connect()
        other.close()
        assert np.all(np.isfinite(rig.driver.read().q))

    def test_state_can_be_read_before_torque_is_on(self, rig: Rig) -> None:
        rig.driver.connect()
        for _ in range(3):
            state = rig.driver.read()
            assert state.q.shape == state.dq.shape == state.tau.shape == (len(rig.joints),)
            assert np.all(np.isfinite(state.q))
            assert np.all(np.isfinite(state.dq))

    def test_every_cycle_brings_a_newer_state(self, enabled: Rig) -> None:
        stamps = []
        for _ in range(CYCLES):
            stamps.append(enabled.driver.read().stamp_ns)
            enabled.driver.write(enabled.tau_small_Nm)
        assert all(later > earlier for earlier, later in itertools.pairwise(stamps))

    def test_state_is_stamped_with_the_drivers_clock(self, enabled: Rig) -> None:
        for _ in range(CYCLES):
            before = enabled.clock().now_ns()
            stamp = enabled.driver.read().stamp_ns
            enabled.driver.write(enabled.tau_small_Nm)
            assert before - 1e9 < stamp <= enabled.clock().now_ns()

    def test_state_belongs_to_the_receiver(self, enabled: Rig) -> None:
        first = enabled.driver.read()
        kept = (first.q.copy(), first.dq.copy(), first.tau.copy())
        enabled.driver.write(enabled.tau_small_Nm)
        second = enabled.driver.read()
        second.q[:] += 1.0
        enabled.driver.write(enabled.tau_small_Nm)
        enabled.driver.read()
        for now, then in zip((first.q, first.dq, first.tau), kept, strict=True):
            np.testing.assert_array_equal(now, then)

    def test_write_returns_what_the_servos_are_told(self, enabled: Rig) -> None:
        enabled.driver.read()
        sent = enabled.driver.write(enabled.tau_small_Nm)
        assert sent.shape == enabled.tau_small_Nm.shape
        np.testing.assert_allclose(sent, enabled.tau_small_Nm, atol=0.1)
        enabled.driver.read()
        np.testing.assert_array_equal(enabled.driver.write(sent), sent)

    def test_write_does_not_touch_its_argument(self, enabled: Rig) -> None:
        tau = enabled.tau_small_Nm.copy()
        enabled.driver.read()
        sent = enabled.driver.write(tau)
        np.testing.assert_array_equal(tau, enabled.tau_small_Nm)
        sent += 1.0
        np.testing.assert_array_equal(tau, enabled.tau_small_Nm)

    def test_torque_that_is_not_finite_is_refused_and_a_good_one_still_passes(self, enabled: Rig) -> None:
        for bad in (math.nan, math.inf, -math.inf):
            enabled.driver.read()
            tau = enabled.tau_small_Nm.copy()
            tau[-1] = bad
            with pytest.raises(DriverError, match="finite"):
                enabled.driver.write(tau)
            assert np.all(np.isfinite(enabled.driver.write(enabled.tau_small_Nm)))

    def test_torque_before_enable_is_refused(self, rig: Rig) -> None:
        rig.driver.connect()
        rig.driver.read()
        with pytest.raises(DriverError, match="torque"):
            rig.driver.write(rig.tau_small_Nm)

    def test_torque_after_disable_is_refused_but_the_state_can_be_read(self, enabled: Rig) -> None:
        enabled.driver.read()
        enabled.driver.write(enabled.tau_small_Nm)
        enabled.driver.disable()
        assert np.all(np.isfinite(enabled.driver.read().q))
        with pytest.raises(DriverError, match="torque"):
            enabled.driver.write(enabled.tau_small_Nm)

    def test_torque_can_be_switched_on_again(self, enabled: Rig) -> None:
        for _ in range(2):
            enabled.driver.read()
            enabled.driver.write(enabled.tau_small_Nm)
            enabled.driver.disable()
            enabled.driver.enable()
        enabled.driver.read()
        enabled.driver.write(enabled.tau_small_Nm)

    def test_enable_twice_is_harmless(self, enabled: Rig) -> None:
        enabled.driver.enable()
        enabled.driver.read()
        enabled.driver.write(enabled.tau_small_Nm)
        enabled.driver.enable()
        enabled.driver.read()

    @pytest.mark.parametrize("call", ["enable", "read", "write"])
    @pytest.mark.parametrize("closed", [False, True], ids=["never connected", "closed"])
    def test_nothing_works_without_a_connection(self, rig: Rig, call: str, closed: bool) -> None:
        if closed:
            rig.driver.connect()
            rig.driver.close()
        arguments = (rig.tau_small_Nm,) if call == "write" else ()
        with pytest.raises(DriverError, match="connect"):
            getattr(rig.driver, call)(*arguments)

    @pytest.mark.parametrize("reached", ["made", "connected", "enabled", "running", "disabled", "closed"])
    def test_disable_and_close_are_safe_in_any_state_and_twice(self, rig: Rig, reached: str) -> None:
        steps: dict[str, Callable[[], object]] = {
            "made": lambda: None,
            "connected": rig.driver.connect,
            "enabled": rig.driver.enable,
            "running": lambda: (rig.driver.read(), rig.driver.write(rig.tau_small_Nm)),
            "disabled": rig.driver.disable,
            "closed": rig.driver.close,
        }
        for name, step in steps.items():
            step()
            if name == reached:
                break
        for last in (rig.driver.disable, rig.driver.disable, rig.driver.close, rig.driver.close, rig.driver.disable):
            last()

    def test_dead_bus_is_a_stale_state_and_leaving_it_is_safe(self, enabled: Rig) -> None:
        if enabled.go_dark is None:
            pytest.skip("this bench cannot cut its bus")
        enabled.driver.read()
        enabled.driver.write(enabled.tau_small_Nm)
        enabled.go_dark()
        with pytest.raises(StaleStateError, match=r"found .+, expected .+; .+"):
            _read_all_that_was_under_way(enabled.driver)
        for last in (enabled.driver.disable, enabled.driver.close, enabled.driver.disable, enabled.driver.close):
            last()

    def test_connecting_to_nothing_is_an_error_that_says_what_to_do(self, rig: Rig) -> None:
        if rig.go_dark is None:
            pytest.skip("this bench cannot cut its bus")
        rig.go_dark()
        with pytest.raises(ConnectError, match=r"found .+, expected .+; .+"):
            rig.driver.connect()

    def test_health_never_waits_and_has_one_entry_per_servo(self, enabled: Rig) -> None:
        health = enabled.driver.health()
        servos = len(health.servo_ids)
        assert servos == 0 or set(enabled.joints) <= set(health.joints), "none, or all of the arm's"
        arrays = (health.temperature_C, health.voltage_V, health.error_bits, health.current_A, health.load)
        assert {len(health.joints), *(len(array) for array in arrays)} == {servos}
        assert health.error_bits.dtype == np.uint8

    def test_counters_count_and_start_at_zero(self, enabled: Rig) -> None:
        assert isinstance(enabled.driver.counters, BusCounters)
        enabled.driver.read()
        enabled.driver.write(enabled.tau_small_Nm)
        assert enabled.driver.counters.corrupt == 0


def _read_all_that_was_under_way(driver: Driver) -> None:
    for _ in range(1000):
        driver.read()
