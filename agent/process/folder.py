"""The folder of a run: made, tried, its own while it lasts, without an earlier one's results unless they may go."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from agent.host.flock import holder, lock
from agent.log.file import remove_log
from agent.log.read import LogError, NoRows, open_log
from agent.process.unbegun import StoppedEarly
from agent.telemetry.row.topics import PLANT
from drivers.interface import Refusal

LOG_NAME, RESULTS, PAGE = "run.mcap", "results.json", "report.html"
OURS = (LOG_NAME, RESULTS, PAGE)
WORDS, MARK = "logs", ".run"  # what processes say; that a run has made this folder


class RunError(Refusal):
    """The run could not be started or did not come to its end."""


@contextmanager
def output_folder(
    wanted: Path | None, cell: str, *, own: Iterable[str] = (), replace: bool = False, has_force: bool = True
) -> Iterator[Path]:
    """The folder `wanted`, by default runs/<UTC>-<cell>, for the time of the block.

    It is there, can be written, holds no results, and no other run is given it before the block ends.
    own: names of further files that the run may write; one that lies there is refused, but for the words of an earlier
    run, which failed if it has left no log.
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
                _refuse_contents(out, own, "name another with --out" + ", or give --force" * has_force)
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
        try:
            yield out
        except StoppedEarly:
            _remove_begun(out / LOG_NAME)
            raise


def _remove_begun(log: Path) -> None:
    """Remove a log to which no row came before everything was stopped, so that the same command may be given again."""
    try:
        with open_log(log):
            pass
    except NoRows:
        remove_log(log)
    except LogError:  # none is there, or one that cannot be read
        pass


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


def words_of(arms: Iterable[str]) -> list[str]:
    """Names of the files in which processes of a run with these arms may say something."""
    alone = ("recorder", "plant", "servos", f"telemetry-{PLANT}")
    each = (f"{process}-{arm}" for arm in arms for process in ("arm", "guard", "telemetry"))
    return [f"{WORDS}/{name}.log" for name in (*alone, *each)]


def words_folder(out: Path) -> Path:
    """The folder in which the processes of this run say something, marked as one of a run.  Raises RunError."""
    words = out / WORDS
    try:
        words.mkdir(exist_ok=True)
        (words / MARK).touch()
    except OSError as error:
        raise RunError(
            f"folder {words}", found=error.strerror, expected="a folder that can be written",
            remedy="name another folder with --out",
        ) from error  # fmt: skip
    return words


def _refuse_contents(out: Path, own: Iterable[str], remedy: str) -> None:
    """Raise RunError where something is in the folder that a run would write over."""
    for name in OURS:
        if os.path.lexists(out / name):
            raise RunError(
                f"output folder {out}", found=f"{name} from an earlier run", expected="a folder without results",
                remedy=remedy,
            )  # fmt: skip
    is_ours = (out / WORDS / MARK).exists()
    for name in own:
        if os.path.lexists(out / name) and not (is_ours and name.startswith(f"{WORDS}/")):
            raise RunError(
                f"output folder {out}", found=f"{name}, perhaps of no earlier run",
                expected="a folder without what a run writes", remedy=remedy,
            )  # fmt: skip
