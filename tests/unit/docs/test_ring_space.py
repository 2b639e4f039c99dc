"""How much of /run a ring takes, as the pages say it, against the code."""

from __future__ import annotations

import re

from agent.telemetry.ring.texts import TEXT_FORMAT, TEXT_SLOTS
from agent.telemetry.ring.writer import file_bytes
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from tests.support.documents import ROOT

ROWS, TEXTS, PLANT = file_bytes(AGENT_STATE), file_bytes(TEXT_FORMAT, TEXT_SLOTS), file_bytes(PLANT_STATE)


def test_the_space_for_rings_is_what_the_files_take() -> None:
    (told,) = re.findall(r"\*\*Ring space\.\*\*.*?\n\n", (ROOT / "docs/install.md").read_text(), re.DOTALL)
    assert [int(n) for n in re.findall(r"(\d+) MB", told)] == [
        round(size / 1e6) for size in (ROWS + TEXTS, ROWS, TEXTS, PLANT)
    ]
    (decided,) = re.findall(r"files of (\d+) MB", (ROOT / "docs/decisions/0005-telemetry-process.md").read_text())
    assert int(decided) == round((ROWS + TEXTS) / 1e6)
