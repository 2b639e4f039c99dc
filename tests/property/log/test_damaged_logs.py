"""Any reader of a log, given a damaged one, refuses in one line or says what is missing; no figure of it is wrong."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import configs
from agent.cli.main import dispatch
from agent.config.cell import load_cell
from agent.log import load
from agent.log.export import Choice, Format, export
from agent.log.read import open_log
from agent.replay.grasps import grasps
from agent.replay.rows import Window
from agent.replay.same import same
from agent.replay.source import changed_cell, recorded_cell
from agent.replay.verify import verify
from agent.replay.whatif import what_if
from agent.report.compare import compare
from agent.report.metrics import summarise
from agent.report.quantity import json_ready
from agent.telemetry.link.play import PlayOptions, _tracks
from agent.telemetry.row.sample import AGENT_STATE
from drivers.interface import Refusal
from tests.support.plant.plant_arm import run_one
from tests.support.telemetry.run_log import flipped, write_run

CELL = load_cell(configs.CELLS_DIR / "identify_wx200.toml", ["duration_s=0.3", "report.transient_s=0.1"])
ARM = CELL.arms[0].name
EXAMPLES = settings(max_examples=settings().max_examples // 2)  # 25, 50 in `make long`, 1500 in `make fuzz`


@cache
def rows() -> np.ndarray:
    found: np.ndarray = run_one(CELL, 0.3).rows
    return found


@contextlib.contextmanager
def folder() -> Iterator[Path]:
    with TemporaryDirectory() as name:
        yield Path(name)


@cache
def original() -> tuple[bytes, Any]:
    """A log of one arm, and its figures."""
    with folder() as here:
        path = write_run(here / "run.mcap", CELL, {ARM: rows()})
        with open_log(path) as log:
            return path.read_bytes(), figures(log)


def figures(log: Any) -> Any:
    return json_ready(summarise(log).to_json())


@st.composite
def damage(draw: st.DrawFn) -> bytes:
    """The log cut, with bits changed, with a stretch of it gone, zeroed or twice."""
    data = bytearray(original()[0])
    kind = draw(st.sampled_from(["cut", "bits", "gone", "zero", "twice"]))
    at = draw(st.integers(0, len(data) - 1))
    length = draw(st.integers(1, 3000))
    if kind == "cut":
        return bytes(data[:at])
    if kind == "bits":
        for place in [at, *draw(st.lists(st.integers(0, len(data) - 1), max_size=3))]:
            data[place] ^= 1 << draw(st.integers(0, 7))
    elif kind == "gone":
        del data[at : at + length]
    elif kind == "zero":
        data[at : at + length] = bytes(len(data[at : at + length]))
    else:
        data[at:at] = data[at : at + length]
    return bytes(data)


def check_rows(got: np.ndarray) -> None:
    true = {row.tobytes() for row in rows()}
    assert all(row.tobytes() in true for row in got)


@pytest.mark.fuzz
@pytest.mark.timeout(7200)
@EXAMPLES
@given(damage())
@pytest.mark.fault("D6")
def test_no_reader_of_a_damaged_log_says_anything_wrong(data: bytes) -> None:
    with folder() as here:
        path, whole = here / "run.mcap", here / "whole.mcap"
        path.write_bytes(data)
        whole.write_bytes(original()[0])
        read_by_all(path, whole, here)


def read_by_all(path: Path, whole: Path, here: Path) -> None:
    with contextlib.suppress(Refusal), open_log(path) as log:
        told = log.complete
        messages = log.agents[ARM].messages()
        check_rows(np.ascontiguousarray(messages).reshape(-1).view(AGENT_STATE.dtype))
        assert told == (path.read_bytes() == whole.read_bytes()), (
            "what is not as it was recorded is not called complete"
        )
        with contextlib.suppress(Refusal):
            verdict = verify(log, recorded_cell(log), Window())
            assert verdict.different == 0, "every row that is left is a true one"
        with contextlib.suppress(Refusal):
            found = what_if(log, recorded_cell(log), changed_cell(log, ["object.mass_kg=0.5"]), Window())
            assert np.isfinite(found[0].changed).all()
        with contextlib.suppress(Refusal), open_log(whole) as other:
            assert same(other, log).different == 0
        with contextlib.suppress(Refusal):
            grasps(log, recorded_cell(log))
        with contextlib.suppress(Refusal):
            tracks = _tracks(PlayOptions(path), log)
            played = b"".join(track._payload(0, len(track.times)) for track in tracks if track.is_rows)
            assert played == messages.tobytes()
        with contextlib.suppress(Refusal):
            results = summarise(log)
            assert results.complete == told
            assert compare(results, results)
            if told:
                assert figures(log) == original()[1]
    with contextlib.suppress(Refusal), open_log(path, any_layout=True) as log:
        done = export(log, here / "out", Format.CSV, Choice(fields=("t", "q", "tau_cmd")), replace=False)
        assert done.rows[f"{ARM}.csv"] == len(log.agents[ARM])
    with contextlib.suppress(Refusal), load(path) as run:
        assert len(run[ARM]["q"]) <= len(rows())


@pytest.mark.fuzz
@pytest.mark.timeout(7200)
@EXAMPLES
@given(st.data())
def test_rows_with_any_bits_in_them_are_no_crash_and_are_found(choice: st.DataObject) -> None:
    """Whoever wrote such a log, its checksums are right; nothing tells of it but the law."""
    changed = rows()
    for _ in range(choice.draw(st.integers(1, 3))):
        field = choice.draw(st.sampled_from([f for f in AGENT_STATE.fields if not f.timing and f.name != "sequence"]))
        size = (8 if field.ros_type != "uint32" else 4) * max(field.length, 1)
        row, byte = choice.draw(st.integers(0, len(changed) - 1)), choice.draw(st.integers(0, size - 1))
        changed = flipped(changed, row, field.name, byte, choice.draw(st.integers(0, 7)))
    differ = [f.name for f in AGENT_STATE.fields if changed[f.name].tobytes() != rows()[f.name].tobytes()]
    with folder() as here:
        path = write_run(here / "run.mcap", CELL, {ARM: changed})
        with open_log(path) as log:
            verdict = verify(log, recorded_cell(log), Window())
            # of the joints a change may be too small for any number that is computed from them
            if set(differ) - {"q_measured", "dq_measured", "tau_measured", "tau_sent"}:
                assert verdict.different
            what_if(log, recorded_cell(log), changed_cell(log, ["object.mass_kg=0.5"]), Window())
            for read in (lambda: grasps(log, recorded_cell(log)), lambda: _tracks(PlayOptions(path), log)):
                with contextlib.suppress(Refusal):
                    read()
            with contextlib.suppress(Refusal):
                summarise(log)


def test_the_undamaged_log_is_read_by_all() -> None:
    """Otherwise the tests before would suppress everything."""
    with folder() as here:
        path = here / "run.mcap"
        path.write_bytes(original()[0])
        read_by_all(path, path, here)
        with open_log(path) as log:
            assert verify(log, recorded_cell(log), Window()).rows == len(rows())
            assert summarise(log).complete
        for words in (["replay"], ["events"], ["grasps"], ["export", "--force"], ["compare", str(path)]):
            with contextlib.redirect_stdout(io.StringIO()):
                assert dispatch([words[0], str(path), *words[1:]]) == 0, words
