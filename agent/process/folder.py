"""The folder that `coop run` leaves its results in: made, tried, and without anything in it unless that may go."""

from __future__ import annotations

import tempfile
from datetime import UTC, datetime
from pathlib import Path

from agent.log.file import remove_log
from drivers.interface import Refusal

LOG_NAME = "run.mcap"


class RunError(Refusal):
    """The run could not be started or did not come to its end."""


def output_folder(wanted: Path | None, cell: str, *, replace: bool = False) -> Path:
    """The folder `wanted`, by default runs/<UTC>-<cell>; it is there, can be written and holds no log.

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
    """Raise RunError where something is in the folder: an earlier run, or what is none of ours."""
    there = sorted(out.iterdir()) if out.exists() else []
    if there:
        log = out / LOG_NAME
        found = f"{LOG_NAME} from an earlier run" if log in there else f"{there[0].name} in it"
        raise RunError(
            f"output folder {out}", found=found, expected="an empty folder, or none",
            remedy="name another with --out, or give --force",
        )  # fmt: skip
