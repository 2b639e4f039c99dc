"""A minimal Debian tree for tests, made by debootstrap from the archive that this host's apt uses.

Needs root, debootstrap and an apt that knows a Debian archive; `missing` says what is not there.  Commands in the tree
see their own processes and mounts; when a command ends, so do its children and mounts.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from configparser import ConfigParser
from contextlib import contextmanager
from pathlib import Path

TOOLS = ("debootstrap", "unshare", "chroot", "apt-get", "apt-config")
BUILD_S, COMMAND_S = 600.0, 600.0

ALONE = ["unshare", "--mount", "--pid", "--fork", "--kill-child=SIGKILL"]
ENTER = """set -e
mount --make-rprivate /
mount -t proc proc "$0/proc"
mkdir -p "$0/dev/shm" && mount -t tmpfs tmpfs "$0/dev/shm"
mount -t tmpfs tmpfs "$0/tmp"
exec chroot "$0" "$@"
"""

# pip must reach the index as it does on this host: what it reads there, and what that names, it finds in the tree.
PIP_FILES = ("/etc/pip.conf", "/etc/xdg/pip/pip.conf", "~/.pip/pip.conf", "~/.config/pip/pip.conf")
CERTIFICATES = ("PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE")
PROXIES = ("http_proxy", "https_proxy", "no_proxy")


def missing() -> str:
    """Why this host cannot build a tree; empty when it can."""
    if os.geteuid() != 0:
        return "needs root to build a tree"
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    if absent:
        return f"needs {', '.join(absent)} (apt install debootstrap util-linux)"
    if archive() is None:
        return "apt of this host knows no Debian archive"
    probe = subprocess.run([*ALONE, "true"], capture_output=True, text=True)
    return f"needs namespaces: {probe.stderr.strip()}" if probe.returncode else ""


def archive() -> str | None:
    """Address of the Debian archive that apt uses on this host, its security archive aside."""
    wanted = ["$(ORIGIN) $(LABEL) $(COMPONENT) $(REPO_URI)", "Created-By: Packages"]
    listed = subprocess.run(["apt-get", "indextargets", "--format", *wanted], capture_output=True, text=True)
    found = [line.split()[-1] for line in listed.stdout.splitlines() if line.startswith("Debian Debian main ")]
    return found[0] if found else None


class Tree:
    """A tree in which commands run as root, with an environment that holds nothing of this process's."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """The command's end and what it printed."""
        _give_network(self.root)  # each time: packages that are installed replace such files
        environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "DEBIAN_FRONTEND": "noninteractive"}
        passed = [name for name in os.environ if name.startswith("PIP_") or name in CERTIFICATES + PROXIES]
        return subprocess.run(
            [*ALONE, "sh", "-c", ENTER, str(self.root), *command],
            env=environment | {name: os.environ[name] for name in passed},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=COMMAND_S,
        )


@contextmanager
def built(release: str, packages: tuple[str, ...], root: Path) -> Iterator[Tree]:
    """A tree of this Debian release with its required packages and these; removed when the block ends."""
    include = f"--include={','.join(packages)}"
    command = [*ALONE, "debootstrap", "--variant=minbase", include, release, str(root), str(archive())]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=BUILD_S)
        assert done.returncode == 0, f"{done.stdout[-2000:]}{done.stderr}"
        yield Tree(root)
    finally:
        shutil.rmtree(root, ignore_errors=True)


def _give_network(root: Path) -> None:
    """Let names resolve, and apt and pip use what they use on this host."""
    settings = [Path(name).expanduser() for name in PIP_FILES]
    copied = [*settings, *(named for file in settings for named in _files_named(file))]
    copied += [Path(os.environ[name]) for name in CERTIFICATES if name in os.environ]
    for source in (Path("/etc/resolv.conf"), Path("/etc/hosts"), *copied):
        if source.is_file():
            target = root / _at_home(source).relative_to("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
    dump = subprocess.run(["apt-config", "dump"], capture_output=True, text=True, check=True).stdout
    wanted = ("Acquire::http", "Acquire::https", "Acquire::Check")
    (root / "etc/apt/apt.conf.d/90host").write_text(
        "".join(f"{line}\n" for line in dump.splitlines() if line.startswith(wanted))
    )


def _files_named(settings: Path) -> list[Path]:
    """Files that a file of pip's settings names, as one of constraints."""
    parser = ConfigParser(interpolation=None)
    parser.read(settings)
    words = [word for section in parser.values() for value in section.values() for word in value.split()]
    return [Path(word) for word in words if word.startswith("/") and Path(word).is_file()]


def _at_home(source: Path) -> Path:
    """Where a file of this user's home lies in the tree, whose only user is root."""
    home = Path.home()
    return Path("/root") / source.relative_to(home) if source.is_relative_to(home) else source
