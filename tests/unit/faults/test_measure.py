"""Figures of a run that was made up: each is what the rows and the truth say, from the fault on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.around import RunSummary
from agent.config.cell import Cell, load_cell
from agent.faults.bench import ArmRun, Rehearsal
from agent.faults.measure import Measured, measured
from agent.faults.plan import Injection
from agent.modes import Mode
from agent.safety import Flag
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.events import DriverEvent, EventKind
from sim_backend.physics.snapshot import Observation

CELL = load_cell(Path("two_wx200"), ["duration_s=2.0"])
ZERO_NS = 5_000_000_000
AT_S = 1.0
TIMES = np.arange(0.0, 2.0, 0.05)


class Row:
    """Rows that are there already."""

    def __init__(self, rows: Any) -> None:
        self._rows = rows

    def array(self) -> Any:
        return self._rows


def arm(
    *,
    flags: dict[float, Flag] | None = None,
    tau: float = 0.0,
    mode: Mode = Mode.TRACK,
    holds_s: float = 9.0,
    **given: Any,
) -> ArmRun:
    """What an arm left: flags by time, one torque all the time, rows of HOLD from then on, and the rest."""
    rows = np.zeros(len(TIMES), AGENT_STATE.dtype)
    rows["stamp_ns"] = ZERO_NS + np.round(TIMES * 1e9).astype(np.int64)
    rows["t"] = TIMES + 0.3  # its own clock, which may be wrong
    rows["tau_sent"][:, 0] = tau
    rows["mode"] = np.where(holds_s - 1e-9 > TIMES, Mode.TRACK, Mode.HOLD)
    for t, flag in (flags or {}).items():
        rows["flags"][np.searchsorted(TIMES, t - 1e-9)] = int(flag)
    run = ArmRun(**given)
    run.log = Row(rows)  # type: ignore[assignment]
    run.summary = RunSummary(len(rows), 0, 0, mode, "because", 2.0)
    return run


def seen(t: float, **given: Any) -> Observation:
    """The truth at a time: the object at its desired pose, nothing moving, nothing pulling."""
    still = Observation(
        t, np.array(CELL.trajectory().at(max(t, 0.0)).p), np.array([1.0, 0, 0, 0]), np.zeros(6), np.zeros((2, 6)),
        *(np.zeros(2) for _ in range(4)), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6), 0.0,
    )  # fmt: skip
    return replace(still, **given)


def figures(
    left: ArmRun | None = None, right: ArmRun | None = None, truth: dict[float, Any] | None = None,
    struck: str = "left", ready: dict[str, Any] | None = None, again_s: float | None = None, fault: str = "bus-off",
    cell: Cell = CELL,
) -> Measured:  # fmt: skip
    """Of a run with a fault of one arm at AT_S; truth: what is seen at a time and from then on.

    ready: what is seen before the start; again_s: when there is a second fault.
    """
    taken = [] if ready is None else [(-0.5, seen(-0.5, **ready))]
    given: dict[str, Any] = {}
    for t in TIMES:
        given = {**given, **next((v for at, v in (truth or {}).items() if abs(at - t) < 1e-9), {})}
        taken.append((float(t), seen(float(t), **given)))
    at = [again_s, AT_S] if again_s is not None else [AT_S]
    faults = tuple(Injection(fault=fault, arm=struck, at_s=at_s) for at_s in at)
    arms = {"left": left or arm(), "right": right or arm()}
    return measured(Rehearsal(cell, faults, arms, ZERO_NS, tuple(taken), None))  # type: ignore[arg-type]


def test_a_quiet_run_has_no_figure_but_zeros() -> None:
    found = figures()
    assert (found.noticed_s, found.noticed, found.reacted_s) == (None, "", None)
    assert (found.internal_N, found.sag_m, found.moved_rad, found.speed_rad_per_s, found.torque_share) == (
        0,
        0,
        0,
        0,
        0,
    )
    assert dict(found.why) == {"left": "because", "right": "because"}


@pytest.mark.parametrize(
    ("one", "text"),
    [
        ({"flags": {1.1: Flag.STALE | Flag.SATURATED}}, "left: STALE"),
        ({"modes": [(1.1, Mode.HOLD)]}, "left: HOLD"),
        ({"events": [(1.1, DriverEvent(EventKind.HOT, "x"))]}, "left: servo is close to its temperature limit"),
    ],
    ids=["flag", "mode", "event"],
)
def test_the_first_that_says_anything_after_the_fault_noticed_it(one: dict[str, Any], text: str) -> None:
    found = figures(arm(**one), arm(modes=[(1.3, Mode.HOLD)]))
    assert found.noticed_s == pytest.approx(0.1)
    assert found.noticed == text


@pytest.mark.parametrize(
    "one",
    [
        {"flags": {0.5: Flag.STALE}},
        {"flags": {1.1: Flag.SATURATED | Flag.RATE_LIMITED}},
        {"modes": [(0.0, Mode.TRACK), (1.1, Mode.READY)]},
        {"events": [(0.9, DriverEvent(EventKind.HOT, "x"))]},
        {"modes": [(0.9, Mode.HOLD)]},
    ],
    ids=["flag before", "limits", "no stop", "event before", "stop before"],
)
def test_what_was_before_or_says_nothing_is_no_notice(one: dict[str, Any]) -> None:
    assert figures(arm(**one)).noticed_s is None


def test_an_arm_has_stopped_when_its_mode_says_so_or_it_gave_up() -> None:
    found = figures(arm(modes=[(1.1, Mode.HOLD), (1.5, Mode.FAULT)], mode=Mode.FAULT), arm(mode=Mode.FAULT))
    assert found.stopped_s["left"] == pytest.approx(0.1)
    assert found.stopped_s["right"] == pytest.approx(0.95)
    assert found.reacted_s == pytest.approx(0.95)
    assert dict(found.ended) == {"left": "FAULT", "right": "FAULT"}


def test_an_arm_that_held_before_the_fault_has_not_stopped_for_it() -> None:
    found = figures(arm(modes=[(0.5, Mode.HOLD)], mode=Mode.HOLD), arm(modes=[(1.1, Mode.HOLD)]))
    assert found.stopped_s["left"] == pytest.approx(0.95), "or a trip without a fault would be a quick reaction"
    assert found.reacted_s == pytest.approx(0.95)


def test_of_two_faults_the_first_counts() -> None:
    for again_s, seconds in ((1.4, 0.5), (0.9, 0.6)):
        found = figures(arm(modes=[(1.5, Mode.HOLD)]), again_s=again_s)
        assert (found.noticed_s, found.stopped_s["left"]) == (pytest.approx(seconds), pytest.approx(seconds))


def test_the_internal_force_is_the_arm_s_with_the_most_before_and_after() -> None:
    def pull(size: float) -> dict[str, Any]:
        wrench = np.zeros((2, 6))
        wrench[0, 0], wrench[1, 0] = size, -size + 1.0  # a pull, and 1 N that moves the object
        return {"grasp_wrench": wrench}

    way = {0.0: pull(0.5), 0.3: pull(3.0), 0.4: pull(0.5), 1.2: pull(7.0), 1.3: pull(0.5)}
    found = figures(truth=way, ready=pull(5.0))
    assert found.internal_before_N == pytest.approx(2.5)
    assert found.internal_N == pytest.approx(6.5)


def test_of_three_arms_the_one_with_the_most_counts() -> None:
    wrench = np.zeros((3, 6))
    wrench[:, 2] = 4.0, 1.0, 1.0
    assert figures(truth={0.0: {"grasp_wrench": wrench}}).internal_N == pytest.approx(2.0)


def test_what_the_load_shares_mean_is_no_internal_force() -> None:
    unlike = load_cell(Path("two_wx200"), ["duration_s=2.0", "arms.left.load_share=0.1", "arms.right.load_share=0.9"])
    wrench = np.zeros((2, 6))
    wrench[0, 2], wrench[1, 2] = 0.5, 4.5
    assert figures(truth={0.0: {"grasp_wrench": wrench}}, cell=unlike).internal_N == pytest.approx(0.0, abs=1e-12)
    wrench[0, 2], wrench[1, 2] = 0.8, 4.2
    assert figures(truth={0.0: {"grasp_wrench": wrench}}, cell=unlike).internal_N == pytest.approx(0.3)


def test_sag_is_below_the_motion_while_it_is_followed_and_below_the_hold_after_it() -> None:
    def at(z: float) -> dict[str, Any]:
        return {"p_object": np.array([0.27, 0.0, 0.25 + z])}

    assert figures(truth={1.2: at(-0.03), 1.3: at(0.02)}).sag_m == pytest.approx(0.03)
    assert figures(truth={1.2: at(0.03)}).sag_m == pytest.approx(0.0)
    assert figures(truth={1.0: at(-0.03), 1.1: at(0.0)}).sag_m == pytest.approx(0.03), "from the fault on"
    held = figures(arm(modes=[(1.2, Mode.HOLD)]), truth={1.2: at(-0.03), 1.5: at(-0.05)})
    assert held.sag_m == pytest.approx(0.02)
    assert figures(truth={0.5: at(-0.03), 0.6: at(0.0)}).sag_m == pytest.approx(0.0), "before the fault"


def test_the_object_strays_from_its_way_and_from_where_it_was_first_stopped() -> None:
    """It is 9 mm off before the fault, which is not the fault's."""
    motion = CELL.trajectory()

    def beside(t: float, by: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
        return {"p_object": np.add(motion.at(t).p, np.add((0.009, 0.0, 0.0), by))}

    way = {t: beside(t) for t in TIMES}
    assert figures(truth=way).strayed_m == pytest.approx(0.0)
    assert figures(truth=way | {TIMES[30]: beside(TIMES[30], (0.003, 0.0, 0.004))}).strayed_m == pytest.approx(0.005)
    stands = {t: beside(1.1, (0.0, 0.004, 0.003)) for t in TIMES if t > 1.1}
    assert figures(arm(modes=[(1.1, Mode.HOLD)]), truth=way | stands).strayed_m == pytest.approx(0.005)
    assert figures(truth=way | stands).strayed_m > 0.006, "the motion goes on without it"
    stopped = arm(modes=[(1.1, Mode.HOLD)])
    assert figures(stopped, truth=way, fault="grasp-off").strayed_m == pytest.approx(0.0), "who lost it stops alone"
    assert figures(None, stopped, truth=way, fault="grasp-off").strayed_m > 0.006


def test_a_joint_is_taken_to_be_elsewhere_while_its_arm_follows_and_has_a_state() -> None:
    truth = {0.0: {"q": np.zeros(6)}, 1.2: {"q": np.array([0.0, 0.02, 0.0, 0.5, 0.0, 0.0])}}
    assert figures(truth=truth).misled_rad == pytest.approx(0.02), "the other arm's joints are not its own"
    assert figures(truth=truth, struck="right").misled_rad == pytest.approx(0.5)
    assert figures(arm(holds_s=1.2), truth=truth).misled_rad == 0.0
    assert figures(arm(flags={at: Flag.STALE for at in TIMES if at >= 1.2}), truth=truth).misled_rad == 0.0
    assert figures(truth={0.5: {"q": np.ones(6)}, 0.9: {"q": np.zeros(6)}}).misled_rad == 0.0, "before the fault"


def test_moved_is_by_the_arm_with_the_fault_within_the_watchdogs_time() -> None:
    def turned(joint: int, angle: float) -> dict[str, Any]:
        q = np.zeros(6)
        q[joint] = angle
        return {"q": q}

    assert figures(truth={1.1: turned(1, -0.3)}).moved_rad == pytest.approx(0.3)
    assert figures(truth={1.1: turned(4, -0.3)}).moved_rad == 0.0, "the other arm"
    assert figures(truth={1.3: turned(1, 0.3)}).moved_rad == 0.0, "after the watchdog"
    assert figures(truth={0.9: turned(1, 0.3)}).moved_rad == 0.0, "before the fault"


def test_speed_and_torque_are_the_largest_from_the_fault_on() -> None:
    fast, slow = {"dq": np.array([0, 0, 0, 0, -2.5, 0])}, {"dq": np.zeros(6)}
    found = figures(right=arm(tau=-2.05), truth={0.2: {"dq": np.full(6, 9.0)}, 0.3: slow, 1.5: fast})
    bound = CELL.arm("right").tau_stall_Nm[0] * CELL.file.safety.tau_max_fraction_of_stall
    assert found.speed_rad_per_s == 2.5
    assert found.others_rad_per_s == 2.5
    assert figures(truth={1.5: {"dq": np.array([9.0, 0, 0, 0, 0, -1.5])}}).others_rad_per_s == 1.5, "left has the fault"
    assert found.torque_share == pytest.approx(2.05 / bound)


def test_the_fall_is_the_largest_speed_downwards_from_the_fault_on() -> None:
    p = np.array(CELL.trajectory().at(0.0).p)
    way = {0.2: 0.5, 0.4: 0.0, 1.5: -0.01, 1.6: -0.03, 1.7: 0.2}
    found = figures(truth={at: {"p_object": p + np.array([0.1, 0.0, z])} for at, z in way.items()})
    assert found.fall_m_per_s == pytest.approx(0.2)  # 20 mm in 0.1 s
