"""What telemetry and recorder say at their end, and with which code they end: nothing that is missing goes unsaid."""

from __future__ import annotations

from pathlib import Path

import pytest

import configs
from agent.config.schema.driver import DriverKind
from agent.log.lacking import missing
from agent.process import recorder as recorders
from agent.process import telemetry as telemetries
from agent.process.commands import RecordCommand, TelemetryCommand
from agent.process.listening import record, telemetry
from agent.process.started import Listener
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.link.publication import PublishReport
from agent.telemetry.link.record import RecordReport
from agent.telemetry.link.wire import End
from tests.support.documents import ROOT

PAPER = configs.CELLS_DIR / "paper.toml"
LOG, LAST = Path("run.mcap"), Path("run_2.mcap")


def of(member: str, **changes: int | str) -> dict[str, str]:
    whole = {"rows_expected": 9, "rows_recorded": 9, "end": "finished", "lost_in_ring": 0, "lost_on_the_way": 0}
    more = {"lost_on_disk": 0, "rows_before": 0, "missing_before": 0}
    return {f"{member}.{key}": str(value) for key, value in (whole | more | changes).items()}


@pytest.mark.parametrize("with_parent", [None, 1])
@pytest.mark.parametrize(
    ("report", "said", "code"),
    [
        (PublishReport(9, 0, 0, End.FINISHED), "9 rows, 0 lost in the ring, 0 not confirmed by the recorder", 0),
        (PublishReport(9, 9, 0, End.FINISHED), "9 rows, 9 lost in the ring, 0 not confirmed by the recorder", 1),
        (
            PublishReport(9, 2, 0, End.DIED, cut="7 of 99 bytes"),
            "9 rows, 2 lost in the ring, which was cut to 7 of 99 bytes, 0 not confirmed by the recorder", 1,
        ),
        (
            PublishReport(9, 0, 4, End.FINISHED, "File too large"),
            "9 rows, 0 lost in the ring, 4 not confirmed by the recorder, whose log has ended: File too large", 1,
        ),
    ],
)  # fmt: skip
def test_telemetry_says_what_is_missing_and_ends_with_1_where_no_run_reports_it(
    monkeypatch: pytest.MonkeyPatch, report: PublishReport, said: str, code: int, with_parent: int | None
) -> None:
    asked = []
    monkeypatch.setattr("agent.process.listening.begin", lambda *_, **__: lambda: False)

    def run(*_: object, **more: object) -> PublishReport:
        asked.append(more["joints"])
        return report

    monkeypatch.setattr(telemetries, "run_telemetry", run)
    words: list[str] = []
    command = TelemetryCommand(
        cell=PAPER, member="left", ring=LOG, connect="tcp/h:1", lockstep=False, with_parent=with_parent
    )
    assert telemetry(command, Listener(words.append)) == (0 if with_parent else code)
    assert words == [f"left: {said}"]
    assert asked == [("shoulder", "elbow", "wrist_angle")]


@pytest.mark.parametrize(
    ("completeness", "why"),
    [
        (of("left") | of("plant", rows_expected=0, rows_recorded=0, end="open"), "no row of plant came"),
        (of("left", end="open"), "left had not ended"),
        (of("left", rows_recorded=8), "8 of 9 rows of left"),
        (
            of("left", rows_recorded=2, lost_in_ring=3, lost_on_disk=4)
            | of("right", rows_recorded=8, lost_on_the_way=1),
            "2 of 9 rows of left, 3 lost in the ring, 4 lost on the disk; 8 of 9 rows of right, 1 lost on the way",
        ),
        (of("left", rows_expected=0, rows_recorded=0, rows_before=9), "an earlier one of its logs says what"),
        (of("left", rows_before=5, missing_before=3), "3 rows of left are missing in the logs before"),
        (of("left") | {"rejected.too_large": "3"}, "an earlier one of its logs says what"),
    ],
)
@pytest.mark.parametrize(("with_parent", "code"), [(None, 1), (1, 0)])
def test_a_recorder_says_why_its_log_is_not_complete(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, completeness: dict[str, str], why: str,
    with_parent: int | None, code: int,
) -> None:  # fmt: skip
    monkeypatch.setattr("agent.process.listening.begin", lambda *_, **__: lambda: False)
    report = RecordReport(LOG, False, None, completeness, (), (), (LOG, LAST))
    monkeypatch.setattr(recorders, "run_recorder", lambda *_, **__: report)
    (tmp_path / "run.json").write_bytes(b"{}")
    words: list[str] = []
    command = RecordCommand(
        cell=PAPER, out=LOG, listen=FREE_PORT, driver=DriverKind.SIM, truth=True, seed=0,
        run_info=tmp_path / "run.json", with_parent=with_parent,
    )  # fmt: skip
    assert record(command, Listener(words.append)) == code
    assert words[-1] == f"{LAST}: INCOMPLETE: {why}", "the log that the figures are of"


@pytest.mark.parametrize(
    ("driver", "truth", "waits"),
    [(None, False, True), (DriverKind.DYNAMIXEL, False, False), (DriverKind.DYNAMIXEL, True, True)],
)
def test_a_recorder_of_emulated_servos_waits_for_a_plant_as_the_page_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, driver: DriverKind | None, truth: bool, waits: bool
) -> None:
    asked = list[bool]()
    monkeypatch.setattr("agent.process.listening.begin", lambda *_, **__: lambda: False)

    def run(*_: object, has_plant: bool, **__: object) -> RecordReport:
        asked.append(has_plant)
        return RecordReport(LOG, True, None, {}, (), (), (LOG,))

    monkeypatch.setattr(recorders, "run_recorder", run)
    (tmp_path / "run.json").write_bytes(b"{}")
    command = RecordCommand(
        cell=PAPER, out=LOG, listen=FREE_PORT, driver=driver, truth=truth, seed=0, run_info=tmp_path / "run.json"
    )
    assert record(command, Listener([].append)) == 0
    assert asked == [waits]
    page = " ".join((ROOT / "docs/commands.md").read_text().split())
    assert "recorder is `coop record CELL --driver dynamixel`, with `--truth` and `coop telemetry CELL --member" in page


def test_of_what_is_whole_nothing_is_missing() -> None:
    assert missing(of("left") | of("plant", end="died") | {"complete": "true"}) == []
