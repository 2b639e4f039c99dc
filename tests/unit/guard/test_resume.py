"""Where a hold begins behind a dead agent: bit for bit where the agent itself would have begun it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import configs
from agent.around import Beginning
from agent.config.cell import load_cell
from agent.control.memory import Memory, restore
from agent.cycles import Patience
from agent.guard.resume import ROWS, beginning, from_torque, last_seen, stood_in
from agent.loop import initial_memory
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.safety import Flag
from agent.standing import wait_here
from tests.support.runner_rig import lost_at, paper, q_start, run

AGENT = build_agent(paper(), paper().arms[0])
STOP_AT = 25  # reads; the rows before it are READY (10) and TRACK


def held_by_itself(stop_at: int) -> tuple[Any, Any]:
    """Rows before the agent's own hold, and the first one of it."""
    rows = rows_until(stop_at)
    first = int(np.flatnonzero(rows["mode"] == Mode.HOLD)[0])
    return rows[:first], rows[first]


def moving(read: int) -> np.ndarray:
    return q_start() + 0.002 * read


def rows_until(stop_at: int, **more: Any) -> Any:
    """Rows of an agent that is stopped at that read, and ends soon after."""

    def operator(reads: int) -> Event:
        stopped = Event.STOP if reads >= stop_at else Event.NONE
        return stopped | (Event.RELEASED if reads >= stop_at + 3 else Event.NONE)

    return run(operator, q=moving, **more).rows


def same(memory: Memory, row: Any) -> None:
    np.testing.assert_array_equal(memory.flatten(), row["memory"])


@pytest.mark.parametrize("stop_at", [5, STOP_AT])
def test_the_hold_begins_with_the_memory_of_the_agents_own_hold(stop_at: int) -> None:
    before, held = held_by_itself(stop_at)
    assert before[-1]["mode"] == (Mode.READY if stop_at == 5 else Mode.TRACK)
    begun = beginning(AGENT, before, "the agent has died")
    assert begun.mode is Mode.HOLD
    same(begun.memory, held)
    assert begun.rows == held["sequence"]
    assert begun.reason == "the agent has died"


def test_the_trajectorys_zero_is_that_of_the_rows() -> None:
    before, held = held_by_itself(STOP_AT)
    begun = beginning(AGENT, before, "")
    assert (int(held["stamp_ns"]) - begun.zero_ns) * 1e-9 == pytest.approx(float(held["t"]), abs=2e-9)


def test_a_hold_that_the_agent_had_begun_goes_on_at_the_same_pose() -> None:
    rows = rows_until(STOP_AT)
    held = rows[rows["mode"] == Mode.HOLD]
    begun = beginning(AGENT, held[:2], "x")
    same(begun.memory, held[2])
    assert begun.memory.hold == restore(held[0]["memory"], 3).hold
    assert begun.reason == "x; it held already"


def test_behind_rows_without_a_state_the_hold_begins_where_the_arm_is_seen_next() -> None:
    rows = rows_until(STOP_AT, failures=lost_at(STOP_AT, STOP_AT + 1))
    held = np.flatnonzero(rows["mode"] == Mode.HOLD)[0]
    assert (rows["flags"][held - 2 : held] & Flag.STALE).all()
    begun = beginning(AGENT, rows[:held], "")
    same(wait_here(AGENT, rows[held]["q_measured"][:3].copy(), begun.memory), rows[held])  # as the loop itself does
    assert begun.rows == rows[held]["sequence"]


@pytest.mark.parametrize("mode", [Mode.OFF, Mode.FAULT, 250])
def test_rows_behind_the_last_command_say_nothing_of_the_hold(mode: int) -> None:
    before, held = held_by_itself(STOP_AT)
    more = np.concatenate([before, before[-2:]])
    more["mode"][-2:] = int(mode)
    begun = beginning(AGENT, more, "x")
    same(begun.memory, held)
    assert begun.rows == held["sequence"]


def test_a_single_row_without_a_state_is_enough_to_go_on() -> None:
    one = held_by_itself(STOP_AT)[0][-1:].copy()
    one["flags"] |= int(Flag.STALE)
    begun = beginning(AGENT, one, "x")
    assert (begun.mode, begun.rows) == (Mode.HOLD, int(one[0]["sequence"]) + 1)
    assert Patience().blind < ROWS, "of a loop that has seen nothing for longer nothing is left to go on with"


def test_an_arm_that_floated_stands() -> None:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", ['floating.arms=["left"]'])
    floats = build_agent(cell, cell.arms[0])
    begun = beginning(floats, held_by_itself(STOP_AT)[0][:0], "x")
    assert (begun.mode, begun.zero_ns, begun.rows) == (Mode.STAND, 0, 0)


