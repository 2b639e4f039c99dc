"""How a loop sees its arm: what it asks of the bus in a cycle, what a read brings, when an arm is brought back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from agent.cycles import Bus, Cycles, Patience
from agent.modes import WAY_BACK, Event, Mode
from agent.sight import Sight
from drivers.interface import DriverError, JointState, ServoFault, StaleStateError, WaitEnded

PERIOD_NS = 5_000_000
PATIENCE = Patience()
STANDS = {Mode.HOLD, Mode.HALT, Mode.STAND, Mode.REST}
STATE = JointState(7, np.zeros(3), np.zeros(3), np.zeros(3))
NAN = np.array([0.0, np.nan, 0.0])


class Reads:
    """An arm whose reads bring what the list says."""

    def __init__(self, *brings: JointState | Exception) -> None:
        self.brings = list(brings)

    def read(self) -> JointState:
        brought = self.brings.pop(0)
        if isinstance(brought, Exception):
            raise brought
        return brought


class Returns(Reads):
    """One that can be brought back."""

    def __init__(self, *recovers: bool | Exception, lapsed: bool = True) -> None:
        super().__init__()
        self.recovers = list(recovers)
        self.lapsed = lapsed

    def recover(self) -> bool:
        outcome = self.recovers.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome


def error(kind: Callable[..., Any], what: str = "arm") -> Any:
    return kind(what, found="nothing", expected="a reply", remedy="look")


def fault(state: JointState | None, what: str = "servo 2") -> ServoFault:
    found: ServoFault = error(ServoFault, what)
    found.state = state
    return found


def sight(driver: Any, *, lockstep: bool = False, busy: Callable[[], None] = lambda: None) -> tuple[Sight, list[str]]:
    resumed: list[str] = []
    cycles = Cycles(PATIENCE, PERIOD_NS, 0)
    return Sight(driver, cycles, lambda: resumed.append("yes"), busy, lockstep=lockstep), resumed


def plans(seen: Sight, cycles: Sequence[int], mode: Mode) -> list[Bus]:
    return [seen.plan(k * PERIOD_NS, mode) for k in cycles]


def test_an_arm_that_cannot_come_back_is_asked_until_it_is_given_up() -> None:
    for mode in (Mode.TRACK, Mode.HOLD):
        seen, _ = sight(Reads())
        assert plans(seen, (0, PATIENCE.blind - 1, PATIENCE.blind), mode) == [Bus.READ, Bus.READ, Bus.GIVE_UP]


@pytest.mark.parametrize("mode", list(Mode))
def test_an_arm_that_lapsed_is_brought_back_where_it_keeps_its_place_alone(mode: Mode) -> None:
    driver = Returns(True)
    seen, resumed = sight(driver)
    assert seen.plan(0, mode) is Bus.READ
    assert resumed == (["yes"] if mode in STANDS else [])
    assert driver.recovers == ([] if mode in STANDS else [True])


def test_whoever_watches_the_loop_is_told_before_an_arm_is_brought_back() -> None:
    driver, told = Returns(True), []
    seen, _ = sight(driver, busy=lambda: told.append(len(driver.recovers)))
    seen.plan(0, Mode.HOLD)
    seen.plan(PERIOD_NS, Mode.TRACK)
    assert told == [1]


def test_an_arm_that_has_not_lapsed_is_left_alone() -> None:
    driver = Returns(True, lapsed=False)
    assert sight(driver)[0].plan(0, Mode.HOLD) is Bus.READ
    assert driver.recovers == [True]


def test_a_torque_that_went_on_begins_nothing_afresh() -> None:
    seen, resumed = sight(Returns(False))
    assert (seen.plan(0, Mode.HOLD), resumed) == (Bus.READ, [])


def test_an_attempt_that_fails_says_why_and_nothing_is_asked_in_that_cycle() -> None:
    driver = Returns(error(DriverError, "port"), True)
    seen, resumed = sight(driver)
    assert seen.plan(0, Mode.HOLD) is Bus.QUIET
    assert seen.unseen.startswith("port: found nothing")
    assert str(seen.lost) == seen.unseen
    assert resumed == []
    assert seen.plan((PATIENCE.retry - 1) * PERIOD_NS, Mode.HOLD) is Bus.READ
    assert driver.recovers == [True], "the next attempt is not due yet"
    assert seen.plan(PATIENCE.retry * PERIOD_NS, Mode.HOLD) is Bus.READ
    assert resumed == ["yes"]


def test_an_arm_that_says_it_cannot_come_back_is_given_up_at_once() -> None:
    seen, resumed = sight(Returns(fault(None), True))
    assert seen.plan(0, Mode.HOLD) is Bus.GIVE_UP
    assert seen.unseen.startswith("servo 2: found nothing")
    assert str(seen.lost) == seen.unseen
    assert resumed == []


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_state_is_passed_on_and_a_cycle_without_one_ends_simulated_time_alone(lockstep: bool) -> None:
    seen, _ = sight(Reads(STATE, error(StaleStateError, "state")), lockstep=lockstep)
    assert seen.read(Mode.TRACK) == (STATE, Event.NONE)
    assert (seen.unseen, seen.lost) == ("", None)
    assert seen.read(Mode.TRACK) == (None, Event.SERVO_LOST if lockstep else Event.NONE)
    assert seen.unseen.startswith("state: found nothing")
    assert str(seen.lost) == seen.unseen


@pytest.mark.parametrize("lockstep", [False, True])
def test_an_arm_that_waited_and_was_asked_for_something_is_not_lost(lockstep: bool) -> None:
    seen, _ = sight(Reads(error(WaitEnded, "plant")), lockstep=lockstep)
    assert seen.read(Mode.TRACK) == (None, Event.NONE)
    assert seen.unseen.startswith("plant: found nothing")


@pytest.mark.parametrize(
    ("state", "comes", "happened"),
    [
        (STATE, True, Event.TROUBLE),
        (None, False, Event.SERVO_LOST),
        (JointState(7, NAN, STATE.dq, STATE.tau), False, Event.TROUBLE),
        (JointState(7, STATE.q, NAN, STATE.tau), False, Event.TROUBLE),
        (JointState(7, STATE.q, STATE.dq, NAN), True, Event.TROUBLE),
    ],
    ids=["all fresh", "nothing fresh", "a position missing", "a speed missing", "a torque missing"],
)
def test_of_a_fault_the_state_counts_where_all_joints_are_seen(
    state: JointState | None, comes: bool, happened: Event
) -> None:
    seen, _ = sight(Reads(fault(state)))
    found, event = seen.read(Mode.TRACK)
    assert (found is state if comes else found is None, event) == (True, happened)
    assert seen.unseen.startswith("servo 2: found nothing")


@pytest.mark.parametrize("lapsed", [False, True])
def test_what_a_servo_says_of_itself_is_why_where_it_only_seemed_silent(lapsed: bool) -> None:
    driver = Returns(lapsed=lapsed)
    driver.brings = [error(StaleStateError, "no reply"), fault(STATE, "servo 2: rebooted")]
    seen, _ = sight(driver)
    seen.read(Mode.TRACK)
    silent = seen.blamed()
    assert silent.startswith("no reply")
    seen.read(Mode.HOLD)
    assert seen.why(silent).startswith("no reply" if lapsed else "servo 2: rebooted")
    assert seen.why("a monitor") == "a monitor"
    assert seen.why("").startswith("servo 2: rebooted")


def test_an_arm_that_nobody_brings_back_says_why_too() -> None:
    seen, _ = sight(Reads(error(StaleStateError, "no reply"), fault(STATE, "servo 2: rebooted")))
    assert seen.why("a monitor") == "a monitor", "before anything was unseen"
    seen.read(Mode.TRACK)
    silent = seen.blamed()
    seen.read(Mode.HOLD)
    assert seen.why(silent).startswith("servo 2: rebooted")


@pytest.mark.parametrize("between", [STATE, None])
def test_a_fault_that_was_over_meanwhile_is_a_new_one(between: JointState | None) -> None:
    """An arm that was brought back, and trips again on its way; one that was not seen meanwhile has the old one."""
    silent = StaleStateError("state", found="none", expected="one", remedy="look")
    seen, _ = sight(Reads(fault(STATE), between or silent, fault(STATE)))
    events = [seen.read(Mode.PARK)[1] for _ in range(3)]
    assert events == [Event.TROUBLE, Event.NONE, Event.TROUBLE if between else Event.NONE]


@pytest.mark.parametrize("mode", list(Mode))
def test_a_fault_that_lasts_is_borne_on_the_way_back_of_a_session(mode: Mode) -> None:
    seen, _ = sight(Reads(fault(STATE), fault(STATE), fault(STATE, "servo 3")))
    events = [seen.read(mode)[1] for _ in range(3)]
    assert events == [Event.TROUBLE, Event.NONE if mode in WAY_BACK else Event.TROUBLE, Event.TROUBLE]
