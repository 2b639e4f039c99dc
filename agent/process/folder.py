"""The folder of a run: made, tried, and without the results of an earlier one unless they may go."""

from __future__ import annotations

import os
import tempfile
from datetime import UTC, datetime
from pathlib import Path

from agent.log.file import remove_log
from drivers.interface import Refusal

LOG_NAME = "run.mcap"
OURS = (LOG_NAME, "results.json", "report.html")


class RunError(Refusal):
    """The run could not be started or did not come to its end."""


def output_folder(wanted: Path | None, cell: str, *, replace: bool = False) -> Path:
    """The folder `wanted`, by default runs/<UTC>-<cell>; it is there, can be written and holds no results.

    replace: what is in it may stay and be written over, and the log of an earlier run is removed.
    Raises RunError, and LogFileError where a recorder writes that log.
    """
    out = wanted or Path("runs") / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{cell}"
    try:
        if not replace:
            _refuse_contents(out)
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise RunError(
            f"output folder {out}", found=error.strerror, expected="a folder that can be written",
            remedy="name another folder with --out, or change its permissions",
        ) from error  # fmt: skip
    remove_log(out / LOG_NAME)
    return out


def _refuse_contents(out: Path) -> None:
    """Raise RunError where something is in the folder that a run would write over."""
    for name in OURS:
        if os.path.lexists(out / name):
            raise RunError(
                f"output folder {out}", found=f"{name} from an earlier run", expected="a folder without results",
                remedy="name another with --out, or give --force",
            )  # fmt: skip
