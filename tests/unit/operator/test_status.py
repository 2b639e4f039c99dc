"""`coop status`: what an agent answers, what its ring says of one who is dead, and both as lines and as a document."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.host.clock import ClockState
from agent.host.paths import ring_path
from agent.log.parts import only_recorder
from agent.modes import Mode
from agent.operator import status as status_module
from agent.operator.ask import Heard, Silence
from agent.operator.local import Places
from agent.operator.past import look
from agent.operator.show import Tone, lines
from agent.operator.status import recorder, status
from agent.safety import Flag
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.command import coop
from tests.support.operated_arms import DEAD, HUNG, Arm, serving

PAPER = configs.CELLS_DIR / "paper.toml"
CELL = load_cell(PAPER)
CLOCK = ClockState(synchronised=True, max_error_s=2.5e-4)
NOW_NS = 1_700_000_000_000_000_000
UP_NS = 36_000_123_456_789  # CLOCK_MONOTONIC then
PERIOD_NS = 5_000_000
ROWS = 500


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the cell's agents; the time stands still."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("agent.host.paths.SERVICES_DIR", tmp_path / "services")
    stands = SimpleNamespace(time_ns=lambda: NOW_NS, monotonic_ns=lambda: UP_NS, sleep=lambda _: None)
    monkeypatch.setattr(status_module, "time", stands)
    folder = tmp_path / "coop" / "paper"
    folder.mkdir(parents=True)
    return folder


def write_ring(
    stack: ExitStack, arm: str, *, mode: Mode, age_ns: int, flags: int = 0, finished: bool = False,
    told: Sequence[tuple[Level, str]] = (), at: Path | None = None,
) -> None:  # fmt: skip
    """500 rows of a loop that was 1 ms late once, long ago, and 0.2 ms once; closed with the stack.

    told: at its end.
    """
    path = at or ring_path("paper", arm)
    texts = stack.enter_context(closing(TextWriter(path, arm)))
    texts.event(Event(NOW_NS - 5, arm, Level.WARN, "a servo is warm"))
    texts.event(Event(NOW_NS - 4, arm, Level.INFO, "torque on"))
    for level, text in told:
        texts.event(Event(NOW_NS - 3, arm, level, text))
    texts.health(
        NOW_NS - age_ns,
        {
            "servo_id": [1, 2], "joint": ["waist", "shoulder"], "temperature_C": [31.0, None],
            "voltage_V": [12.1, 11.8], "error_bits": [0, 4], "current_A": [None, None], "load": [None, None],
            "grip": [0.0439, None, 8.3, 9.1],
        },
    )  # fmt: skip
    ring = stack.enter_context(RingWriter(path, AGENT_STATE, arm, ("a",), slots=ROWS))
    for k in range(ROWS):
        row: Any = ring.row
        row["mode"], row["flags"], row["bus_timeouts"] = mode, flags, k // 250
        row_age_ns = age_ns + (ROWS - 1 - k) * PERIOD_NS
        row["stamp_ns"], row["utc_ns"] = UP_NS - row_age_ns, NOW_NS - row_age_ns
        row["late_s"] = {20: 1e-3, 450: 2e-4}.get(k, 1e-5)
        row["read_s"], row["step_s"], row["write_s"] = 1e-3, 5e-4, 1e-4
        if k == 499 and flags & Flag.STALE:
            row["flags"], row["late_s"] = flags, np.nan
        ring.commit()
    if finished:
        ring.finish()


@pytest.fixture
def living(home: Path) -> Iterator[Arm]:
    """Arm left in HOLD, with its ring."""
    arm = Arm(home / "left.control", Mode.HOLD, CELL.fingerprint)
    with ExitStack() as stack:
        write_ring(stack, "left", mode=Mode.HOLD, age_ns=2_000_000, flags=int(Flag.OFF_TRACK | Flag.SATURATED))
        stack.enter_context(serving([arm]))
        assert arm.control is not None
        arm.control.standing.reason = "t = 3 s: OFF_TRACK"
        arm.control.standing.details = lambda: {"pid": 7, "driver": "dynamixel", "start_utc_ns": 5}
        yield arm


def of(document: dict[str, Any], name: str) -> dict[str, Any]:
    (found,) = (arm for arm in document["arms"] if arm["arm"] == name)
    assert isinstance(found, dict)
    return found


def test_a_living_arm_is_shown_with_all_it_has(living: Arm) -> None:
    found = of(status(CELL, CLOCK, logs=()), "left")
    assert found == {
        "arm": "left", "answers": True, "silence": None, "alive": True, "ended": False, "failed": None,
        "failed_utc_ns": None,
        "mode": "HOLD", "reason": "t = 3 s: OFF_TRACK", "same_cell": True, "pid": 7, "driver": "dynamixel",
        "real_time": None, "guard": None, "no_start": None, "session": None, "drops_on_stop": None,
        "clock_bound_s": None,
        "start_utc_ns": 5, "last_row_age_s": pytest.approx(0.002),
        "timing": {
            "rows": 400, "without_state": 0, "rate_hz": pytest.approx(200.0), "late_p99_s": 1e-5, "late_max_s": 2e-4,
            "busy_p99_s": pytest.approx(1.6e-3), "busy_max_s": pytest.approx(1.6e-3),
        },
        "errors": {
            "flags": ["SATURATED", "OFF_TRACK"], "bus_timeouts": 1, "bus_corrupt": 0, "bus_alerts": 0, "bus_retries": 0,
            "servos": [{"servo_id": 2, "joint": "shoulder", "bits": 4}],
            "last": "a servo is warm", "last_utc_ns": NOW_NS - 5,
        },
        "servos": {
            "max_C": 31.0, "joint": "waist", "servo_id": 1, "min_V": 11.8,
            "grip": {"width_m": 0.0439, "width_cmd_m": None, "force_N": 8.3, "force_max_N": 9.1},
        },
    }  # fmt: skip


def test_a_dead_arm_is_said_to_be_dead_with_what_its_ring_has(living: Arm, home: Path) -> None:
    with ExitStack() as stack:
        write_ring(stack, "right", mode=Mode.TRACK, age_ns=3_200_000_000)
    dead = Arm(home / "right.control", DEAD)
    with serving([dead]):
        document = status(CELL, CLOCK, logs=[Path("runs")])
    found = of(document, "right")
    assert (found["answers"], found["silence"], found["alive"]) == (False, "Connection refused", False)
    assert (found["mode"], found["last_row_age_s"], found["same_cell"]) == ("TRACK", pytest.approx(3.2), None)
    shown = lines(document)
    assert [(line.head, line.tone) for line in shown] == [
        ("left   HOLD ", Tone.HELD), ("right  DEAD ", Tone.BAD), (f"host {document['host']}", Tone.HELD)
    ]  # fmt: skip
    assert shown[0].rest == (
        "t = 3 s: OFF_TRACK; 200 Hz, late ≤ 0.20 ms, busy ≤ 1.60 ms; 31 °C waist, 11.8 V, grip 43.9 mm 8 N; "
        "SATURATED, OFF_TRACK, servo 2 (shoulder) error 0x04, 1 bus timeouts"
    )
    assert shown[1].rest.startswith("Connection refused; last TRACK, 3.2 s ago; 200 Hz")
    assert shown[2].rest == "clock synchronised, error ≤ 0.25 ms; no recorder in runs"


@pytest.mark.parametrize(("mode", "tone"), [(Mode.HOLD, Tone.HELD), (Mode.FAULT, Tone.BAD)])
def test_an_arm_whose_agent_has_ended_in_order_is_not_said_to_be_dead(home: Path, mode: Mode, tone: Tone) -> None:
    with ExitStack() as stack:
        write_ring(stack, "right", mode=mode, age_ns=3_200_000_000, finished=True)
        assert not of(status(CELL, CLOCK, logs=()), "right")["ended"], "its process lives"
    document = status(CELL, CLOCK, logs=())
    found = of(document, "right")
    assert (found["answers"], found["alive"], found["ended"], found["mode"]) == (False, False, True, mode.name)
    line = lines(document)[1]
    assert (line.head, line.tone) == ("right  ENDED", tone)
    assert line.rest.startswith(f"last {mode.name}, 3.2 s ago; 200 Hz")


LOST = (Level.ERROR, "run ended in FAULT no cycle for 0.766 s")
WARNED = (Level.WARN, "no post-mortem: the disk is full")
OVER = (Level.INFO, "run ended in OFF it was asked to")


@pytest.mark.parametrize(
    ("told", "failed"), [([LOST], True), ([LOST, WARNED], True), ([LOST, OVER], False), ([OVER, WARNED], False)]
)
def test_an_arm_whose_agent_ended_by_an_error_has_not_ended_in_order_and_says_which(
    home: Path, told: list[tuple[Level, str]], failed: bool
) -> None:
    """OVER behind LOST: a guard held the arm that its agent had lost, and was told to release it."""
    with ExitStack() as stack:
        write_ring(stack, "right", mode=Mode.TRACK, age_ns=3_200_000_000, finished=True, told=told)
        alive = of(status(CELL, CLOCK, logs=()), "right")
        assert (alive["failed"], alive["ended"]) == (None, False), "its process lives"
    document = status(CELL, CLOCK, logs=())
    found = of(document, "right")
    assert (found["ended"], found["failed"]) == (not failed, LOST[1] if failed else None)
    line = lines(document)[1]
    assert line.head.split()[-1] == ("DEAD" if failed else "ENDED")
    assert line.tone is (Tone.BAD if failed else Tone.HELD)
    why = f"{LOST[1]} (at 2023-11-14 22:13:19 UTC); " if failed else ""
    assert line.rest.startswith(f"{why}last TRACK, 3.2 s ago")


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_a_step_of_the_wall_clock_is_no_age_of_a_living_arm_s_last_row(living: Arm, step_s: int) -> None:
    past = look([ring_path("paper", "left")], 200.0)
    assert past is not None
    assert past.age_s(UP_NS, NOW_NS + step_s * 10**9) == pytest.approx(0.002)


def test_utc_tells_how_old_a_row_is_that_a_restart_of_the_host_or_lockstep_left(living: Arm) -> None:
    past = look([ring_path("paper", "left")], 200.0)
    assert past is not None
    restarted = replace(past, written_by_the_living=False)
    assert restarted.age_s(5_000_000_000, NOW_NS) == pytest.approx(0.002)
    rows = past.rows.copy()
    rows["stamp_ns"] += (rows["utc_ns"] - rows["stamp_ns"]) % 10**9
    assert replace(past, rows=rows).age_s(UP_NS + 10**15, NOW_NS) == pytest.approx(0.002)
    assert replace(past, rows=past.rows[:0]).age_s(UP_NS, NOW_NS) is None


def test_nothing_of_an_earlier_run_is_shown_of_an_arm_that_answers_but_what_its_own_ring_says(home: Path) -> None:
    """A ring that nobody writes any more is where the agent's would be, as after a run of another kind."""
    arm = Arm(home / "left.control", Mode.HOLD, CELL.fingerprint)
    with ExitStack() as stack:
        write_ring(stack, "left", mode=Mode.TRACK, age_ns=829_000_000_000)
    with serving([arm]):
        before = of(status(CELL, CLOCK, logs=()), "left")
        assert (before["mode"], before["timing"], before["servos"], before["last_row_age_s"]) == (
            "HOLD", None, None, None,
        )  # fmt: skip
        assert arm.control is not None
        elsewhere = home / "elsewhere.ring"
        arm.control.standing.details = lambda: {"ring": str(elsewhere)}
        assert of(status(CELL, CLOCK, logs=()), "left")["timing"] is None, "not there yet"
        with ExitStack() as stack:
            write_ring(stack, "left", mode=Mode.HOLD, age_ns=2_000_000, at=elsewhere)
            own = of(status(CELL, CLOCK, logs=()), "left")
        assert (own["last_row_age_s"], own["timing"]["rows"]) == (pytest.approx(0.002), 400)
        over = of(status(CELL, CLOCK, logs=()), "left")
        assert over["timing"] is None, "nobody writes it any more"
    assert of(status(CELL, CLOCK, logs=()), "left")["mode"] == "TRACK", "who does not answer is known by its last ring"


