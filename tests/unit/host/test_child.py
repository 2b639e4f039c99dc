"""A process that `coop run` has started, told of when it fails."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from agent.host.child import Child, ChildFailed
from agent.host.ready_line import pairs
from agent.host.starting import ready
from agent.process.entry import _told, _told_parent


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
    assert error.remedy == f"{child.log} is gone, which was its log"
    child.kill()


def test_a_child_that_does_not_end_is_told_of_as_one_that_still_runs(tmp_path: Path) -> None:
    child = Child("recorder", ["nothing"], tmp_path)
    child.process.send_signal(signal.SIGSTOP)
    error = child.failed("did not close the log")
    assert error.found.startswith("did not close the log (it still runs)")
    assert error.remedy == f"its log is {child.log}"
    child.kill()


@pytest.mark.fault("P14")
def test_a_child_that_dies_of_a_file_that_was_cut_cannot_say_so_but_who_started_it_does(tmp_path: Path) -> None:
    child = Child("arm-left", ["nothing"], tmp_path)
    child.process.send_signal(signal.SIGBUS)
    assert child.wait(60.0) == -signal.SIGBUS
    child.log.write_text("")
    cut = "a file that it stored into was cut, as its ring"
    assert child.failed("ended during the run").found == f"ended during the run (exit code {-signal.SIGBUS}: {cut})"
    child.kill()


def test_a_full_disk_under_its_words_is_no_failure_of_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    told = False
    with contextlib.suppress(OSError), Path("/dev/full").open("w") as full:  # closing it fails
        monkeypatch.setattr(sys, "stderr", full)
        _told("arm left: 12800 cycles")
        told = True
    assert told


@contextlib.contextmanager
def speaking(folder: Path) -> Iterator[tuple[Child, int]]:
    """A child, and where to write what it says."""
    child = Child("recorder", ["nothing"], folder)
    assert child.wait(60.0)
    assert child.process.stdout is not None
    child.process.stdout.close()
    out, into = os.pipe()
    child.process.stdout = os.fdopen(out, "rb", buffering=0)
    yield child, into
    child.kill()


def test_what_a_child_tells_a_person_comes_before_its_end_and_nothing_is_waited_for(tmp_path: Path) -> None:
    with speaking(tmp_path) as (child, into):
        tells_a_person(child, into)


def tells_a_person(child: Child, into: int) -> None:
    assert child.told() == [], "it says nothing, and nothing is waited for"
    for written, told in (
        (b"READY endpoint=x\nTELLS the log ends he", []),
        (b"re\nTELLS once\n", ["the log ends here", "once"]),
    ):
        os.write(into, written)
        assert child.told() == told
    os.close(into)
    assert child.told() == [], "it has ended"


def test_what_a_child_is_ready_for_and_what_it_tells_are_kept_apart_whoever_listens_first(tmp_path: Path) -> None:
    with speaking(tmp_path) as (child, into):
        assert not child.has_said("ring")
        os.write(into, b"TELLS the log ends here\nREADY ring=a socket=b\nREADY torque=on\n")
        assert child.has_said("torque")
        assert child.wait_ready(60.0) == {"ring": "a", "socket": "b"}
        assert child.told() == ["the log ends here"]
        assert child.wait_ready(60.0) == {"torque": "on"}
        assert child.has_said("ring"), "also what has been taken"
        assert not child.has_said("guard")
        os.close(into)


@pytest.mark.parametrize("name", [b"a folder", b"50%20", b"caf\xe9", "ü\n".encode()])
def test_a_child_is_ready_with_the_path_it_means_whatever_is_in_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: bytes
) -> None:
    path = Path(os.fsdecode(name)) / "left.ring"
    with speaking(tmp_path) as (child, into):
        with os.fdopen(into, "w") as out:
            monkeypatch.setattr(sys, "stdout", out)
            ready(pairs(ring=path, socket="plain"))
        assert child.wait_ready(60.0) == {"ring": str(path), "socket": "plain"}


def test_who_waits_for_a_child_looks_at_other_things_meanwhile_and_may_leave(tmp_path: Path) -> None:
    looks = count(1)

    def look() -> None:
        if next(looks) == 3:
            raise KeyboardInterrupt

    with speaking(tmp_path) as (child, into):
        with pytest.raises(KeyboardInterrupt):
            child.wait_ready(1e3, look)
        with pytest.raises(ChildFailed, match="not ready after 0"):
            child.wait_ready(0.1)
        os.close(into)
        with pytest.raises(ChildFailed, match="ended before it was ready"):
            child.wait_ready(1e3)


def test_a_parent_that_is_gone_is_no_failure_of_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    out, into = os.pipe()
    with os.fdopen(out, "rb") as parent, contextlib.suppress(OSError), os.fdopen(into, "w") as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        _told_parent("the log ends here")
        assert parent.readline() == b"TELLS the log ends here\n"
        parent.close()
        _told_parent("and nobody reads it")
