"""A process of ours says what it has to say, whatever it was given to say it on."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

SETTLED = "import sys\nfrom agent.host.starting import settle\nsettle()\n"


def test_closed_streams_lead_nowhere_and_no_file_takes_their_place(tmp_path: Path) -> None:
    told = tmp_path / "told"
    code = f"""{SETTLED}
print("said")
print("said", file=sys.stderr)
with open({str(told)!r}, "w") as file:
    file.write(f"{{file.fileno() > 2}} {{sys.stdin.read()!r}} {{sys.stderr.isatty()}}")
"""
    closed = ["sh", "-c", 'exec "$0" -c "$1" <&- >&- 2>&-', sys.executable, code]
    subprocess.run(closed, check=True, timeout=60)
    assert told.read_text() == "True '' False"


def test_what_is_written_to_a_terminal_that_is_gone_fails_nothing() -> None:
    """On both streams, in the middle and at the end; whoever ignores SIGHUP goes on."""
    code = f"""{SETTLED}
import signal
signal.signal(signal.SIGHUP, signal.SIG_IGN)
print("→", sys.stdout.isatty(), sys.stdout.fileno(), file=sys.stderr)
sys.stdin.read()
for stream in (sys.stdout, sys.stderr):
    print("x" * 100_000, file=stream)
    stream.flush()
print("not flushed", end="")
sys.exit(7)
"""
    ours, theirs = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=theirs, stderr=theirs, start_new_session=True
    )
    os.close(theirs)
    told = b""
    while not told.endswith(b"\n"):
        told += os.read(ours, 100)
    assert told.decode() == "→ True 1\r\n"
    os.close(ours)
    process.communicate(timeout=60)
    assert process.returncode == 7


def of_sockets() -> tuple[int, int]:
    reader, writer = socket.socketpair()
    return reader.detach(), writer.detach()


def unread(code: str, stream: str, pipe: Callable[[], tuple[int, int]] = os.pipe) -> subprocess.CompletedProcess[str]:
    """What a command says of itself whose stream nobody reads."""
    reader, writer = pipe()
    os.close(reader)
    streams: dict[str, int] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: writer}
    done = subprocess.run([sys.executable, "-c", SETTLED + code], text=True, timeout=60, **streams)
    os.close(writer)
    return done


@pytest.mark.parametrize("pipe", [os.pipe, of_sockets])
@pytest.mark.parametrize(("stream", "other"), [("stdout", "stderr"), ("stderr", "stdout")])
def test_what_is_written_to_a_pipe_that_nobody_reads_fails_no_command(
    stream: str, other: str, pipe: Callable[[], tuple[int, int]]
) -> None:
    done = unread(
        f"""
from agent.host.starting import is_unread, outlive_readers
outlive_readers()
print("x" * 100_000, file=sys.{stream}, flush=True)
print("not flushed", end="", file=sys.{stream})
print(is_unread(), file=sys.{other})
sys.exit(7)
""",
        stream,
        pipe,
    )
    assert (done.returncode, getattr(done, other)) == (7, f"{stream == 'stdout'}\n")


def test_a_process_of_a_run_fails_where_nobody_reads_it() -> None:
    done = unread("""print("READY", flush=True)""", "stdout")
    assert done.returncode in (1, 120), "120 where the interpreter has something left to write at its end"
    assert "BrokenPipeError" in done.stderr


def test_what_is_said_through_a_pipe_comes_at_once_by_lines_on_standard_error() -> None:
    code = (
        SETTLED
        + """
from agent.host.starting import is_unread, outlive_readers
outlive_readers()
print("said", file=sys.stderr)
print(is_unread(), flush=True)
sys.stdin.read()
"""
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stderr is not None
    assert (process.stderr.readline(), process.stdout.readline()) == ("said\n", "False\n")
    process.communicate(timeout=60)
    assert process.returncode == 0


def test_a_full_device_is_no_terminal_that_is_gone() -> None:
    """Whatever else cannot be written fails."""
    code = (
        SETTLED
        + """
import errno, io
from agent.host.starting import _Lasting
full = _Lasting(os.open("/dev/full", os.O_WRONLY), "w")
try:
    full.write(b"x")
except OSError as error:
    sys.exit(0 if error.errno == errno.ENOSPC else 1)
sys.exit(2)
"""
    )
    assert subprocess.run([sys.executable, "-c", "import os\n" + code], timeout=60).returncode == 0


@pytest.mark.parametrize(
    ("encoding", "written"),
    [
        ("utf-8", "READY → x\\udcff".encode()),
        ("utf-8:surrogateescape", "READY → x".encode() + b"\xff"),
        ("latin-1", b"READY \\u2192 x\\udcff"),
        ("ascii:surrogateescape", b"READY \\u2192 x\\udcff"),
    ],
)
def test_a_letter_that_the_terminal_lacks_is_written_by_its_number(encoding: str, written: bytes) -> None:
    code = SETTLED + 'print("READY \\u2192 x\\udcff")'
    surroundings = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(
        [sys.executable, "-c", code], env=surroundings, stdout=subprocess.PIPE, check=True, timeout=60
    )
    assert done.stdout == written + b"\n"
