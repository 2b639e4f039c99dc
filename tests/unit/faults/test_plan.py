"""Faults by name: each can happen, says its size, and reaches the bus as it was meant."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.faults.plan import (
    NAMES,
    POSSIBLE,
    FaultPlanError,
    Injection,
    injection,
    on_the_wire,
    placed,
    require_happens,
    require_simulated,
)
from sim_backend.wire.faults import FaultKind


def test_names_are_what_fails_and_how() -> None:
    assert len(NAMES) == len(POSSIBLE)
    for name, (target, kind) in zip(NAMES, POSSIBLE, strict=True):
        fault = Injection(fault=name)
        assert (fault.target, fault.kind) == (target, kind)
        assert fault.amount == POSSIBLE[target, kind].size
        assert bool(POSSIBLE[target, kind].unit) == (fault.amount > 0.0)


def test_what_cannot_be_is_refused_in_words() -> None:
    for name, given in (("bus-on", {}), ("bus-off", {"at_s": -1.0}), ("bus-off", {"servo": 300})):
        with pytest.raises(FaultPlanError, match="coop faults"):
            injection(name, **given)
    with pytest.raises(FaultPlanError, match="left or right"):
        placed([Injection(fault="bus-off", arm="middle")], ["left", "right"])
    assert placed([Injection(fault="bus-off")], ["left", "right"])[0].arm == "left"
    assert injection("bus-off", size=None, for_s=None).for_s == math.inf


def test_a_size_is_refused_where_a_fault_has_none() -> None:
    for name, possible in zip(NAMES, POSSIBLE.values(), strict=True):
        if possible.unit:
            assert injection(name, size=0.5).amount == 0.5
        else:
            with pytest.raises(FaultPlanError, match=rf"fault {name}: size: found 5.*no size: {name} has none"):
                injection(name, size=5.0)


def test_a_fault_that_would_begin_after_the_run_is_refused() -> None:
    require_happens([Injection(fault="bus-off", at_s=1.9)], 2.0)
    with pytest.raises(FaultPlanError, match=r"fault bus-off at 2 s: found a run of 2 s.*longer --duration"):
        require_happens([Injection(fault="bus-off", at_s=1.0), Injection(fault="bus-off", at_s=2.0)], 2.0)


def test_a_cell_of_real_arms_is_not_rehearsed_as_one() -> None:
    real = load_cell(Path("two_wx200"), ['driver="dynamixel"'])
    with pytest.raises(FaultPlanError, match="driver=sim"):
        require_simulated(real)
    require_simulated(load_cell(Path("two_wx200")))


@pytest.mark.parametrize(
    ("fault", "kind", "key", "value"),
    [
        ("servo-off", FaultKind.POWER_LOSS, "servo", 4),
        ("servo-stuck", FaultKind.ENCODER_STUCK, "servo", 4),
        ("servo-garbage", FaultKind.CORRUPT, "probability", 1.0),
        ("servo-wrong", FaultKind.ENCODER_OFFSET, "offset_ticks", 57),
        ("servo-slow", FaultKind.OVERHEAT, "ramp_s", 1.0),
        ("servo-delayed", FaultKind.DELAY, "delay_ms", 5.0),
        ("servo-intermittent", FaultKind.DROP, "probability", 0.5),
        ("bus-off", FaultKind.MUTE, "servo", 4),
        ("bus-stuck", FaultKind.STALL, "duration_s", 0.5),
        ("bus-garbage", FaultKind.BABBLE, "start_s", 2.0),
        ("bus-wrong", FaultKind.DUPLICATE, "probability", 0.5),
        ("bus-delayed", FaultKind.DELAY, "delay_ms", 5.0),
        ("bus-intermittent", FaultKind.DROP, "probability", 0.9),
        ("port-off", FaultKind.PORT_LOSS, "duration_s", 0.5),
        ("arm-off", FaultKind.POWER_LOSS, "servo", None),
    ],
)
def test_faults_of_the_wire_are_those_of_the_emulated_bus(fault: str, kind: FaultKind, key: str, value: object) -> None:
    wired = on_the_wire(Injection(fault=fault, arm="left", servo=4, at_s=2.0, for_s=0.5))
    assert wired is not None
    assert (wired.kind, wired.arm, wired.start_s, wired.duration_s) == (kind, "left", 2.0, 0.5)
    assert getattr(wired, key) == value


def test_the_others_do_not_reach_the_bus() -> None:
    wired = {name for name in NAMES if on_the_wire(Injection(fault=name, arm="left")) is not None}
    assert {name.partition("-")[0] for name in wired} == {"servo", "bus", "port", "arm"}
    assert {"arm-stuck", "arm-wrong"}.isdisjoint(wired)