def test_without_any_row_the_hold_begins_as_an_arm_that_waits_does() -> None:
    begun = beginning(AGENT, held_by_itself(STOP_AT)[0][:0], "x")
    assert (begun.mode, begun.rows, begun.memory.hold, begun.memory.primed) == (Mode.HOLD, 0, None, False)
    assert last_seen(held_by_itself(STOP_AT)[0][:0], 3) is None


def begun_and_rows() -> tuple[Beginning, Any]:
    before, _ = held_by_itself(STOP_AT)
    return beginning(AGENT, before, ""), before


def test_the_first_step_counts_from_the_torque_that_the_servos_hold_where_it_is_another() -> None:
    begun, rows = begun_and_rows()
    sent = rows[-1]["tau_sent"][:3]
    held = sent + np.array([0.0005, 0.25, np.nan])  # within what a count says; written without a row; no answer
    tau = from_torque(begun, rows, held).memory.tau
    assert tau.tolist() == [begun.memory.tau[0], held[1], begun.memory.tau[2]]
    rows = rows.copy()
    rows["tau_sent"][-2, :3] += 0.1
    assert from_torque(begun, rows, sent + 0.0009) is begun
    assert from_torque(begun, rows, np.full(3, np.nan)) is begun
    beyond = sent + 0.0011
    assert from_torque(begun, rows, beyond).memory.tau.tolist() == beyond.tolist()
    assert from_torque(begun, rows[:0], sent).memory.tau.tolist() == sent.tolist(), "nobody knows what was sent"


@pytest.mark.parametrize("mark", [Flag.GAP, Flag.RESUMED])
def test_after_a_gap_or_without_torque_the_pose_is_found_anew(mark: Flag) -> None:
    before, _ = held_by_itself(STOP_AT)
    memory = beginning(AGENT, before, "", mark).memory
    assert (memory.hold, memory.primed) == (None, False)
    assert memory.tau.any() == (mark is Flag.GAP)


def test_what_was_seen_last_is_what_the_last_fresh_row_measured() -> None:
    _, rows = begun_and_rows()
    rows = rows.copy()
    rows["dq_measured"][-2, :3] = [0.1, 0.2, 0.3]
    rows["flags"][-1] |= int(Flag.STALE)
    for part in (rows, rows[:-1], rows[-2:]):
        seen = last_seen(part, 3)
        assert seen is not None
        assert (seen.stamp_ns, seen.q.tolist()) == (rows[-2]["stamp_ns"], rows[-2]["q_measured"][:3].tolist())
        assert seen.dq.tolist() == [0.1, 0.2, 0.3]
    assert last_seen(rows[-1:], 3) is None


CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["session.take_up_s=1.0"])
SESSION = build_agent(CELL, CELL.arms[0])


@pytest.mark.parametrize(
    ("before", "age_s", "stands"),
    [
        (Mode.REST, 9.0, Mode.REST),
        *((mode, 9.0, Mode.HALT) for mode in (Mode.APPROACH, Mode.GRASP, Mode.PARK, Mode.HALT)),
        *((mode, 0.1, Mode.HOLD) for mode in (Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER)),
        (Mode.RELEASE, 0.9, Mode.HOLD),  # its gripper has not been told to open
        (Mode.RELEASE, 1.0, Mode.HALT),
    ],
)
def test_an_arm_of_a_session_stands_as_it_holds_something_or_nothing(before: Mode, age_s: float, stands: Mode) -> None:
    assert stood_in(SESSION, before, initial_memory(SESSION)._replace(age=age_s)) is stands


def test_a_session_that_has_no_row_yet_stands_at_rest() -> None:
    none = held_by_itself(STOP_AT)[0][:0]
    assert beginning(SESSION, none, "x", session=True).mode is Mode.REST
    assert beginning(SESSION, none, "x").mode is Mode.HOLD


def test_a_session_whose_arm_is_at_rest_stays_there_and_one_that_carries_holds() -> None:
    rows = held_by_itself(STOP_AT)[0].copy()
    assert beginning(SESSION, rows, "x", session=True).mode is Mode.HOLD
    rows["mode"] = int(Mode.REST)
    assert beginning(SESSION, rows, "x", session=True).mode is Mode.REST
    assert beginning(SESSION, rows, "x").mode is Mode.HOLD


def test_an_arm_that_gives_back_and_of_which_nothing_more_is_known_stands_as_it_is() -> None:
    memory = initial_memory(AGENT)
    for agent, known in ((AGENT, memory), (SESSION, None)):
        assert stood_in(agent, Mode.RELEASE, known) is Mode.HALT
        assert stood_in(agent, Mode.APPROACH, known) is Mode.HALT
        assert stood_in(agent, Mode.TRACK, known) is Mode.HOLD
