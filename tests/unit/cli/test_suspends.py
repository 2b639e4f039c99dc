"""Which commands Ctrl-Z suspends: those that watch over no arm and measure nothing."""

from __future__ import annotations

import pytest

from agent.host import signals
from tests.support.command import coop


class Told(Exception):
    """How the command wants to hear of a stop."""


@pytest.mark.parametrize(
    ("words", "suspends"),
    [
        (("study", "paper"), True),
        (("view", "run.mcap"), True),
        (("play", "run.mcap"), True),
        (("guide", "paper"), True),
        (("status", "paper", "--watch"), True),
        (("run", "paper"), False),
        (("float", "two_wx200", "--arm", "left", "--emulate"), False),
        (("latency-test",), False),
    ],
    ids=lambda words: words[0] if isinstance(words, tuple) else "",
)
def test_ctrl_z_suspends_what_has_nothing_to_watch_over(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], suspends: bool
) -> None:
    def told(**how: bool) -> None:
        raise Told(how)

    monkeypatch.setattr(signals, "StopFlag", told)
    with pytest.raises(Told) as seen:
        coop(*words)
    assert seen.value.args == ({"suspends": True} if suspends else {},)