def test_an_arm_that_hangs_is_not_dead_and_one_without_a_trace_is_neither(home: Path) -> None:
    hung = Arm(home / "left.control", HUNG)
    with ExitStack() as stack:
        write_ring(stack, "left", mode=Mode.READY, age_ns=1)
        stack.enter_context(serving([hung]))
        document = status(CELL, CLOCK, logs=(), timeout_s=0.05)
    assert (of(document, "left")["alive"], of(document, "left")["answers"]) == (True, False)
    assert [line.head.split()[-1] for line in lines(document)[:2]] == ["HUNG", "NONE"]
    assert of(document, "right")["timing"] is None


@pytest.mark.parametrize("looks", [1, 5, 6])
def test_an_arm_hangs_that_stays_silent_and_not_while_its_guard_takes_it_over(
    living: Arm, monkeypatch: pytest.MonkeyPatch, looks: int
) -> None:
    """Its agent resets the connection as it ends; the guard writes its ring, and listens a moment later."""
    left, asked = [Silence("Connection reset by peer", hung=True)] * looks, status_module.ask_arms

    def heard(meant: Places, *given: Any) -> dict[str, Heard]:
        return {**asked(meant, *given), **({"left": left.pop()} if left and "left" in meant else {})}

    monkeypatch.setattr(status_module, "ask_arms", heard)
    (shown, *_) = lines(status(CELL, CLOCK, logs=()))
    assert shown.head.split()[-1] == ("HUNG" if looks > 5 else "HOLD")


