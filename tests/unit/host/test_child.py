"""A process that `coop run` has started, told of when it fails."""

from __future__ import annotations

import shutil
from pathlib import Path

from agent.host.child import Child


def test_a_child_that_fails_is_told_of_though_its_words_are_gone(tmp_path: Path) -> None:
    words = tmp_path / "logs"
    words.mkdir()
    child = Child("recorder", ["nothing"], words)
    assert child.wait(60.0)
    assert ": " in child.failed("ended").found
    shutil.rmtree(words)
    error = child.failed("ended")
    assert (error.what, error.found) == ("recorder", f"ended (exit code {child.process.returncode})")
    child.kill()
