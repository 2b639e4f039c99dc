"""A log that ends before its time, as a full disk ends it: who watches the run is told while it goes on."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import configs
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.log.recover import RecoverReport
from agent.process import children, recorder
from agent.process import entry as process_main
from agent.process.children import Children
from agent.process.commands import RecordCommand
from agent.process.listening import record as started
from agent.process.run_kind import RunKind
from agent.process.started import Listener
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.link.record import RecordReport

PAPER = configs.CELLS_DIR / "paper.toml"


class Process:
    """One that runs until it is asked so often."""

    def __init__(self, looks: int, told: tuple[str, ...] = (), code: int = 0) -> None:
        self.process = self
        self.told_from = {3: list(told)}
        self.looks, self.looked, self.code = looks, 0, code

    def poll(self) -> int | None:
        self.looks -= 1
        return None if self.looks >= 0 else self.code

    def told(self) -> list[str]:
        self.looked += 1
        return self.told_from.get(self.looked, [])

    def wait(self, _: float) -> int:
        return self.code

    def terminate(self) -> None:
        """It ends by itself."""

    def failed(self, what: str) -> Exception:
        return RuntimeError(what)


class Watching:
    def __init__(self) -> None:
        self.notes: list[str] = []

    def phase(self, what: str, *, still: bool = False) -> None:
        """Not looked at."""

    def note(self, text: str) -> None:
        self.notes.append(text)

    def advance(self, *_: object) -> None:
        """Not looked at."""


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(children, "RingReader", lambda *_: nullcontext())
    monkeypatch.setattr(children, "HowFar", lambda *_: SimpleNamespace(look=lambda: None))
    monkeypatch.setattr(children, "LOOK_EVERY_S", 0.0)
    return Children(load_cell(PAPER), RunKind.LOCKSTEP, 0, None, tmp_path / "run.mcap", tmp_path)


def test_who_watches_a_run_is_told_at_the_next_look_and_the_run_goes_on(run: Any) -> None:
    watching, agent = Watching(), Process(looks=20)
    run._recorder, run._plant, run._agents = Process(10**9, ("the log ENDS HERE",)), Process(10**9), {"left": agent}
    assert not run.watch(lambda: False, watching)
    assert watching.notes == ["the log ENDS HERE"]
    assert agent.looks < 0, "to its end"


@pytest.mark.parametrize("code", [0, 4])
def test_what_the_recorder_tells_last_is_passed_on_before_the_run_ends(run: Any, code: int) -> None:
    watching = Watching()
    run._recorder, run._plant = Process(0, ("the log ENDS HERE",), code), Process(0)
    run._recorder.looked = 2
    with pytest.raises(RuntimeError, match="did not close the log") if code else nullcontext():
        run.end(watching)
    assert watching.notes == ["the log ENDS HERE"]


def test_the_recorders_process_says_so_and_tells_who_started_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "run.mcap"

    def record(*_: object, ended: Any, **__: object) -> RecordReport:
        ended(log, "No space left on device")
        return RecordReport(log, False, "No space left on device", {}, (), (), (log,))

    monkeypatch.setattr(recorder, "run_recorder", record)
    (tmp_path / "run.json").write_bytes(b"{}")
    said: list[str] = []
    told: list[str] = []
    command = RecordCommand(
        cell=PAPER, out=log, listen=FREE_PORT, driver=DriverKind.SIM, truth=True, seed=0,
        run_info=tmp_path / "run.json", with_parent=None,
    )  # fmt: skip
    assert started(command, Listener(said.append, parent=told.append)) == 4
    line = f"{log}: the log ENDS HERE: No space left on device; the arms go on without it"
    assert said == [line, f"{log}: INCOMPLETE: No space left on device"]
    assert told == [line]


def test_who_records_is_told_of_what_was_left_unfinished_whether_it_could_be_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, mended, damaged, original = (tmp_path / f"run{end}" for end in ("_3.mcap", ".mcap", "_2.mcap", ".kept"))
    repaired = (RecoverReport(mended, True, 9, ()), RecoverReport(damaged, True, 9, (), True, original))
    report = RecordReport(log, True, None, {}, repaired, ("cannot repair old.mcap: found No space left",), (log,))
    monkeypatch.setattr(recorder, "run_recorder", lambda *_, **__: report)
    (tmp_path / "run.json").write_bytes(b"{}")
    said: list[str] = []
    command = RecordCommand(
        cell=PAPER, out=log, listen=FREE_PORT, driver=DriverKind.SIM, truth=True, seed=0,
        run_info=tmp_path / "run.json", with_parent=None,
    )  # fmt: skip
    assert started(command, Listener(said.append)) == 0
    assert said == [
        f"repaired {mended}", f"repaired {damaged}, the damaged original is kept as {original}",
        "not repaired: cannot repair old.mcap: found No space left", f"{log}: complete",
    ]  # fmt: skip


def test_a_process_of_a_run_warns_in_its_words_and_by_its_parent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def warn(_: object, listener: Listener) -> int:
        listener.alert("the log ENDS HERE")
        return 0

    monkeypatch.setattr(process_main, "settle", lambda: None)
    monkeypatch.setattr(process_main, "read", lambda _: None)
    monkeypatch.setattr(process_main, "run", warn)
    assert process_main.main(()) == 0
    assert capsys.readouterr() == ("TELLS the log ENDS HERE\n", "the log ENDS HERE\n")