def test_an_agent_that_has_made_no_cycle_yet_is_starting_and_nothing_of_the_one_before_is_shown(home: Path) -> None:
    with ExitStack() as stack:
        path = ring_path("paper", "left")
        stack.enter_context(closing(TextWriter(path, "left")))
        stack.enter_context(RingWriter(path, AGENT_STATE, "left", ("a",), slots=ROWS))
        stack.enter_context(serving([Arm(home / "left.control", HUNG)]))
        shown = lines(status(CELL, CLOCK, logs=(), timeout_s=0.05))[0]
    assert (shown.head.split()[-1], shown.tone) == ("STARTING", Tone.HELD)
    assert shown.rest == "no answer within 0.05 s: it loads or connects, and has made no cycle yet"


def test_the_guide_asks_the_same_and_says_by_its_exit_code_that_an_arm_is_missing(living: Arm, home: Path) -> None:
    with ExitStack() as stack:
        failed = [(Level.ERROR, "arm right: found no answer")]
        write_ring(stack, "right", mode=Mode.TRACK, age_ns=5, finished=True, told=failed)
    done = coop("guide", PAPER, "--once")
    assert done.code == 1
    assert done.out.splitlines()[:2] == [
        "left: HOLD: the arms hold the object and stand; t = 3 s: OFF_TRACK",
        "right: DEAD; arm right: found no answer (at 2023-11-14 22:13:19 UTC); last TRACK",
    ]
    with serving([Arm(home / "right.control", Mode.REST, CELL.fingerprint, session=True)]):
        assert coop("guide", PAPER, "--once").code == 0
    given = coop("guide", PAPER, "--once", "--control", home / "left.control")
    assert given.code == 0
    assert given.out.startswith(f"{home / 'left.control'}: HOLD: ")


