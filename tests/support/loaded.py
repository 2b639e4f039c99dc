"""Commands of `coop` as processes of their own, forked from one that has loaded what commands need.

To load it is most of a short process.  A command that is begun so has its own session, streams, folder, environment,
signals and exit as one begun by a shell; how one begins by a shell is tested elsewhere (tests/unit/cli,
tests/support/coop.py).  Each worker of a test run has one such process; it ends with it.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from runpy import run_module
from typing import IO, Any, Final

from agent.host.starting import SETTINGS
from agent.process.entry import load

SOURCE: Final = Path(__file__).parents[2]
TIMEOUT_S: Final = 240.0  # less than a test's own
MODULES: Final = ("agent.cli.main", "agent.process.run", "agent.process.guard", "agent.process.recorder")
WORDS_MAX: Final = 100_000  # bytes of a command with its environment


def coop(*arguments: str | Path | float, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    process = Loaded(*arguments, cwd=cwd)
    out, err = process.communicate(TIMEOUT_S)
    return subprocess.CompletedProcess(["coop", *map(str, arguments)], process.wait(), out, err)


class Loaded:
    """What `subprocess.Popen` is for a command that is loaded anew, as far as tests ask; nothing is on its input."""

    def __init__(
        self,
        *arguments: str | Path | float,
        cwd: Path | None = None,
        env: Mapping[str, str] | None = None,
        stdout: int | None = None,
        module: str = "agent.cli",
    ) -> None:
        """env: its whole environment, else that of this process; stdout: a descriptor, else a pipe.

        module: what `python -m` would run instead of the command.
        """
        self.returncode: int | None = None
        with contextlib.ExitStack() as theirs:
            (out, out_end), (words, words_end), (self._ended, code_end) = os.pipe(), os.pipe(), os.pipe()
            for end in (out_end, words_end, code_end):
                theirs.callback(os.close, end)
            self.stdout, self.stderr = os.fdopen(out), os.fdopen(words)
            begun = {
                "module": module, "arguments": [*map(str, arguments)], "cwd": str(cwd or Path.cwd()),
                "env": dict(os.environ if env is None else env),
            }  # fmt: skip
            ends = [out_end if stdout is None else stdout, words_end, code_end]
            asks = _loader(os.getpid())
            socket.send_fds(asks, [json.dumps(begun).encode()], ends)
        self.pid = int(asks.recv(WORDS_MAX))

    def poll(self) -> int | None:
        """Exit code; of who was killed by a signal its number, negative; None while it runs."""
        return self._look(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Exit code, once it has ended.  Raises subprocess.TimeoutExpired."""
        code = self._look(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """All that it still says on both streams, once it has ended.  Raises subprocess.TimeoutExpired."""
        with ThreadPoolExecutor(2) as readers:
            said = [readers.submit(_rest, stream) for stream in (self.stdout, self.stderr)]
            try:
                texts = [reader.result(timeout) for reader in said]
            except TimeoutError as error:
                self.kill()
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0) from error
        self.wait(timeout)
        return texts[0], texts[1]

    def send_signal(self, number: int) -> None:
        """Send it a signal, if it has not ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def _look(self, timeout: float | None) -> int | None:
        if self.returncode is None:
            with selectors.DefaultSelector() as selector:
                selector.register(self._ended, selectors.EVENT_READ)
                if not selector.select(timeout):
                    return None
            self.returncode = int(os.read(self._ended, 16))
            os.close(self._ended)
        return self.returncode


def _rest(stream: IO[str]) -> str:
    if stream.closed:
        return ""
    with stream:
        return stream.read()


@functools.cache
def _loader(of: int) -> socket.socket:
    """Who forks commands for the process of this number: not for one that is forked from it."""
    del of
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        loader = subprocess.Popen(
            [sys.executable, "-m", "tests.support.loaded", str(theirs.fileno())], cwd=SOURCE,
            env=os.environ | SETTINGS | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()], start_new_session=True,
        )  # fmt: skip
    atexit.register(loader.wait)
    atexit.register(ours.close)
    return ours


def _load() -> None:
    for module in MODULES:
        import_module(module)
    load(servos=True)


def _asked(of: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Fork a process for each command that is asked for; in that one, what it is; None once nobody asks any more."""
    with selectors.DefaultSelector() as selector:
        selector.register(of, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.data is not None:
                    selector.unregister(key.fd)
                    os.close(key.fd)
                    _tell_end(*key.data)
                    continue
                request, ends, *_ = socket.recv_fds(of, WORDS_MAX, 3)
                if not request:
                    return None
                if not (pid := os.fork()):
                    return json.loads(request), ends
                of.send(str(pid).encode())
                selector.register(os.pidfd_open(pid), selectors.EVENT_READ, (pid, ends[2]))
                for end in ends[:2]:
                    os.close(end)


def _tell_end(pid: int, told: int) -> None:
    _, status = os.waitpid(pid, 0)
    with contextlib.suppress(BrokenPipeError):
        os.write(told, str(os.waitstatus_to_exitcode(status)).encode())
    os.close(told)


def _become(begun: dict[str, Any], ends: list[int]) -> None:
    """Have nothing of who was forked but what it has loaded."""
    os.setsid()
    for end, number in zip(ends, (1, 2), strict=False):
        os.dup2(end, number)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    os.chdir(begun["cwd"])
    os.environ.clear()
    os.environ.update(begun["env"])
    sys.argv = [begun["module"], *begun["arguments"]]


if __name__ == "__main__":
    _load()
    gc.freeze()
    with socket.socket(fileno=int(sys.argv[1])) as whoever:
        asked = _asked(whoever)
    if asked is not None:
        _become(*asked)
        run_module(asked[0]["module"], run_name="__main__", alter_sys=True)
