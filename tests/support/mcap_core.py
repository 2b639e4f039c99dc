"""`@mcap/core`, which Foxglove reads with: installed by npm into a folder, called by node."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

PACKAGES = ("@mcap/core@2.2.2", "fzstd@0.1.1")  # the latter unpacks chunks; node does so itself from 22.15 on
SCRIPT = Path(__file__).with_name("read_mcap.mjs")
INSTALL_S, TIMEOUT_S = 20.0, 60.0


def install(folder: Path) -> str:
    """The packages and the script beside them; what is missing here, in words, or nothing."""
    if not (shutil.which("node") and shutil.which("npm")):
        return "node and npm are not installed"
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--prefix", str(folder), *PACKAGES]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=INSTALL_S, check=False)
    except subprocess.TimeoutExpired:
        return f"npm did not get {' '.join(PACKAGES)} within {INSTALL_S:g} s"
    if done.returncode:
        return f"npm cannot get {' '.join(PACKAGES)}: {done.stderr.strip()[-200:]}"
    shutil.copy(SCRIPT, folder)
    return ""


def node(folder: Path, log: Path) -> subprocess.CompletedProcess[str]:
    """What the script says of a log."""
    command = ["node", str(folder / SCRIPT.name), str(log)]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)


def read_by_node(folder: Path, log: Path) -> dict[str, Any]:
    """Count, digest and last time of each topic's messages, attachments, schemas; raises AssertionError."""
    done = node(folder, log)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def read_by_python(log: Path) -> dict[str, dict[str, Any]]:
    """Count, digest and last time of each topic's messages, by the MCAP library of Python."""
    messages: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    with log.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            messages[channel.topic].append((message.log_time, message.data))
    return {
        topic: {
            "count": len(own),
            "sha256": hashlib.sha256(b"".join(data for _, data in own)).hexdigest(),
            "last_ns": str(own[-1][0]),
        }
        for topic, own in messages.items()
    }