@pytest.mark.parametrize(("age_ns", "head"), [(1, "FLOAT"), (2_000_000_000, "HUNG")])
def test_an_arm_that_floats_listens_to_nobody_and_does_not_hang(home: Path, age_ns: int, head: str) -> None:
    with ExitStack() as stack:
        write_ring(stack, "left", mode=Mode.FLOAT, age_ns=age_ns)
        shown = lines(status(CELL, CLOCK, logs=(), timeout_s=0.05))[0]
    assert shown.head.split()[-1] == head
    assert shown.rest.startswith("listens to nobody; ") == (head == "FLOAT")


def test_a_cycle_without_a_state_counts_and_has_no_timing(home: Path) -> None:
    with ExitStack() as stack:
        write_ring(stack, "left", mode=Mode.TRACK, age_ns=1, flags=int(Flag.STALE))
    past = look([ring_path("paper", "left")], 200.0)
    assert past is not None
    assert past.timing()["without_state"] == 400
    assert past.timing()["late_max_s"] is None
    assert "STALE" in past.errors()["flags"]


def test_an_agent_with_another_cell_file_is_called_that(home: Path) -> None:
    with serving([Arm(home / "left.control", Mode.READY, "cd" * 32)]):
        document = status(CELL, CLOCK, logs=())
    assert of(document, "left")["same_cell"] is False
    assert (lines(document)[0].rest, lines(document)[0].tone) == ("RUNS OTHER SETTINGS THAN THIS FILE", Tone.BAD)


