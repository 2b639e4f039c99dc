"""The bridge as a driver: what it passes on, and when it gives the twin up."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from drivers.interface import (
    ArmInfo,
    BusCounters,
    ConnectError,
    DriverError,
    JointState,
    Refusal,
    ServoFault,
    ServoHealth,
    StaleStateError,
    Vector,
)
from sim_backend.hil.coupling import Here, Settings, TwinState
from sim_backend.hil.driver import BridgeDriver, Patience
from sim_backend.hil.errors import HilFault
from sim_backend.hil.gripper import Carried, GripperCheck
from sim_backend.hil.touch import Borne

T_NS = 5_000_000
LIMIT = np.array([2.0, 2.0])
PATIENCE = Patience(stale_s=0.016, watchdog_s=0.2, start_s=1.0)
TAU = np.array([0.5, -0.4])


def refusal(kind: type[Refusal]) -> Refusal:
    return kind("arm", found="nothing", expected="a state", remedy="look")


@dataclass
class Rig:
    """A clock, an arm, its twin; each says what it was asked, in order."""

    ns: int = 1_000_000_000
    failure: Refusal | None = None
    q: Vector = field(default_factory=lambda: np.zeros(2))
    told: list[str] = field(default_factory=list)
    sent: list[Vector] = field(default_factory=list)
    twins: list[Vector] = field(default_factory=list)
    lasting: Vector = field(default_factory=lambda: np.zeros(2))
    plant: Callable[[int], TwinState | None] = lambda ns: TwinState(ns, *np.zeros((4, 2)))
    ended: Refusal | None = None
    counters: BusCounters = field(default_factory=BusCounters)
    utc_offset_ns: int = 0

    def now_ns(self) -> int:
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None:
        self.ns = max(self.ns, deadline_ns)


class Real:
    """The arm of a rig."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.counters = rig, rig.counters

    def connect(self) -> ArmInfo:
        self.rig.told.append("arm connect")
        if self.rig.failure is not None:
            raise self.rig.failure
        return ArmInfo("left", ("a", "b"), LIMIT, "an arm")

    def enable(self) -> None:
        self.rig.told.append("arm on")

    def read(self) -> JointState:
        if self.rig.failure is not None:
            raise self.rig.failure
        return JointState(self.rig.ns, self.rig.q, np.zeros(2), np.zeros(2))

    def write(self, tau_Nm: Vector) -> Vector:
        sent = np.clip(tau_Nm, -LIMIT, LIMIT)
        self.rig.sent.append(sent)
        return sent

    def health(self) -> ServoHealth:
        return ServoHealth.none(7)

    def disable(self) -> None:
        self.rig.told.append("arm off")

    def close(self) -> None:
        self.rig.told.append("arm close")


