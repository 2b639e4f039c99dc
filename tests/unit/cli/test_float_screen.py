"""What `coop float` asks and shows of an arm: a table on a terminal, a line elsewhere, a document for scripts."""

from __future__ import annotations

import io
import json
import math
import os
import select
import signal
import sys
from pathlib import Path

import pytest
import typer
from rich.console import Console

from agent.cli.floats import STOPS, Shown, line, tables
from agent.modes import Mode
from agent.process.glance import Glance, JointGlance
from tests.support.command import coop

PATIENCE_S = 30.0
ELBOW = JointGlance("elbow", 0.5, -0.25, 0.04, 0.237, 41.0)
WRIST = JointGlance("wrist_angle", -0.1, 0.0, 1.2, 0.05, math.nan)
SEEN = Glance(
    "left", Mode.FLOAT, 12.3, (ELBOW, WRIST), (0.31, 0.0, 0.22), (0.0, math.pi / 6, 0.0), ("a servo is warm",)
)


def test_a_table_has_joints_pose_load_limits_and_words() -> None:
    console = Console(file=io.StringIO(), width=120)
    console.print(tables([SEEN], 120))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for part in ("left  FLOAT  12.3 s", "+0.5000", "+28.6", "-0.25", "0.04 rad", "24%", "41", "+0.3100", "pitch +30.0°",
                 "a servo is warm", STOPS):  # fmt: skip
        assert part in text, part


@pytest.mark.parametrize(
    ("width", "headings"),
    [
        (68, ["joint", "rad", "°", "rad/s", "to its limit", "load", "°C"]),
        (60, ["joint", "rad", "rad/s", "to its limit", "load", "°C"]),
        (52, ["joint", "rad", "to its limit", "load", "°C"]),
        (45, ["joint", "rad", "to its limit", "°C"]),
    ],
)
def test_a_narrow_table_leaves_columns_out_degrees_first_and_cuts_no_name(width: int, headings: list[str]) -> None:
    console = Console(file=io.StringIO(), width=width)
    console.print(tables([SEEN], width))
    drawn = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    head = next(row for row in drawn if "joint" in row)
    assert [cell.strip() for cell in head.split("┃")[1:-1]] == headings
    assert sum("wrist_angle" in row and "1.20 rad" in row for row in drawn) == 1
    assert all(len(row) <= width for row in drawn)


def test_a_line_and_a_document_say_the_same() -> None:
    assert line(SEEN) == "   12.3 s  left FLOAT  elbow +0.500  wrist_angle -0.100 rad  at +0.310 +0.000 +0.220 m"
    unseen = Glance("left", Mode.STAND, 2.9, (JointGlance("elbow", *[math.nan] * 5),))
    assert line(unseen) == "    2.9 s  left STAND  not seen: its servos do not answer"
    document = json.loads(json.dumps(SEEN.document(), allow_nan=False))
    assert (document["arm"], document["mode"], document["said"]) == ("left", "FLOAT", ["a servo is warm"])
    assert document["joints"][0] == {
        "name": "elbow", "q_rad": 0.5, "dq_rad_per_s": -0.25, "room_rad": 0.04, "load": 0.237, "temperature_C": 41.0,
    }  # fmt: skip
    assert document["joints"][1]["temperature_C"] is None
    assert Glance("left", Mode.OFF).document()["p_m"] == [None] * 3


def test_what_an_arm_says_is_told_once_and_nothing_before_its_first_row(capsys: pytest.CaptureFixture[str]) -> None:
    with Shown(as_json=False) as shown:
        shown.show([Glance("left", Mode.OFF)])
        shown.show([SEEN])
        shown.note("the log ends here")
        shown.show([SEEN])
    told = capsys.readouterr()
    assert told.err == "left: a servo is warm\nthe log ends here\n"
    assert told.out == f"{line(SEEN)}\n"
    with Shown(as_json=False) as shown:
        shown.show([SEEN.off()])
        shown.show([SEEN.off()])
    assert capsys.readouterr() == ("", "left: a servo is warm\nleft: torque off\n")


def test_an_arm_without_torque_is_one_line_of_the_table_and_has_no_joints_in_a_document() -> None:
    console = Console(file=io.StringIO(), width=120)
    console.print(tables([SEEN.off(), Glance("right", Mode.OFF)], 120))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert text.splitlines()[:4] == ["left  OFF", "  a servo is warm", "  torque off", "right  OFF"]
    document = SEEN.off().document()
    assert (document["mode"], document["joints"], document["said"][-1]) == ("OFF", [], "torque off")


def test_on_a_terminal_the_table_takes_the_place_of_the_spinner(monkeypatch: pytest.MonkeyPatch) -> None:
    """While rich draws a spinner, what it puts before standard output says that it is no terminal."""
    ours, theirs = os.openpty()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with os.fdopen(theirs, "w") as terminal, monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", terminal)
        patched.setattr(sys, "stderr", terminal)
        with Shown(as_json=False) as shown:
            shown.phase("torque on")
            shown.show([SEEN])
            drawn = ""
            while STOPS not in drawn and select.select([ours], [], [], PATIENCE_S)[0]:
                drawn += os.read(ours, 1 << 16).decode()
    os.close(ours)
    assert "torque on" in drawn
    assert "left  FLOAT  12.3 s" in drawn
    assert "to its limit" in drawn


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_at_the_question_ends_the_command_and_no_arm_gets_torque(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[str] = []

    def confirm(question: str, *, err: bool) -> bool:
        assert err
        asked.append(question)
        signal.raise_signal(number)
        return True

    monkeypatch.setattr(typer, "confirm", confirm)
    monkeypatch.setattr("agent.process.floating_cell.require_usable", lambda _: None)
    monkeypatch.setattr("agent.process.floating_arms.float_arms", lambda *_: pytest.fail("an arm floats"))
    monkeypatch.setattr("agent.cli.options.in_front", lambda: True)
    done = coop("float", "two_wx200", "--arm", "left", "--out", tmp_path / "out")
    assert (done.code, done.out, done.err) == (130, "", "")
    assert [question[:22] for question in asked] == ["Is arm left supported "]


@pytest.mark.parametrize("answer", ["n\n", "\n"])
def test_a_no_at_the_question_ends_with_1_and_no_arm_gets_torque(
    answer: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("agent.process.floating_cell.require_usable", lambda _: None)
    monkeypatch.setattr("agent.process.floating_arms.float_arms", lambda *_: pytest.fail("an arm floats"))
    monkeypatch.setattr("agent.cli.options.in_front", lambda: True)
    done = coop("float", "two_wx200", "--arm", "left", "--out", tmp_path / "out", stdin=answer)
    assert (done.code, done.out.strip()) == (1, "")
    assert done.err.endswith("no arm floats: nobody has said yes; support them and answer yes, or give --yes\n")
    assert not list(tmp_path.iterdir())


def test_ports_are_refused_for_emulated_servos(tmp_path: Path) -> None:
    done = coop("float", "two_wx200", "--arm", "left", "--emulate", "--ports", tmp_path, "--out", tmp_path / "out")
    assert done.code == 2
    assert "coop: --ports with --emulate: found two answers to which servos are meant" in done.err
    assert not (tmp_path / "out").exists()