def test_a_reason_is_whole_but_where_the_table_is_shown_again_and_again(living: Arm) -> None:
    assert living.control is not None
    reason = "servo 3 (elbow) is at 71 °C, expected below 70 °C; let it cool, see what it carries, and lower the object"
    living.control.standing.reason = reason
    whole = status(CELL, CLOCK, logs=())
    assert lines(whole)[0].rest.startswith(f"{reason}; 200 Hz")
    assert lines(whole, live=True)[0].rest.startswith(f"{reason[:59]}…; 200 Hz")
    assert coop("status", PAPER).out.splitlines()[0].split("HOLD   ")[1].startswith(f"{reason}; ")
    living.control.standing.reason = reason[:60]
    assert lines(status(CELL, CLOCK, logs=()), live=True)[0].rest.startswith(f"{reason[:60]}; 200 Hz")


def test_an_arm_that_would_refuse_the_start_says_so_in_front(living: Arm) -> None:
    assert living.control is not None
    why = {"found": "SCHED_OTHER 0", "expected": "SCHED_FIFO on a real arm", "remedy": "give --priority 80"}
    living.control.standing.details = lambda: {"no_start": why}
    shown = lines(status(CELL, CLOCK, logs=()))[0]
    assert "NO START: SCHED_OTHER 0, expected SCHED_FIFO on a real arm; give --priority 80; 200 Hz" in shown.rest, (
        shown.rest
    )
    assert shown.tone is Tone.BAD


@pytest.mark.parametrize(
    ("driver", "guard", "lets_go", "said"),
    [
        ("dynamixel", None, False, True), ("dynamixel", "watches", False, False), ("dynamixel", None, True, False),
        ("sim", None, False, False),
    ],
)  # fmt: skip
def test_an_arm_with_servos_that_nobody_else_would_hold_has_no_guard(
    living: Arm, driver: str, guard: str | None, lets_go: bool, said: bool
) -> None:
    assert living.control is not None
    living.control.standing.details = lambda: {"driver": driver, "guard": guard, "drops_on_stop": lets_go}
    document = status(CELL, CLOCK, logs=())
    (shown, *_) = lines(document)
    assert ("NO GUARD" in shown.rest) is said
    assert of(document, "left")["guard"] == guard
    assert shown.tone is (Tone.BAD if said else Tone.HELD)


@pytest.mark.parametrize("whole", [False, True])
def test_an_arm_that_answers_says_whether_it_is_one_of_a_session_and_lets_go_at_a_stop(
    living: Arm, *, whole: bool
) -> None:
    assert living.control is not None
    living.control.standing.details = lambda: {"session": whole, "drops_on_stop": not whole}
    found = status(CELL, CLOCK, logs=())["arms"][0]
    assert found["session"] is whole
    assert found["drops_on_stop"] is not whole