class Twin:
    """The twin of a rig."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig

    @property
    def ended(self) -> Refusal | None:
        return self.rig.ended

    def connect(self) -> str:
        self.rig.told.append("twin connect")
        return "a plant"

    def enable(self) -> None:
        self.rig.told.append("twin on")

    def newest(self) -> TwinState | None:
        return self.rig.plant(self.rig.ns)

    def command(self, tau_Nm: Vector, lasting_Nm: Vector) -> None:
        self.rig.twins.append(tau_Nm)
        self.rig.lasting = lasting_Nm

    def limp(self) -> None:
        self.rig.told.append("twin limp")

    def close(self) -> None:
        self.rig.told.append("twin close")


def bridge(rig: Rig, carried: Carried | None = None) -> BridgeDriver:
    settings = Settings(0.005, 20.0, 0.7, 0.5 * LIMIT, ramp_s=0.05, apart_max_rad=0.3, touch=Borne(9.0, 0.6))
    here = Here(np.eye(2) * 0.02, np.zeros((3, 2)))
    gripper = GripperCheck(carried) if carried is not None else None
    made = BridgeDriver(Real(rig), Twin(rig), rig, settings, PATIENCE, lambda _: here, gripper)
    made.connect()
    made.enable()
    return made


def cycle(made: BridgeDriver, rig: Rig, count: int = 1) -> None:
    """Cycles as the loop has them: what is stale keeps the last torque."""
    for _ in range(count):
        rig.ns += T_NS
        with contextlib.suppress(StaleStateError):
            made.read()
        made.write(TAU)


def lasting(made: BridgeDriver, rig: Rig) -> HilFault:
    with pytest.raises(HilFault) as caught:
        made.read()
    assert caught.value.state is not None
    assert caught.value.state.stamp_ns == rig.ns, "the arm's own fresh state"
    return caught.value


def test_comings_and_goings_are_in_the_order_that_is_safe() -> None:
    rig = Rig()
    made = bridge(rig)
    made.disable()
    made.close()
    assert rig.told == [
        "twin connect", "arm connect", "arm on", "twin on", "arm off", "twin limp", "arm close", "twin close",
    ]  # fmt: skip
    assert made.counters is rig.counters
    assert made.health().stamp_ns == 7


def test_an_arm_that_comes_back_is_the_real_drivers_affair() -> None:
    made = bridge(Rig())
    assert not made.lapsed
    assert not made.recover()
    made.real.lapsed, made.real.recover = True, lambda: True  # type: ignore[attr-defined]
    assert made.lapsed
    assert made.recover()


def test_an_arm_that_cannot_be_reached_leaves_no_twin_behind() -> None:
    rig = Rig(failure=refusal(ConnectError))
    with pytest.raises(ConnectError):
        bridge(rig)
    assert rig.told == ["twin connect", "arm connect", "twin close"]


def test_the_arm_gets_the_addition_the_twin_the_coupling_and_the_caller_what_was_sent() -> None:
    pull = np.array([0.3, 0.2])
    rig = Rig(plant=lambda ns: TwinState(ns, np.array([0.01, 0.0]), np.zeros(2), pull, pull))
    made = bridge(rig)
    cycle(made, rig, 30)
    sent = made.write(TAU)
    np.testing.assert_array_equal(sent, TAU + made.added)
    np.testing.assert_array_equal(made.sent, sent)
    np.testing.assert_array_equal(rig.twins[-1], TAU + made.coupling.on_twin)
    made.coupling.lasting = np.array([0.1, -0.2])
    made.write(TAU)
    np.testing.assert_array_equal(rig.lasting, TAU + made.coupling.lasting)
    assert made.added.max() > 0.25
    assert made.q_twin.tolist() == [0.01, 0.0]
    assert made.age_s == 0.0


def test_the_twin_takes_part_once_the_gripper_is_found_empty() -> None:
    rig = Rig()
    made = bridge(rig, Carried(lambda _: TAU, lambda _: np.array([0.4, 0.2]), np.zeros(2), 0.3))
    cycle(made, rig, 61)
    assert rig.told[-1] == "arm on"
    cycle(made, rig, 5)
    assert rig.told[-2:] == ["arm on", "twin on"]
    loaded = bridge(rig, Carried(lambda _: np.zeros(2), lambda _: TAU, np.zeros(2), 0.3))
    cycle(loaded, rig, 61)
    for _ in range(3):
        rig.ns += T_NS
        with contextlib.suppress(HilFault):
            loaded.read()
    assert "gripper of arm left: found 100% of the object's weight" in str(lasting(loaded, rig))
    assert rig.told[-2:] == ["arm on", "twin limp"], "its twin has never taken part"


def test_before_the_plant_starts_the_arm_has_its_own_torque_and_after_a_while_a_fault() -> None:
    rig = Rig(plant=lambda _: None)
    made = bridge(rig)
    cycle(made, rig, 190)
    assert all(np.array_equal(tau, TAU) for tau in rig.sent)
    assert np.isnan(made.q_twin).all()
    assert made.age_s == np.inf
    rig.ns += 60_000_000
    assert "expected a plant that all arms of the cell share" in str(lasting(made, rig))
    assert rig.told[-1] == "twin limp"


@pytest.mark.fault("H5")
def test_a_stale_twin_is_a_fault_after_three_cycles_and_stays_one() -> None:
    pull = np.array([0.3, 0.2])
    rig = Rig(plant=lambda ns: TwinState(ns, np.zeros(2), np.zeros(2), pull, pull))
    made = bridge(rig)
    cycle(made, rig, 20)
    rig.plant = lambda _: None
    cycle(made, rig, 3)
    assert "twin limp" not in rig.told
    rig.ns += T_NS
    assert "a state 20 ms old, expected ≤ 16 ms" in str(lasting(made, rig))
    rig.plant = lambda ns: TwinState(ns, np.zeros(2), np.zeros(2), pull, pull)
    for _ in range(25):
        rig.ns += T_NS
        lasting(made, rig)
        made.write(TAU)
    np.testing.assert_allclose(rig.sent[-1], TAU, atol=1e-12)
    assert rig.told.count("twin limp") == 1


def test_a_plant_that_says_its_end_is_named() -> None:
    rig = Rig()
    made = bridge(rig)
    cycle(made, rig, 20)
    rig.ended = refusal(DriverError)
    rig.ns += T_NS
    assert "found a plant that is gone (nothing)" in str(lasting(made, rig))


@pytest.mark.fault("H6")
def test_arm_and_twin_too_far_apart_are_no_pair_any_more() -> None:
    rig = Rig()
    made = bridge(rig)
    cycle(made, rig, 20)
    rig.q = np.array([0.0, -0.29])
    cycle(made, rig)
    rig.q = np.array([0.0, -0.31])
    rig.ns += T_NS
    assert "found 0.31 rad from the arm, expected ≤ 0.3 rad" in str(lasting(made, rig))


@pytest.mark.parametrize("partly", [False, True], ids=["silent", "a servo silent"])
def test_without_a_state_of_the_arm_the_twin_keeps_its_torque_until_the_servos_watchdog(partly: bool) -> None:
    rig = Rig()
    made = bridge(rig)
    cycle(made, rig, 60)
    rig.q = np.array([0.01, 0.0])
    cycle(made, rig)
    assert abs(rig.twins[-1][0] - TAU[0]) > 0.01, "what answers a motion"
    np.testing.assert_allclose(rig.lasting, TAU, atol=1e-3, err_msg="it is not what stays without the agent")
    commands = len(rig.twins)
    rig.failure = refusal(StaleStateError)
    if partly:
        fault = ServoFault("servo 3", found="silence", expected="a reply", remedy="look")
        fault.state = JointState(rig.ns, np.array([0.0, np.nan]), np.zeros(2), np.zeros(2))
        rig.failure = fault
    for _ in range(39):
        rig.ns += T_NS
        with pytest.raises(type(rig.failure)):
            made.read()
        made.write(3.0 * TAU)
    assert len(rig.twins) == commands + 39
    np.testing.assert_allclose(rig.twins[commands:], np.tile(TAU, (39, 1)), atol=1e-3, err_msg="nothing of one cycle")
    assert "twin limp" not in rig.told
    rig.ns += T_NS
    with pytest.raises(type(rig.failure)):
        made.read()
    assert rig.told[-1] == "twin limp"
    rig.failure = None
    rig.ns += T_NS
    assert "a real arm without a state for 0.2 s" in str(lasting(made, rig))


def test_an_arm_that_obeys_anew_after_the_servos_watchdog_has_no_twin_any_more() -> None:
    """The loop asks such an arm no more; `recover` is all that it calls."""
    rig = Rig()
    made = bridge(rig)
    made._real.recover = lambda: True  # type: ignore[attr-defined]
    cycle(made, rig, 20)
    rig.ns += 39 * T_NS
    assert made.recover()
    assert "twin limp" not in rig.told
    rig.ns += T_NS
    assert made.recover()
    assert rig.told[-1] == "twin limp"
    assert "a real arm without a state for 0.2 s" in str(lasting(made, rig))


def test_a_servo_fault_with_the_whole_arms_state_passes_and_the_two_stay_coupled() -> None:
    rig = Rig()
    made = bridge(rig)
    cycle(made, rig, 20)
    fault = ServoFault("servo 3", found="hot", expected="cool", remedy="wait")
    fault.state = JointState(rig.ns + T_NS, np.zeros(2), np.zeros(2), np.zeros(2))
    rig.failure, rig.ns = fault, rig.ns + T_NS
    commands = len(rig.twins)
    with pytest.raises(ServoFault, match="servo 3"):
        made.read()
    made.write(TAU)
    assert len(rig.twins) == commands + 1


def test_what_the_bus_did_not_take_is_no_number_in_the_row() -> None:
    rig = Rig()
    made = bridge(rig)
    cycle(made, rig)
    made._real.write = lambda _: (_ for _ in ()).throw(refusal(DriverError))  # type: ignore[method-assign]
    commands = len(rig.twins)
    with pytest.raises(DriverError):
        made.write(TAU)
    assert len(rig.twins) == commands + 1, "the twin is told all the same"
    assert np.isnan(made.sent).all()


def test_a_cycle_in_which_nothing_was_written_had_no_torque_and_no_addition() -> None:
    """As of an arm whose servos' watchdog has fired: the loop asks no more, and its rows must not repeat the last."""
    rig = Rig(plant=lambda ns: TwinState(ns, np.zeros(2), np.zeros(2), np.ones(2), np.ones(2)))
    made = bridge(rig)
    cycle(made, rig, 60)
    sent, added = made.taken()
    np.testing.assert_array_equal(sent, rig.sent[-1])
    assert added.any()
    sent, added = made.taken()
    assert np.isnan(sent).all()
    assert not added.any()
    cycle(made, rig)
    assert np.isfinite(made.taken()[0]).all()


def test_the_caller_sees_the_twin_while_the_arm_is_touched_and_the_arm_with_a_fault() -> None:
    rig = Rig(plant=lambda ns: TwinState(ns, np.array([0.1, 0.0]), *np.zeros((3, 2))))
    made = bridge(rig)
    cycle(made, rig, 20)
    np.testing.assert_array_equal(made.read().q, rig.q)
    np.testing.assert_array_equal(made.q_twin, [0.1, 0.0])
    made.coupling.touch.share, made.coupling.touch._quiet_s = 1.0, 0.0
    rig.ns += T_NS
    np.testing.assert_array_equal(made.read().q, [0.1, 0.0])
    np.testing.assert_array_equal(made.q_twin, rig.q)
    fault = refusal(ServoFault)
    assert isinstance(fault, ServoFault)
    fault.state = JointState(rig.ns, rig.q, np.zeros(2), np.zeros(2))
    rig.failure = fault
    made.coupling.touch.share = 1.0
    with pytest.raises(ServoFault):
        made.read()
    assert made.coupling.touch.share == 0.0
    np.testing.assert_array_equal(made.q_twin, [0.1, 0.0])
