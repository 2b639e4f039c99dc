"""Whatever is done to a cell or arm file, reading and checking it gives a result or a refusal of one line, in time."""

from __future__ import annotations

import contextlib
import shutil
import signal
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import configs
from agent.config.cell import Cell, cell_from_toml, load_cell
from agent.process.build import build_agent
from agent.process.emulate import wiring
from agent.process.simulated import plant_spec
from agent.verify.check import examine
from drivers.interface import Refusal
from tests.support.config.mutations import (
    CSV_SPLICES,
    MOTIONS,
    TEXTS,
    URDF_SPLICES,
    WAY,
    changed_document,
    spliced,
    values,
)

CPU_S = 10.0
LONGEST_REFUSAL = 3000  # characters
# wired, thorough: as runs look, and in one example of eleven as `coop check` does, which takes a second
LOOKS = [(None, None), (True, None)] * 5 + [(True, True)]
EXAMPLES = max(200, settings().max_examples)  # 3000 in `make fuzz`
CELLS = sorted(configs.CELLS_DIR.glob("*.toml"))
PAPER = (configs.CELLS_DIR / "paper.toml").read_text()
TEXTS_OF_CELLS = {path.stem: path.read_text() for path in CELLS} | {
    kind: PAPER[: PAPER.index('kind = "sinusoid"')] + motion + PAPER[PAPER.index("[controller]") :]
    for kind, motion in MOTIONS.items()
}

pytestmark = [pytest.mark.fuzz, pytest.mark.timeout(7200)]


class TooLong(BaseException):
    """More computing than a person would wait for; no broad `except` of what is tested may stop it."""


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TooLong after so many seconds of the process's own computing."""

    def stop(*_: object) -> None:
        raise TooLong(f"{seconds:g} s of computing")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def result_or_refusal(load: Callable[[], Cell], wired: bool | None, thorough: bool | None = None) -> bool:
    """Load, check, and build what a run builds of a cell that is accepted; whether it was."""
    with limited(CPU_S):
        try:
            cell = load()
            report = examine(cell, wired=wired, thorough=thorough)
            for line in (f.line for f in report.findings):
                assert line.isprintable(), repr(line)
            report.require()
            plant_spec(cell, report.q_start)
            for i, arm in enumerate(cell.arms):
                build_agent(cell, arm)
                wiring(arm, i, arm.baud)
        except Refusal as error:
            refusal = error
        else:
            return True
    text = str(refusal)
    assert text.isprintable(), repr(text)
    assert len(text) < LONGEST_REFUSAL
    return False


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the arms that ship, and a place for cells."""
    root = tmp_path_factory.mktemp("changed")
    (root / "way.csv").write_text(WAY)
    shutil.copytree(configs.ARMS_DIR, root / "arms", ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    return root


def test_what_is_not_changed_passes(folder: Path) -> None:
    """So that what follows reaches the end of the check at all."""
    path = folder / "cell.toml"
    for text in TEXTS_OF_CELLS.values():
        path.write_text(text)
        assert result_or_refusal(lambda: load_cell(path), wired=None)


@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck), print_blob=True)
@given(data=st.data())
@pytest.mark.fault("G1")
def test_changed_files_give_a_result_or_a_refusal(folder: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(TEXTS_OF_CELLS)), label="cell")
    text, looks = TEXTS_OF_CELLS[name], data.draw(st.sampled_from(LOOKS), label="wired, thorough")
    what = data.draw(
        st.sampled_from(["cell", "cell", "csv"] if name == "file" else ["cell", "cell", "arm", "gripper", "urdf"])
    )
    cell, way = folder / "cell.toml", folder / "way.csv"
    if what in {"cell", "csv"}:
        cell.write_bytes(_changed(data, text) if what == "cell" else text.encode())
        way.write_bytes(spliced(data, WAY, CSV_SPLICES) if what == "csv" else WAY.encode())
        overrides = data.draw(st.lists(_overrides(text), max_size=2), label="overrides")
        result_or_refusal(lambda: load_cell(cell, overrides), *looks)
        return
    model = data.draw(st.sampled_from(sorted({arm["model"] for arm in tomllib.loads(text)["arms"]})), label="arm")
    shipped = configs.ARMS_DIR / f"{model}.toml"
    target = folder / "arms" / (shipped.name if what != "urdf" else tomllib.loads(shipped.read_text())["urdf"])
    original = target.read_bytes()
    try:
        if what == "arm":
            target.write_bytes(_changed(data, original.decode()))
        elif what == "gripper":  # of an arm file it is one table of many, and what its values say they say together
            arm = tomllib.loads(original.decode())
            changed = tomllib.loads(changed_document(data, arm["gripper"]).decode())
            target.write_bytes(tomli_w.dumps(arm | {"gripper": changed}).encode())
        else:
            target.write_bytes(spliced(data, original.decode(), URDF_SPLICES))
        result_or_refusal(lambda: cell_from_toml(text.encode(), name, folder / "arms"), *looks)
    finally:
        target.write_bytes(original)


def _changed(data: st.DataObject, text: str) -> bytes:
    if data.draw(st.integers(0, 2), label="how"):
        return changed_document(data, tomllib.loads(text))
    return spliced(data, text)


def _overrides(text: str) -> st.SearchStrategy[str]:
    """`--set` of a key of the cell, of a part of one, or of nothing that exists."""
    paths = sorted(_paths(tomllib.loads(text)))
    keys = st.one_of(st.sampled_from(paths), st.sampled_from(TEXTS), st.sampled_from(["arms.left", "arms.left.x.y"]))
    return st.builds(lambda key, value: f"{key}={value}", keys, values.map(_as_text))


def _as_text(value: object) -> str:
    return str(value).lower() if isinstance(value, (bool, float)) else str(value)


def _paths(node: object, before: str = "") -> Iterator[str]:
    """Every key of a document as `--set` names it: arms by their names."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield before + key
            yield from _paths(value, f"{before}{key}.")
    elif isinstance(node, list):
        for entry in node:
            if isinstance(entry, dict):
                yield from _paths(entry, f"{before}{entry.get('name', 0)}.")
