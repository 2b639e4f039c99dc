"""A small machine for tests: this host's systemd as first process of its own namespaces, with our units in it.

Needs root, systemd and a cgroup2 mount; says what is missing.  Its processes, mounts and cgroup go with it.
"""

from __future__ import annotations

import compileall
import contextlib
import os
import py_compile
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import typer

BOOT_SCRIPT = Path(__file__).with_name("boot.sh")
SOURCE = Path(__file__).parents[3]
PACKAGES = ("agent", "configs", "drivers", "sim_backend")
TOOLS = ("unshare", "nsenter", "setpriv", "pivot_root", "systemctl", "systemd-sysusers", "systemd-tmpfiles")
BOOT_S = 30.0

# Where the program lies in the machine; an installation has a virtual environment there.
COOP = """#!/bin/sh
export PYTHONHOME=/opt/python LD_LIBRARY_PATH=/opt/python/lib PYTHONDONTWRITEBYTECODE=1
exec /opt/python/bin/{python} -c '
import site, sys
sys.path.insert(0, "/opt/coop/source")
site.addsitedir("/opt/coop/site")
sys.argv[0] = "coop"
from agent.cli.main import main
main()' "$@"
"""


def missing() -> str:
    """Why this host cannot boot the machine; empty when it can."""
    if os.geteuid() != 0:
        return "needs root for namespaces and mounts"
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    if absent or not Path("/usr/lib/systemd/systemd").exists():
        return f"needs systemd and util-linux (absent: {', '.join(absent) or 'systemd'})"
    if _cgroup2() is None:
        return "needs a writable cgroup2 mount"
    probe = subprocess.run([*_unshare(), "true"], capture_output=True, text=True)
    return f"needs namespaces: {probe.stderr.strip()}" if probe.returncode else ""


class Machine:
    """A booted machine; `run` executes inside it."""

    def __init__(self, leader: int, console: Path) -> None:
        self.leader = leader  # pid of its first process, as seen from here
        self.console = console
        self.root = Path(f"/proc/{leader}/root")  # its files, as long as it runs

    def run(self, *command: str, check: bool = True, timeout_s: float = 60.0) -> str:
        """Output of a command inside.  Raises AssertionError with its stderr when it fails and `check` is set."""
        enter = ["nsenter", f"--target={self.leader}", "--mount", "--uts", "--ipc", "--net", "--pid", "--cgroup"]
        done = subprocess.run(
            [*enter, "--", *command],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            cwd="/",
            env={"PATH": "/usr/bin:/usr/sbin"},
        )
        assert not check or done.returncode == 0, f"{command}: {done.stderr}{done.stdout}"
        return done.stdout

    def show(self, unit: str, name: str) -> str:
        """One property of a unit."""
        return self.run("systemctl", "show", "--value", f"--property={name}", unit).strip()

    def wait_for(self, unit: str, name: str, wanted: str, timeout_s: float = 30.0) -> None:
        """Wait until a property has a value.  Raises AssertionError with the unit's journal when it does not."""
        deadline = time.monotonic() + timeout_s
        while (found := self.show(unit, name)) != wanted:
            assert time.monotonic() < deadline, f"{unit}: {name} is {found}, not {wanted}\n{self.journal(unit)}"
            time.sleep(0.05)

    def journal(self, unit: str) -> str:
        """What the unit printed and what systemd said about it."""
        return self.run("journalctl", "--no-pager", "--output=cat", f"--unit={unit}")


@contextmanager
def booted(files: Path, scratch: Path) -> Iterator[Machine]:
    """A machine with the content of `files` copied over its root; gone when the block ends."""
    coop = files / "opt/coop/bin/coop"
    coop.parent.mkdir(parents=True, exist_ok=True)
    coop.write_text(COOP.format(python=f"python{sysconfig.get_python_version()}"))
    coop.chmod(0o755)
    base = _cgroup2()
    assert base is not None
    cgroup = base / f"coop-test-{os.getpid()}-{time.monotonic_ns()}"
    cgroup.mkdir()
    console = scratch / "console.txt"
    environment = {
        "PATH": "/usr/sbin:/usr/bin", "ROOT": str(scratch / "root"), "FILES": str(files), "SOURCE": _program().name,
        "PYTHON_PREFIX": sys.base_prefix, "SITE": str(Path(typer.__file__).parents[1]), "BOOT": str(BOOT_SCRIPT),
        "PROCS": str(cgroup / "cgroup.procs"),
    }  # fmt: skip
    enter_and_boot = f'echo $$ > "$PROCS" && exec {" ".join(_unshare())} sh "$BOOT"'
    with console.open("wb") as out:
        # when this process dies, its machine dies with it
        guarded = ["setpriv", "--pdeathsig", "KILL", "sh", "-c", enter_and_boot]
        outer = subprocess.Popen(guarded, stdin=subprocess.DEVNULL, stdout=out, stderr=out, env=environment)
    try:
        machine = Machine(_leader(outer, console), console)
        deadline = time.monotonic() + BOOT_S
        while machine.run("systemctl", "is-active", "basic.target", check=False).strip() != "active":
            assert time.monotonic() < deadline, f"no boot: {console.read_text()}"
            time.sleep(0.05)
        yield machine
    finally:
        outer.kill()
        outer.wait()
        _remove(cgroup)


@cache
def _program() -> tempfile.TemporaryDirectory[str]:
    """The packages with their compiled files, as an installation has them: compiling takes a quarter of a start."""
    folder = tempfile.TemporaryDirectory(prefix="coop-program")
    Path(folder.name).chmod(0o755)
    for name in PACKAGES:
        shutil.copytree(SOURCE / name, Path(folder.name) / name, ignore=shutil.ignore_patterns("__pycache__"))
    mode = py_compile.PycInvalidationMode.UNCHECKED_HASH
    assert compileall.compile_dir(folder.name, quiet=1, invalidation_mode=mode)
    return folder


def _unshare() -> list[str]:
    return ["unshare", "--mount", "--pid", "--fork", "--net", "--ipc", "--uts", "--cgroup", "--kill-child=SIGKILL"]


def _cgroup2() -> Path | None:
    for line in Path("/proc/self/mounts").read_text().splitlines():
        _, place, kind, options, *_ = line.split()
        if kind == "cgroup2" and "rw" in options.split(","):
            return Path(place)
    return None


def _leader(outer: subprocess.Popen[bytes], console: Path) -> int:
    """Pid of the machine's first process, once it is systemd."""
    deadline = time.monotonic() + BOOT_S
    while time.monotonic() < deadline:
        assert outer.poll() is None, f"no boot: {console.read_text()}"
        with contextlib.suppress(FileNotFoundError, IndexError):
            child = int(Path(f"/proc/{outer.pid}/task/{outer.pid}/children").read_text().split()[0])
            if Path(f"/proc/{child}/comm").read_text().strip() == "systemd":
                return child
        time.sleep(0.02)
    raise AssertionError(f"no boot: {console.read_text()}")


def _remove(cgroup: Path) -> None:
    """Wait for the machine's last process, then remove its cgroups, leaves first."""
    deadline = time.monotonic() + BOOT_S
    while "populated 1" in (cgroup / "cgroup.events").read_text():
        assert time.monotonic() < deadline, f"{cgroup} still has processes"
        time.sleep(0.02)
    for folder, _, _ in os.walk(cgroup, topdown=False):
        Path(folder).rmdir()
