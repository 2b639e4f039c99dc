"""How a process of ours begins and ends, whatever it is: settings of libraries before they load; its ready line."""

from __future__ import annotations

import errno
import gc
import io
import os
import select
import stat
import sys
from typing import Any, Final, NoReturn

from agent.host.ready_line import READY

USAGE: Final = 2  # exit code where a line, or the host, does not do
GARBAGE_AFTER: Final = 50_000  # new objects, of which the interpreter looks for cycles; a start makes many more
SETTINGS: Final = {  # of libraries, read when they are loaded, where a person has not said otherwise
    "OPENBLAS_NUM_THREADS": "1",  # our matrices are small
    "OMP_NUM_THREADS": "1",
    "PYDANTIC_DISABLE_PLUGINS": "__all__",  # or the first model looks through all that is installed for some
}
_ANY_BYTE: Final = ("surrogateescape", "utf-8")  # every letter, and every name of a file as it is


def settle() -> None:
    """Settings of libraries and of the interpreter, for the whole process."""
    for setting, value in SETTINGS.items():
        os.environ.setdefault(setting, value)
    gc.set_threshold(GARBAGE_AFTER)
    _open_closed_streams()
    _outlive_terminals()
    if isinstance(sys.stdout, io.TextIOWrapper) and (sys.stdout.errors, sys.stdout.encoding) != _ANY_BYTE:
        sys.stdout.reconfigure(errors="backslashreplace")  # a letter that it has not is written by its number


def _open_closed_streams() -> None:
    """Have standard streams that were closed lead nowhere, or the next file that is opened takes their place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(nowhere, True)
            setattr(sys, name, os.fdopen(nowhere, mode, encoding="utf-8", closefd=False))  # a copy replaces it


class _Lasting(io.FileIO):
    """A terminal, pipe or socket, which may be closed while something is still written to it: that leads nowhere."""

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in (errno.EIO, errno.EPIPE):
                raise
            return memoryview(data).nbytes


def _outlive_terminals() -> None:
    """Have nothing fail for a terminal that is gone: a stop follows (SIGHUP), whose end is as orderly as any."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and stream.isatty():
            setattr(sys, name, _lasting(stream))


def outlive_readers() -> None:
    """Have no command fail for a pipe that nobody reads any more, as with `| head -1`: it does what it was asked to.

    A socket, as a service manager or a remote shell gives, is one, too.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and _has_reader(stream):
            setattr(sys, name, _lasting(stream))


def is_unread() -> bool:
    """Whether standard output is a pipe or socket that nobody reads any more: what is said again and again may end."""
    poller = select.poll()
    try:
        poller.register(sys.stdout.fileno(), 0)
    except OSError:  # it has none
        return False
    return any(events & (select.POLLERR | select.POLLHUP) for _, events in poller.poll(0))


def _lasting(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    stream.flush()
    raw = io.BufferedWriter(_Lasting(stream.fileno(), "w", closefd=False))
    by_lines = stream.isatty() or stream.line_buffering or stream.write_through
    return io.TextIOWrapper(raw, stream.encoding, stream.errors, line_buffering=by_lines)


def _has_reader(stream: io.TextIOWrapper) -> bool:
    try:
        mode = os.fstat(stream.fileno()).st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def ready(what: str) -> None:
    """Tell the parent that this process is ready, and what it needs to know: `pairs`."""
    sys.stdout.write(f"{READY}{what}\n")
    sys.stdout.flush()


def tell(text: str) -> None:
    """Tell the parent what the person in front of it should know before this process ends."""
    sys.stdout.write(f"TELLS {text}\n")
    sys.stdout.flush()


def end(code: int) -> NoReturn:
    """End the process, which does not look for garbage in all that is there before: a tenth of a short command."""
    gc.freeze()
    sys.exit(code)


def of_host(error: OSError) -> str:
    """What the host did not do, in one line for a person."""
    found = f"found {error.strerror or error}"
    if error.errno == errno.EMFILE:
        from agent.host import open_files  # noqa: PLC0415 - seldom needed, and this module starts every process

        return f"this host: {found}, with {open_files.found()}, expected more; {open_files.REMEDY}"
    if error.errno == errno.EPIPE:
        return f"another process: {found}, expected it to go on listening; see why it ended"
    if error.filename is None:
        return f"this host: {found}, expected it to do what was asked; see what it is short of"
    return f"{error.filename}: {found}, expected a path that can be used; name another"
