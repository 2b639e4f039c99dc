"""What several commands share."""

from __future__ import annotations

import gc

import pytest

from agent.cli.options import uncollected


@pytest.mark.parametrize("enabled", [True, False])
def test_no_garbage_is_looked_for_in_a_command_nor_at_once_after_it(enabled: bool) -> None:
    gc.unfreeze()  # what the tests before have loaded
    looked: list[str] = []
    gc.callbacks.append(lambda phase, _: looked.append(phase))
    try:
        if not enabled:
            gc.disable()
        with uncollected():
            kept = [[] for _ in range(10 * gc.get_threshold()[0])]
        after = [[] for _ in range(gc.get_threshold()[0] // 2)]
        assert (looked, gc.isenabled(), gc.get_freeze_count()) == ([], enabled, 0)
        assert len(kept) > len(after) > 0
    finally:
        gc.callbacks.pop()
        gc.enable()
