"""`coop run` on a real terminal that goes away in the middle, as a connection does that is lost."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from agent.log.read import read_log
from tests.process.run.test_run import left_clean
from tests.support.coop import COOP, PAPER
from tests.support.members import member

# its own session, and the terminal on standard input is that session's
TAKE = "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execv(sys.argv[1], sys.argv[1:])"


@pytest.mark.long  # Ctrl-C is in test_run.py
def test_a_run_whose_terminal_is_gone_ends_as_by_ctrl_c(tmp_path: Path) -> None:
    """Log and results are written, nothing is left behind, and what is told to nobody fails nothing."""
    with left_clean(tmp_path) as folder:
        ours, theirs = os.openpty()
        line = [*COOP, "run", str(PAPER), "--duration", "1000", "--no-report", "--out", str(folder / "out")]
        run = subprocess.Popen(
            [sys.executable, "-c", TAKE, *line], cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs,
            start_new_session=True, text=True,
        )  # fmt: skip
        os.close(theirs)
        shown = b""
        try:
            while b"x real time" not in shown:
                shown += os.read(ours, 65536)
            member("plant", run)  # a copy, as where no spinner turns: anew it would be called after the interpreter
        finally:
            os.close(ours)
        assert run.wait(60.0) == 130
    results = json.loads((folder / "out" / "results.json").read_text())
    assert results["complete"] is True
    log = read_log(folder / "out" / "run.mcap")
    for rows in log.agents.values():  # one of them may be a tick ahead
        assert len(rows) == rows["sequence"][-1] + 1
