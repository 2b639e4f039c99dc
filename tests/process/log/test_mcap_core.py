"""`@mcap/core`, which Foxglove reads with, reads a whole log and a recovered one: every message, byte for byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.log.recover import recover
from tests.support.mcap_core import install, node, read_by_node, read_by_python
from tests.support.telemetry.log_maker import make_log

ROWS = 400


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script and the packages beside it; skips where there is no node or no registry."""
    folder = tmp_path_factory.mktemp("mcap_core")
    if missing := install(folder):
        pytest.skip(missing)
    return folder


@pytest.mark.parametrize("killed", [False, True], ids=["whole", "recovered"])
def test_every_message_is_read_byte_for_byte(library: Path, tmp_path: Path, killed: bool) -> None:
    log = tmp_path / "run.mcap"
    make_log(log, ROWS, batches=20, finish=not killed)
    if killed:
        with log.open("ab") as file:
            file.write(b"\x05half a record")  # what a kill leaves behind
        assert recover(log).repaired
    found = read_by_node(library, log)
    assert found["topics"] == read_by_python(log)
    assert found["topics"]["/coop/paper/left/state"]["count"] == ROWS
    assert found["told"] == sum(own["count"] for own in found["topics"].values())
    assert "run.json" in found["attachments"]
    assert "tf2_msgs/msg/TFMessage" in found["schemas"]


def test_a_log_that_is_not_finished_is_refused_by_its_reader(library: Path, tmp_path: Path) -> None:
    """So the two above are read by their index, and that of a recovered log is there."""
    log = tmp_path / "run.mcap"
    make_log(log, 100, finish=False)
    done = node(library, log)
    assert done.returncode != 0
    assert "MCAP" in done.stderr
