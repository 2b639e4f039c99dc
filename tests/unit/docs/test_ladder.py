"""The ladder of docs/hil.md: every step's command is one, in the order of what is real."""

from __future__ import annotations

import pytest

from agent.cli.main import whole
from tests.support.ladder import COMPARED, STEPS


def test_the_ladder_goes_from_all_simulated_to_all_real_arms_in_the_loop() -> None:
    assert [set(step) & {"--wire", "--hil", "--real-arms", "left", "left,right"} for step in STEPS] == [
        set(), {"--wire"}, {"--hil", "left"}, {"--hil", "left", "--real-arms"}, {"--hil", "left,right", "--real-arms"},
    ]  # fmt: skip


@pytest.mark.parametrize("words", [*STEPS, COMPARED], ids=" ".join)
def test_every_step_is_a_command(words: tuple[str, ...]) -> None:
    found = whole().commands[words[0]]  # type: ignore[attr-defined]
    found.make_context(words[0], list(words[1:]))
