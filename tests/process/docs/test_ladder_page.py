"""The ladder of docs/hil.md, climbed: each step's command for a second, beside the step before it.

Ports of real arms are those of `coop emulate`, and nobody asks for real time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

import configs
from agent.config.cell import load_cell
from agent.log.read import read_log
from tests.process.conftest import SHORT
from tests.support.coop import coop, ready, start
from tests.support.ladder import COMPARED, STEPS
from tests.support.stalls import ATTEMPTS

ON_EMULATED = ("--emulated", "--allow-no-realtime", "--gripper-empty")
STALLED = (5, 7)  # a run that ended early, arms that could not start together
PRIORITY = ("--priority", "80")  # of a real arm


@contextlib.contextmanager
def servos(folder: Path, arms: str) -> Iterator[Path]:
    """A cell whose arms have the ports of `coop emulate`."""
    named = ", ".join(f'"{arm}"' for arm in arms.split(","))
    ports = [f'arms.{arm}.dynamixel.port="{folder / "ports" / arm}"' for arm in ("left", "right")]
    cell = folder / "cell.toml"
    cell.write_bytes(load_cell(configs.CELLS_DIR / "two_wx200.toml", [f"hil.arms=[{named}]", *ports]).toml)
    process = start("emulate", cell, "--ports", folder / "ports", cwd=folder)
    try:
        ready(process)
        yield cell
    finally:
        process.terminate()
        process.communicate()


def climb(step: tuple[str, ...], folder: Path, out: str) -> tuple[int | None, str]:
    """One run of a step: how it ended, and what it said."""
    told = (*SHORT, "--out", out, "--force")
    if "--real-arms" not in step:
        done = coop(*step, *told, cwd=folder)
        return done.returncode, done.stderr
    words = [word for word in step if word not in PRIORITY]
    with servos(folder, words[words.index("--hil") + 1]) as cell:
        words[words.index("two_wx200")] = str(cell)
        said = ""
        with start(*words, *ON_EMULATED, *told, cwd=folder) as run:
            assert run.stderr is not None
            for line in run.stderr:
                said += line
                if "HOLDS" in line:  # until somebody says so
                    coop("release", cell, cwd=folder)
        return run.returncode, said


@pytest.mark.long
@pytest.mark.timeout(900)
def test_each_step_runs_and_is_compared_with_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for k, step in enumerate(STEPS):
        for _ in range(ATTEMPTS):
            code, said = climb(step, tmp_path, f"step-{k}")
            if code == 0:
                break
        if code in STALLED and k:
            pytest.skip(f"this machine stalled in step {k + 1}: {said.splitlines()[-1]}")
        assert code == 0, (step, said)
        log = read_log(tmp_path / f"step-{k}" / "run.mcap")
        assert log.run_info()["hil"] == ([] if "--hil" not in step else step[step.index("--hil") + 1].split(","))
        if k:
            word, *_ = COMPARED
            compared = coop(word, f"step-{k - 1}/run.mcap", f"step-{k}/run.mcap", cwd=tmp_path)
            assert compared.returncode == 0, compared.stderr
            assert "max_position_error_m" in compared.stdout
