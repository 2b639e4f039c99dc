"""The folder of a run: made, tried, its own while it lasts, without an earlier one's results unless they may go."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from agent.host.flock import holder, lock
from agent.log.file import remove_log
from drivers.interface import Refusal

LOG_NAME, RESULTS, PAGE = "run.mcap", "results.json", "report.html"
OURS = (LOG_NAME, RESULTS, PAGE)


class RunError(Refusal):
    """The run could not be started or did not come to its end."""


@contextmanager
def output_folder(wanted: Path | None, cell: str, *, replace: bool = False, has_force: bool = True) -> Iterator[Path]:
    """The folder `wanted`, by default runs/<UTC>-<cell>, for the time of the block.

    It is there, can be written, holds no results, and no other run is given it before the block ends.
    replace: an earlier run may be in it, whose log, results, page and pictures are removed; what else is there stays.
    has_force: the command has `--force`, which asks for that.
    Raises RunError, and LogInTheWay where a recorder writes that log.
    """
    out = wanted or Path("runs")
    with ExitStack() as held:
        try:
            out.mkdir(parents=True, exist_ok=True)
            if wanted is None:
                out = _named_by_time(out, cell)
            held.enter_context(_claimed(out))
            if not replace:
                _refuse_contents(out, "name another with --out" + ", or give --force" * has_force)
            with tempfile.TemporaryFile(dir=out):
                pass
        except OSError as error:
            raise RunError(
                f"output folder {out}", found=error.strerror, expected="a folder that can be written",
                remedy="name another folder with --out, or change its permissions",
            ) from error  # fmt: skip
        remove_log(out / LOG_NAME)
        if replace:
            _remove_report(out)
        yield out


def _remove_report(out: Path) -> None:
    """Remove what was told of an earlier run, which would lie beside the log of another.  Raises RunError."""
    page = out / PAGE
    try:
        pictures = _pictures_in(page) if page.exists() else []
        for name in (*pictures, RESULTS, PAGE):  # the page last: it names the others
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise RunError(
            f"report of an earlier run in {out}", found=error.strerror, expected="files that can be removed",
            remedy="remove them, or name another folder with --out",
        ) from error  # fmt: skip


def _pictures_in(page: Path) -> list[str]:
    from agent.report.page import pictures_in  # noqa: PLC0415 - figures cost 0.3 s, and not every folder has a page

    return pictures_in(page.read_bytes())


def _named_by_time(runs: Path, cell: str) -> Path:
    """A new folder in `runs`; with a number behind its name where another run has begun in this second."""
    name = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{cell}"
    out = runs / name
    for number in count(2):
        with suppress(FileExistsError):
            out.mkdir()
            break
        out = runs / f"{name}_{number}"
    return out


@contextmanager
def _claimed(out: Path) -> Iterator[None]:
    """Keep other runs out of the folder for the time of the block.  Raises RunError where one is in it."""
    folder, free = os.open(out, os.O_RDONLY | os.O_CLOEXEC), True
    try:
        with suppress(OSError):  # of a file system that locks no folders
            free = lock(folder)
        if not free:
            raise RunError(
                f"output folder {out}", expected="a folder for this one",
                found=f"another run that writes into it, or a reader's lock{holder(folder)}",
                remedy="name another with --out, or wait for its end",
            )  # fmt: skip
        yield
    finally:
        os.close(folder)


def _refuse_contents(out: Path, remedy: str) -> None:
    """Raise RunError where something is in the folder that a run would write over."""
    for name in OURS:
        if os.path.lexists(out / name):
            raise RunError(
                f"output folder {out}", found=f"{name} from an earlier run", expected="a folder without results",
                remedy=remedy,
            )  # fmt: skip
