"""What a guard does at a takeover before the servos have a torque, and what it has done long before."""

from __future__ import annotations

import fcntl
import os
from collections import defaultdict
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.around import RunSummary, Schedule
from agent.config.agent import build_agent
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.host.notify import Notifier
from agent.host.signals import StopFlag
from agent.modes import Mode
from agent.operator.ask import ask_sockets
from agent.operator.message import Reply, Request
from agent.operator.socket import Standing
from agent.operator.table import Verb
from agent.process import float_successor
from agent.process import successor as process
from agent.process.commands import GuardOptions
from agent.process.float_successor import FloatSuccessor
from agent.process.hearing import Hearing
from agent.process.successor import Successor
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.standby import StandbyDriver
from drivers.interface import Refusal, ServoHealth

SUMMARY = RunSummary(ticks=1, late_cycles=0, stale_cycles=0, mode=Mode.OFF, reason="", tracked_s=0.0)
CELL = load_cell(Path("two_wx200"))


def made(folder: Path, *, hold: bool = True) -> Successor:
    arm = CELL.arm("left")
    given = GuardOptions(
        cell=Path(), arm="left", driver=DriverKind.DYNAMIXEL, socket=folder / "guard", control=folder / "left.control",
        post_mortem=folder, hold=hold,
    )  # fmt: skip
    return Successor(CELL, arm, build_agent(CELL, arm), given, StopFlag(), Notifier(""))


def test_the_servos_have_a_torque_before_words_are_heard_and_bounds_are_there_already(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    guard, done = made(tmp_path, hold=False), list[str]()

    def go_on(_: Any, __: Any, ___: Any, ____: Any, schedule: Schedule, *_____: Any, **______: Any) -> Any:
        done.append("torque")
        assert schedule.hold_at_end, "whatever the agent would have done at its end"
        assert not schedule.lockstep
        raise Refusal("arm left", found="that this is enough", expected="a test", remedy="none")

    monkeypatch.setattr(process, "go_on", go_on)
    monkeypatch.setattr(process, "ControlSocket", lambda *_: done.append("words"))
    monkeypatch.setattr(process.monitors, "bounds", lambda *_: done.append("bounds"))
    texts = SimpleNamespace(finish=lambda: None, event=lambda _: None)
    watched: Any = SimpleNamespace(
        last_rows=lambda: np.zeros(0, AGENT_STATE.dtype), texts=texts, writer=texts, inherit=lambda _: None,
        handed_over=False,
    )  # fmt: skip
    with pytest.raises(Refusal, match="this is enough"):
        guard.hold(watched, SimpleNamespace(), "the agent has died", session=False)  # type: ignore[arg-type]
    assert done == ["torque"]


@pytest.mark.parametrize("hold", [False, True])
def test_a_guard_in_the_place_of_an_agent_says_whether_a_stop_ends_its_hold(tmp_path: Path, *, hold: bool) -> None:
    standing = Standing("left")
    control: Any = SimpleNamespace(standing=standing)
    watched: Any = SimpleNamespace(
        texts=None, writer=SimpleNamespace(row=defaultdict(float), written=0), ring=Path("/run/left.ring")
    )
    tell: Any = SimpleNamespace(event=None, trouble=None)
    clock: Any = SimpleNamespace(utc_offset_ns=0)
    made(tmp_path, hold=hold)._around(
        control,
        standing,
        Any,
        watched,
        clock,
        tell,
        Any,
        Mode.HOLD,
        Any,
    )
    assert standing.details()["drops_on_stop"] is not hold
    assert standing.details()["ring"] == "/run/left.ring", "that of its agent, where its rows go on"


def test_a_hold_that_could_not_listen_tries_again_and_hears_words_then(tmp_path: Path) -> None:
    """Any reader of the folder may keep it for a moment."""
    told, standing, guard = list[str](), Standing("left", Mode.HOLD, "the agent has died"), made(tmp_path)
    tell: Any = SimpleNamespace(event=lambda _, text: told.append(text), trouble=None)
    watched: Any = SimpleNamespace(
        texts=None, writer=SimpleNamespace(row=defaultdict(float), written=0), inherit=lambda _: None, ring=Path()
    )
    clock: Any = SimpleNamespace(utc_offset_ns=0, now_ns=lambda: 0)
    black_box: Any = SimpleNamespace(beat=lambda: None)
    driver: Any = SimpleNamespace(health=lambda: ServoHealth.none(0))
    kept = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(kept, fcntl.LOCK_EX)
    second = round(CELL.file.rate_hz)
    with ExitStack() as stack:
        agent: Any = SimpleNamespace(ended=True)
        hearing = Hearing(tmp_path / "left.control", CELL.fingerprint, standing, agent, tell, stack, CELL.file.rate_hz)
        deaf = hearing.begin()
        assert deaf is None
        around = guard._around(deaf, standing, driver, watched, clock, tell, black_box, Mode.HOLD, hearing)
        for _ in range(2 * second):
            around.heartbeat()
        os.close(kept)
        around.mode_changed(Mode.OFF)
        for _ in range(second - 1):
            around.heartbeat()
        assert not (tmp_path / "left.control").exists(), "once a second"
        around.heartbeat()
        assert [text.partition(":")[0] for text in told] == [
            f"no word reaches this hold, SIGUSR1 to process {os.getpid()} releases it",
            "words reach this hold from here on",
        ]

        def poll() -> None:
            around.operator()

        request = Request(Verb.STATUS)
        (heard,) = ask_sockets([tmp_path / "left.control"], request, look=poll).values()
        assert isinstance(heard, Reply)
        assert heard.mode == "OFF", "which it was told of while it was deaf"
        for _ in range(second):
            around.heartbeat()
    assert len(told) == 2
    assert not (tmp_path / "left.control").exists()


@pytest.mark.parametrize("told", [(), ("floating.holding=true", "floating.others_move=true")])
def test_what_lets_a_floating_arm_down_has_its_bounds_before_the_takeover(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, told: tuple[str, ...]
) -> None:
    """To work them out takes longer than LimitRTTIME leaves a real-time process, and the servos wait for a torque."""
    cell, done = load_cell(Path("two_wx200"), ['floating.arms=["left"]', *told]), list[str]()
    arm = cell.arm("left")
    guard = FloatSuccessor(cell, arm, build_agent(cell, arm), Notifier(""), shared=False)
    monkeypatch.setattr(process.monitors, "bounds", lambda *_: done.append("bounds"))
    monkeypatch.setattr(float_successor, "go_on", lambda *_, **__: done.append("torque"))
    monkeypatch.setattr(float_successor.FloatLoop, "run", lambda *_: done.append("loop") or SUMMARY)
    driver = object.__new__(StandbyDriver)
    monkeypatch.setattr(StandbyDriver, "disable", lambda _: done.append("off"))
    monkeypatch.setattr(StandbyDriver, "close", lambda _: None)
    texts = SimpleNamespace(finish=lambda: None, event=lambda _: None)
    rows = np.zeros(1, AGENT_STATE.dtype)
    writer = SimpleNamespace(finish=lambda: None, row=rows)
    watched: Any = SimpleNamespace(last_rows=lambda: rows[:0], texts=texts, writer=writer, inherit=lambda _: None)
    assert guard.hold(watched, driver, "the agent has died", session=False) is SUMMARY
    assert done == ["torque", "loop", "off"]
