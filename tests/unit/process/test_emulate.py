"""Emulated servos whose ports, faults or control socket cannot be had: refused, with nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.config.cell import load_cell
from agent.config.servo_map import GRIPPER, fingers_of
from agent.config.session import fingers, grip_width
from agent.process.emulate import (
    EmulateError,
    about_the_object,
    run_emulate,
    run_emulate_alone,
    wiring,
    with_fingers,
)
from sim_backend.wire.faults import FaultError
from sim_backend.wire.serve import ServeOptions
from tests.support.starts import start_joints

CELL = load_cell(configs.CELLS_DIR / "paper.toml")


def options(folder: Path) -> ServeOptions:
    ports = {arm.name: folder / "ports" / arm.name for arm in CELL.arms}
    return ServeOptions(ports, faults_file=None, control_socket=None, seed=0)


def emulate(given: ServeOptions, folder: Path, ready: Callable[[str], None] = lambda _: None) -> str:
    ring = folder / "ring"
    return run_emulate(CELL, given, ring, timing=False, stop=lambda: True, ready=ready)  # type: ignore[arg-type]


def test_ports_appear_in_a_folder_that_was_not_there(tmp_path: Path) -> None:
    assert emulate(options(tmp_path), tmp_path).startswith("emulator:")


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"ports": {"left": Path("FILE/left"), "right": Path("FILE/right")}}, "File exists|Not a directory"),
        ({"faults_file": Path("none.jsonl")}, "No such file"),
        ({"faults_file": Path("FILE")}, "no text"),
        ({"control_socket": Path("nowhere/control")}, "No such file"),
    ],
)
def test_what_cannot_be_used_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], found: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("FILE").write_bytes(b"\xff")
    told = list[str]()
    with pytest.raises((EmulateError, FaultError), match=found):
        emulate(replace(options(tmp_path), **changes), tmp_path, told.append)
    assert told == [], "nobody is told that it is ready"
    assert not (tmp_path / "ports" / "left").exists()


def test_who_hears_that_it_is_ready_finds_its_ports(tmp_path: Path) -> None:
    given, seen = options(tmp_path), list[bool]()
    emulate(given, tmp_path, lambda _: seen.append(all(port.exists() for port in given.ports.values())))
    assert seen == [True]


def test_arms_on_their_own_are_ready_with_their_ports(tmp_path: Path) -> None:
    cell = load_cell(configs.CELLS_DIR / "paper_real.toml", ['hil.arms=["left"]'])
    given, seen = options(tmp_path), list[bool]()

    def ready(what: str) -> None:
        seen.append(given.ports["left"].exists() and not given.ports["right"].exists() and what == "arms=left")

    run_emulate_alone(cell, given, timing=False, stop=lambda: True, ready=ready)  # type: ignore[arg-type]
    with pytest.raises(FaultError, match=r"faults file none\.jsonl: found No such file"):
        run_emulate_alone(
            cell, replace(given, faults_file=Path("none.jsonl")), timing=False, stop=lambda: True, ready=ready,  # type: ignore[arg-type]
        )  # fmt: skip
    assert seen == [True]


def test_a_gripper_that_can_close_is_given_to_that_joint_alone_and_stands_where_it_is_told_to() -> None:
    arm = load_cell(configs.CELLS_DIR / "two_wx200.toml").arm("left")
    wired, hand = wiring(arm, 0, arm.baud), fingers(arm)
    for angle_rad, given in ((0.0, with_fingers(wired, hand)), (0.4, with_fingers(wired, hand, 0.4))):
        assert (given.name, given.baud, given.plant_arm) == (wired.name, wired.baud, wired.plant_arm)
        for before, after in zip(wired.joints, given.joints, strict=True):
            gripper = before.name == GRIPPER
            assert after == (replace(before, fingers=hand, start_rad=angle_rad) if gripper else before)
    assert GRIPPER in {joint.name for joint in wired.joints}


def test_grippers_about_the_object_stand_open_and_meet_it_where_it_is_wide() -> None:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml")
    emulated, _ = about_the_object(cell, start_joints(cell), None)
    for arm, made in zip(cell.arms, emulated.arms, strict=True):
        hand = made.gripper
        assert hand is not None
        assert hand.fingers == fingers_of(arm.file)
        assert hand.q_rad == fingers(arm).open_rad
        assert hand.width_m() > grip_width(cell, arm) + 1e-3
        assert hand.blocked_rad is not None
        assert fingers(arm).width(hand.blocked_rad) == pytest.approx(grip_width(cell, arm), abs=1e-6)
    without, _ = about_the_object(CELL, start_joints(CELL), None)
    assert [made.gripper for made in without.arms] == [None, None], "arms whose files say nothing of one"
