"""What a recorder keeps of the logs that it has ended."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path

from agent.telemetry.link.record import RecordOptions, _Recorder
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import CELL, CONFIG_ID


def test_a_log_that_has_ended_keeps_no_memory_until_a_collection(tmp_path: Path) -> None:
    """What it kept, a MB or two each, was the growth of a recorder over hours: collections of all there is are rare."""
    recorder = _Recorder(RecordOptions(tmp_path / "run.mcap", scene(CELL, {"left": ("elbow",)}), CONFIG_ID), {})
    ended = [weakref.ref(recorder._log), weakref.ref(recorder._channels)]
    gc.collect()
    gc.disable()
    try:
        recorder._next("it reached its limit")
        assert [each() for each in ended] == [None, None]
    finally:
        gc.enable()
        recorder.finish()
