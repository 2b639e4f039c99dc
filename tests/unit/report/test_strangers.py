"""What the recorder left out is told in the report."""

from __future__ import annotations

from types import SimpleNamespace

from agent.report.prepared import _strangers


def test_messages_of_strangers_are_named_and_late_ones_of_the_last_run_are_not() -> None:
    told = {"complete": "true", "left.refused": "9", "rejected.another_publisher": "7", "rejected.another_run": "2"}
    log = SimpleNamespace(metadata={"completeness": told})
    assert _strangers(log) == ["7 messages that do not belong to this run were left out: another publisher"]
    assert _strangers(SimpleNamespace(metadata={})) == []
