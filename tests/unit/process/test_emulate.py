"""Emulated servos whose ports, faults or control socket cannot be had: refused, with nothing left behind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.config.cell import load_cell
from agent.process.emulate import EmulateError, run_emulate
from sim_backend.wire.faults import FaultError
from sim_backend.wire.serve import ServeOptions

CELL = load_cell(configs.CELLS_DIR / "paper.toml")


def options(folder: Path) -> ServeOptions:
    ports = {arm.name: folder / "ports" / arm.name for arm in CELL.arms}
    return ServeOptions(ports, faults_file=None, control_socket=None, seed=0)


def emulate(given: ServeOptions, folder: Path) -> str:
    ring = folder / "ring"
    return run_emulate(CELL, given, ring, timing=False, stop=lambda: True, ready=lambda _: None)  # type: ignore[arg-type]


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
    with pytest.raises((EmulateError, FaultError), match=found):
        emulate(replace(options(tmp_path), **changes), tmp_path)
    assert not (tmp_path / "ports" / "left").exists()