def test_a_recorder_at_work_is_found_by_its_lock_which_nobody_takes(tmp_path: Path) -> None:
    (tmp_path / "one.mcap").write_bytes(b"x" * 10)
    (tmp_path / "removed.mcap").symlink_to("nowhere")  # as one that is gone by the time it is looked at
    places = [tmp_path / "none", tmp_path]
    looked_in = {"looked_in": [str(place) for place in places]}
    nothing = {"alive": False, "folder": None, "log": None, "log_bytes": None, "left_out": {}, **looked_in}
    with only_recorder(tmp_path, "paper") as note:
        found = recorder("paper", places)
        known = {"alive": True, "folder": str(tmp_path), "log": "one.mcap", "log_bytes": 10, **looked_in}
        assert found == {**known, "left_out": {}}
        note(b'{"left_out": {"unknown_key": 12}}')
        note(b'{"left_out": {"wrong_order": 3}}')
        assert recorder("paper", places) == {**known, "left_out": {"wrong_order": 3}}
        for garbage in (b"{", b"[]", b'{"left_out": 1}', b'{"left_out": {"a": []}}', b"\xff"):
            note(garbage)
            assert recorder("paper", places) == {**known, "left_out": {}}
        note(b'{"left_out": {"wrong_order": 3}}')
        assert recorder("other", places) == nothing
    assert recorder("paper", places) == nothing, "the lock file stays, its lock does not"
    with only_recorder(tmp_path, "paper"):
        assert recorder("paper", places)["left_out"] == {}, "of the recorder before"


def test_the_command_shows_a_line_per_arm_without_colours_and_one_document(living: Arm, tmp_path: Path) -> None:
    done = coop("status", PAPER, "--logs", tmp_path)
    assert done.code == 1
    assert [line.split()[:2] for line in done.out.splitlines()[:2]] == [["left", "HOLD"], ["right", "NONE"]]
    assert "\x1b" not in done.out
    done = coop("status", PAPER, "--json", "--logs", tmp_path)
    found = json.loads(done.out)
    assert (done.code, found["schema"], found["fingerprint"]) == (1, 1, CELL.fingerprint)
    assert list(found) == ["schema", "cell", "fingerprint", "host", "utc_ns", "clock", "recorder", "arms"]
    assert of(found, "left")["mode"] == "HOLD"


def test_what_the_recorder_left_out_is_said_and_is_not_good(monkeypatch: pytest.MonkeyPatch) -> None:
    quiet: dict[str, Any] = {
        "alive": True, "folder": "runs", "log": None, "log_bytes": None, "left_out": {}, "looked_in": ["runs"],
    }  # fmt: skip
    for left_out, tone, said in (
        ({}, Tone.GOOD, ""),
        (
            {"unknown_key": 2, "wrong_order": 1},
            Tone.HELD,
            "; LEFT OUT what does not belong here: 2 unknown_key, 1 wrong_order",
        ),
    ):
        monkeypatch.setattr("agent.operator.status.recorder", lambda *_, found=left_out: {**quiet, "left_out": found})
        shown = lines(status(CELL, CLOCK, logs=()))[-1]
        assert (shown.tone, shown.rest) == (tone, f"clock synchronised, error ≤ 0.25 ms; recorder in runs{said}")


@pytest.mark.parametrize(("error_s", "said"), [(2.5e-4, "0.25 ms"), (0.9994, "999 ms"), (1.0, "1 s"), (16.0, "16 s")])
def test_a_clock_that_may_be_off_by_long_is_told_in_seconds(living: Arm, error_s: float, said: str) -> None:
    shown = lines(status(CELL, ClockState(synchronised=False, max_error_s=error_s), logs=()))[-1]
    assert shown.rest.startswith(f"clock not synchronised, error ≤ {said}; ")


@pytest.mark.parametrize(("force_N", "said"), [(8.3, " 8 N"), (-0.4, " 0 N"), (-1.0, " -1 N"), (None, "")])
def test_a_gripper_that_presses_on_nothing_has_no_negative_zero_of_force(
    living: Arm, force_N: float | None, said: str
) -> None:
    document = status(CELL, CLOCK, logs=())
    of(document, "left")["servos"]["grip"] |= {"width_m": 0.039, "force_N": force_N}
    (shown,) = (line for line in lines(document) if line.head.startswith("left"))
    assert f"V, grip 39.0 mm{said}; " in shown.rest
