"""What is done to telemetry and recorder, when; and what of it is refused before anything starts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from agent.config.cell import Cell, load_cell
from agent.faults.plan import NAMES, OF_LISTENERS, FaultPlanError, Injection
from agent.faults.rehearse import rehearse
from agent.faults.strikes import Deed, Strike, is_of_listeners, placed_at, strikes

OURS = [name for name in NAMES if Injection(fault=name).target in OF_LISTENERS]


def paper(duration_s: float = 3.0, *overrides: str) -> Cell:
    return load_cell(Path("paper"), [f"duration_s={duration_s}", *overrides])


def planned(*faults: Injection, duration_s: float = 3.0) -> list[tuple[float, list[tuple[Deed, str]]]]:
    """By instant what is done to whom."""
    cell = paper(duration_s)
    groups = strikes(cell, placed_at(cell, faults))
    assert all(len({one.at_s for one in group}) == 1 for group in groups)
    return [(round(group[0].at_s, 9), [(one.deed, one.whom) for one in group]) for group in groups]


def of(fault: str, **given: Any) -> Injection:
    return Injection(fault=fault, **given)


def test_these_are_all_of_them() -> None:
    assert OURS == [
        "telemetry-off", "telemetry-stuck", "telemetry-garbage", "telemetry-wrong", "telemetry-intermittent",
        "recorder-off", "recorder-stuck", "recorder-intermittent",
    ]  # fmt: skip
    assert all(is_of_listeners([of("bus-off"), of(name)]) for name in OURS)
    assert not is_of_listeners([of("bus-off"), of("plant-off")])


@pytest.mark.parametrize(
    ("fault", "begins", "ends"),
    [
        ("telemetry-off", (Deed.KILL, "left"), (Deed.BEGIN, "left")),
        ("telemetry-stuck", (Deed.STOP, "left"), (Deed.GO_ON, "left")),
        ("recorder-off", (Deed.KILL, "recorder"), (Deed.BEGIN, "recorder")),
        ("recorder-stuck", (Deed.STOP, "recorder"), (Deed.GO_ON, "recorder")),
    ],
)
def test_a_process_is_struck_and_the_fault_ends_with_it_back(
    fault: str, begins: tuple[Deed, str], ends: tuple[Deed, str]
) -> None:
    assert planned(of(fault, at_s=1.0)) == [(1.0, [begins])]
    assert planned(of(fault, at_s=1.0, for_s=0.5)) == [(1.0, [begins]), (1.5, [ends])]
    assert planned(of(fault, at_s=1.0, for_s=1.98)) == [(1.0, [begins]), (2.98, [ends])]


def test_telemetry_is_an_arms_and_the_recorder_everybodys() -> None:
    cell = paper()
    (telemetry, recorder) = placed_at(cell, [of("telemetry-off"), of("recorder-off")])
    assert (telemetry.arm, recorder.arm) == ("left", None)


def test_a_stranger_sends_once() -> None:
    assert planned(of("telemetry-garbage", arm="right", at_s=0.5)) == [(0.5, [(Deed.BABBLE, "right")])]
    assert planned(of("telemetry-wrong", at_s=0.0)) == [(0.0, [(Deed.FORGE, "left")])]
    assert planned(of("telemetry-garbage", arm="plant")) == [(1.0, [(Deed.BABBLE, "plant")])]


@pytest.mark.parametrize(("target", "whom"), [("telemetry", "left"), ("recorder", "recorder")])
def test_what_is_intermittent_stands_for_its_share_of_every_half_second(target: str, whom: str) -> None:
    stop, go_on = [(Deed.STOP, whom)], [(Deed.GO_ON, whom)]
    found = planned(of(f"{target}-intermittent", at_s=1.0, size=0.2), duration_s=2.3)
    assert found == [(1.0, stop), (1.1, go_on), (1.5, stop), (1.6, go_on), (2.0, stop), (2.1, go_on)]
    found = planned(of(f"{target}-intermittent", at_s=1.0, for_s=0.7), duration_s=4.0)
    assert found == [(1.0, stop), (1.25, go_on), (1.5, stop), (1.7, go_on)], "it goes on when the fault ends"
    found = planned(of(f"{target}-intermittent", at_s=2.0), duration_s=2.7)
    assert found == [(2.0, stop), (2.25, go_on), (2.5, stop), (2.68, go_on)], "and when the run does"
    assert planned(of(f"{target}-intermittent", at_s=2.68), duration_s=2.7) == [(2.68, [*stop, *go_on])]


def test_deeds_of_one_instant_are_done_together_and_all_in_order_of_time() -> None:
    cell = paper()
    faults = [of("recorder-off", at_s=2.0), of("telemetry-stuck", arm="right", at_s=1.0, for_s=1.0)]
    assert strikes(cell, placed_at(cell, faults)) == (
        (Strike(1.0, Deed.STOP, "right"),),
        (Strike(2.0, Deed.KILL, "recorder"), Strike(2.0, Deed.GO_ON, "right")),
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (of("bus-off"), r"fault bus-off: found it beside faults of telemetry or recorder, .*; let it happen by itself"),
        (of("telemetry-off", servo=4), r"fault telemetry-off: servo: found 4, .*; leave --servo out"),
        (of("recorder-off", arm="left"), r"fault recorder-off: arm: found left, .*one recorder; leave --arm out"),
        (of("telemetry-garbage", for_s=1.0), r"telemetry-garbage: how long: found 1 s, .*one burst.*; leave --for out"),
        (of("telemetry-wrong", for_s=1.0), r"telemetry-wrong: how long: found 1 s, .*; leave --for out"),
        (of("telemetry-wrong", arm="plant"), r"telemetry-wrong: arm: found plant, .*; name an arm with --arm"),
        (of("telemetry-intermittent", size=1.0), r"found 1 of the time, .* below 1; .*telemetry-stuck"),
        (of("recorder-intermittent", size=1.5), r"found 1.5 of the time, .* below 1; .*recorder-stuck"),
        (of("telemetry-off", arm="middle"), r"found middle, expected left or right or plant"),
        (
            of("telemetry-off", at_s=2.99),
            r"from 2.99 to 2.99 s: found a run of 3 s, expected instants up to 2.98 s; .*for good",
        ),
        (of("recorder-off", at_s=1.0, for_s=1.99), r"from 1 to 2.99 s: found a run of 3 s, .*longer --duration"),
    ],
    ids=lambda value: value.fault if isinstance(value, Injection) else "",
)
def test_what_cannot_be_is_refused_in_words(given: Injection, said: str) -> None:
    with pytest.raises(FaultPlanError, match=said):
        placed_at(paper(), [given])


def test_a_cell_that_does_not_wait_is_refused() -> None:
    for table in ("hil", "floating"):
        with pytest.raises(FaultPlanError, match=rf"cell paper: found \[{table}\], .*lockstep.*; remove the table"):
            placed_at(paper(3.0, f'{table}.arms=["left"]'), [of("telemetry-off")])


def test_a_run_longer_than_its_rings_remember_is_refused() -> None:
    placed_at(paper(40.9), [of("telemetry-garbage")])
    with pytest.raises(FaultPlanError, match=r"duration: found 41 s .*expected at most 40.96 s.*shorter --duration"):
        placed_at(paper(41.0), [of("telemetry-garbage")])
    with pytest.raises(FaultPlanError, match=r"found 41 s from READY"):
        placed_at(paper(37.0, "simulation.ready_s=4.0"), [of("telemetry-garbage")])


@pytest.mark.parametrize("fault", ["telemetry-off", "telemetry-stuck", "recorder-off", "recorder-stuck"])
def test_a_silence_for_which_simulated_time_would_wait_is_refused(fault: str) -> None:
    placed_at(paper(20.0), [of(fault, at_s=0.25, for_s=19.48)])
    placed_at(paper(30.0), [of(fault, at_s=0.6, for_s=19.4)])
    for given in (of(fault, at_s=0.5), of(fault, at_s=0.4, for_s=19.5)):
        with pytest.raises(FaultPlanError, match=r"how long: found 19.5 s, expected at most 19.48 s"):
            placed_at(paper(20.0), [given])


@pytest.mark.parametrize("overrides", [(), ('hil.arms=["left"]',)])
@pytest.mark.parametrize("fault", OURS)
def test_the_bench_has_nobody_who_listens_and_says_so(fault: str, overrides: tuple[str, ...]) -> None:
    with pytest.raises(FaultPlanError, match=rf"fault {fault}: found arms in virtual time, .*coop faults inject"):
        rehearse(paper(3.0, *overrides), [of("bus-off"), of(fault)])
    assert math.isinf(of(fault).for_s)
