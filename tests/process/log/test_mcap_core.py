"""`@mcap/core`, which Foxglove reads with, reads a whole log and a recovered one: every message, byte for byte."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from agent.log.recover import recover
from tests.support.telemetry.log_maker import make_log

PACKAGES = ("@mcap/core@2.2.2", "fzstd@0.1.1")  # the latter unpacks chunks; node does so itself from 22.15 on
SCRIPT = Path(__file__).with_name("read_mcap.mjs")
TIMEOUT_S = 60.0


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script and the packages beside it; skips where there is no node or no registry."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("mcap_core")
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--prefix", str(folder), *PACKAGES]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm did not get {' '.join(PACKAGES)} within {TIMEOUT_S:g} s")
    if done.returncode:
        pytest.skip(f"npm cannot get {' '.join(PACKAGES)}: {done.stderr.strip()[-200:]}")
    shutil.copy(SCRIPT, folder)
    return folder


def read_by_node(folder: Path, log: Path) -> dict[str, Any]:
    command = ["node", str(folder / SCRIPT.name), str(log)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def read_by_python(log: Path) -> dict[str, dict[str, Any]]:
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


@pytest.mark.parametrize("killed", [False, True], ids=["whole", "recovered"])
def test_every_message_is_read_byte_for_byte(library: Path, tmp_path: Path, killed: bool) -> None:
    log = tmp_path / "run.mcap"
    make_log(log, 1000, batches=20, finish=not killed)
    if killed:
        with log.open("ab") as file:
            file.write(b"\x05half a record")  # what a kill leaves behind
        assert recover(log).repaired
    found = read_by_node(library, log)
    assert found["topics"] == read_by_python(log)
    assert found["topics"]["/coop/paper/left/state"]["count"] == 1000
    assert found["told"] == sum(own["count"] for own in found["topics"].values())
    assert "run.json" in found["attachments"]
    assert "tf2_msgs/msg/TFMessage" in found["schemas"]


def test_a_log_that_is_not_finished_is_refused_by_its_reader(library: Path, tmp_path: Path) -> None:
    """So the two above are read by their index, and that of a recovered log is there."""
    log = tmp_path / "run.mcap"
    make_log(log, 100, finish=False)
    command = ["node", str(library / SCRIPT.name), str(log)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.returncode != 0
    assert "MCAP" in done.stderr
