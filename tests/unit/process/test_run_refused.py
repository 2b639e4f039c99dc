"""What `coop run` refuses before anything is started or removed."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.process.folder import RunError
from agent.process.run import RunOptions, _cell_of
from agent.process.run_kind import RunKind


def options(duration_s: float) -> RunOptions:
    return RunOptions(Path("paper"), (), duration_s, None, 0, RunKind.LOCKSTEP)


@pytest.mark.parametrize("duration_s", [0.001, 0.0025])
def test_a_run_of_no_cycle_is_refused(duration_s: float) -> None:
    with pytest.raises(RunError, match=f"duration_s of cell paper: found {duration_s} s, expected one cycle .*0.005 s"):
        _cell_of(options(duration_s))


def test_a_run_of_one_cycle_is_none_too_short() -> None:
    assert _cell_of(options(0.003)).file.duration_s == 0.003
