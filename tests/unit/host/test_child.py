"""A process that `coop run` has started, told of when it fails."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from agent.host.child import Child
from agent.process.__main__ import _told


def test_a_child_that_fails_is_told_of_though_its_words_are_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = tmp_path / "logs"
    words.mkdir()
    child = Child("recorder", ["nothing"], words)
    assert child.wait(60.0)
    assert ": " in child.failed("ended").found
    child.log.write_text("")
    monkeypatch.setattr(os, "statvfs", lambda _: SimpleNamespace(f_bavail=0))
    assert child.failed("ended").found.endswith("): no room is left on the disk, not for its words either")
    shutil.rmtree(words)
    error = child.failed("ended")
    assert (error.what, error.found) == ("recorder", f"ended (exit code {child.process.returncode})")
    child.kill()


def test_a_full_disk_under_its_words_is_no_failure_of_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    told = False
    with contextlib.suppress(OSError), Path("/dev/full").open("w") as full:  # closing it fails
        monkeypatch.setattr(sys, "stderr", full)
        _told("arm left: 12800 cycles")
        told = True
    assert told
