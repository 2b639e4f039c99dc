"""What is shown while a command works: on a terminal something that moves, elsewhere no more than a log wants."""

from __future__ import annotations

import io
import json
import re
import threading
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from rich.live import _RefreshThread

import configs
from agent.cli.options import WIDTH_ELSEWHERE, console
from agent.cli.progress import LINE_EVERY_S, RunProgress, Steps, StudyProgress
from tests.support.command import coop

BAR = "━"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return Terminal()


def lines(shown: io.StringIO) -> list[str]:
    """Text without what moves the cursor and colours it."""
    return re.sub(r"\x1b\[[?0-9;]*[A-Za-z]", "", shown.getvalue()).replace("\r", "\n").split("\n")


def test_steps_spin_on_a_terminal_and_leave_nothing(terminal: Terminal) -> None:
    with redirect_stderr(terminal), Steps() as step:
        step("reading [the] log")
        step("fitting")
    assert any("reading [the] log" in line for line in lines(terminal))
    assert any("fitting" in line for line in lines(terminal))
    assert terminal.getvalue().rstrip().endswith("\x1b[2K"), "the last thing done is to clear the line"


def turning() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if isinstance(thread, _RefreshThread)]


def test_a_step_in_which_processes_are_copied_is_shown_without_a_thread(terminal: Terminal) -> None:
    with redirect_stderr(terminal), RunProgress() as progress:
        progress.phase("checking")
        assert len(turning()) == 1
        progress.phase("starting", still=True)
        assert turning() == []
        progress.phase("torque on")
        assert len(turning()) == 1
    assert any("starting" in line for line in lines(terminal))
    assert turning() == []


def test_steps_are_lines_elsewhere_where_asked() -> None:
    with redirect_stderr(io.StringIO()) as shown, Steps(lines=True) as step:
        step("looking")
        step("writing")
    assert shown.getvalue() == "looking\nwriting\n"


def test_steps_are_silent_elsewhere_otherwise() -> None:
    with redirect_stderr(io.StringIO()) as shown, Steps() as step:
        step("looking")
    assert shown.getvalue() == ""


def test_nothing_is_drawn_before_the_first_step(terminal: Terminal) -> None:
    with redirect_stderr(terminal), RunProgress():
        pass
    assert terminal.getvalue() == ""


def test_a_run_that_is_refused_draws_no_bar(terminal: Terminal) -> None:
    with redirect_stderr(terminal), RunProgress() as progress:
        progress.phase("checking")
    assert any("checking" in line for line in lines(terminal))
    assert BAR not in terminal.getvalue()


def test_a_run_has_a_bar_from_its_first_row_on(terminal: Terminal) -> None:
    with redirect_stderr(terminal), RunProgress() as progress:
        progress.phase("starting")
        progress.advance(25.0, 100.0, 4.5, 0.123)
        progress.phase("report")
    last = next(line for line in reversed(lines(terminal)) if BAR in line)
    assert re.match(r"report +━+.* +25\.0 s of 100 s +4\.5x real time seen error 0\.12 mm", last)
    assert last.count(BAR) > 10


def test_a_note_stays_above_what_a_run_does_next(terminal: Terminal) -> None:
    with redirect_stderr(terminal), RunProgress() as progress:
        progress.phase("checking")
        progress.note("it uses another folder")
        progress.phase("starting")
    assert "it uses another folder" in lines(terminal)


class Written(io.TextIOWrapper):
    """A terminal with bytes below it, to which `echo` writes past whoever draws there."""

    def isatty(self) -> bool:
        return True


@pytest.mark.usefixtures("terminal")
def test_a_note_has_a_line_of_its_own_above_what_is_drawn() -> None:
    written = io.BytesIO()
    with redirect_stderr(Written(written, encoding="utf-8", write_through=True)), RunProgress() as progress:
        progress.phase("starting")
        progress.note("arms left MOVE")
        progress.phase("running")
        progress.advance(1.0, 5.0, 1.0, 0.1)
        progress.note("arm left [HOLDS] :o:")
        progress.advance(2.0, 5.0, 1.0, 0.1)
    shown = lines(io.StringIO(written.getvalue().decode()))
    assert "arms left MOVE" in shown
    assert "arm left [HOLDS] :o:" in shown


@pytest.mark.parametrize(("t_s", "least", "most"), [(10.0, 0.05, 0.2), (90.0, 0.8, 0.95)])
def test_the_bar_is_as_full_as_the_run_is_far(terminal: Terminal, t_s: float, least: float, most: float) -> None:
    with redirect_stderr(terminal), RunProgress() as progress:
        progress.advance(t_s, 100.0, 4.5, None)
    last = next(line for line in reversed(re.split("[\r\n]", terminal.getvalue())) if BAR in line)
    pieces = [len(piece) for piece in re.findall(f"{BAR}+", last)]
    assert least < pieces[0] / sum(pieces) < most


def test_the_bar_takes_the_place_of_the_spinner(terminal: Terminal) -> None:
    def drawing() -> int:
        threads = [thread for thread in threading.enumerate() if isinstance(thread, _RefreshThread)]
        return sum(not thread.done.is_set() for thread in threads)

    with redirect_stderr(terminal), RunProgress() as progress:
        progress.phase("starting")
        assert drawing() == 1
        progress.advance(25.0, 100.0, 4.5, None)
        assert drawing() == 1
    assert drawing() == 0


def test_a_run_without_a_terminal_says_now_and_then_where_it_is() -> None:
    now = [0.0]
    with redirect_stderr(io.StringIO()) as shown, RunProgress(lambda: now[0]) as progress:
        progress.phase("running")
        for tick in range(100):
            now[0] = 0.25 * tick
            progress.advance(float(tick), 100.0, 4.0, None if tick < 60 else 0.2)
    assert shown.getvalue().splitlines() == [
        "40.0 s of 100 s, 4.0x real time, seen error -",
        "80.0 s of 100 s, 4.0x real time, seen error 0.20 mm",
    ]
    assert LINE_EVERY_S == 10.0


def test_before_the_start_and_behind_the_end_no_time_of_the_trajectory_is_told(terminal: Terminal) -> None:
    """A session's arms go to the object first, and nobody knows when the start will be."""
    now = [0.0]
    with redirect_stderr(io.StringIO()) as shown, RunProgress(lambda: now[0]) as progress:
        now[0] = 100.0
        progress.advance(-86400.0, 100.0, -1e4, 0.0)
        now[0] = 200.0
        progress.advance(126.8, 100.0, 0.7, 0.0)  # the arms go back to their rests
    assert shown.getvalue() == "before the start of the trajectory\nbehind the end of the trajectory\n"
    with redirect_stderr(terminal), RunProgress() as progress:
        progress.advance(-86400.0, 100.0, -1e4, 0.0)
    assert re.search(r"running .* 0\.0 s of 100 s +0\.0x real time", "".join(lines(terminal)))


def test_a_cell_that_is_not_there_draws_nothing(terminal: Terminal, tmp_path: Path) -> None:
    done = coop("run", tmp_path / "nothere.toml", err=terminal)
    assert done.code == 2
    assert done.err.startswith("coop: ")
    assert done.err.count("\n") == 1


def test_doctor_says_what_it_looks_at(tmp_path: Path) -> None:
    done = coop("doctor", configs.CELLS_DIR / "paper.toml", "--ports", tmp_path, "--logs", tmp_path, "--json")
    assert done.err.splitlines() == [
        "looking at the host and the cell file", "looking at arm left", "looking at arm right",
    ]  # fmt: skip
    assert done.code == 2
    document = json.loads(done.out)
    assert list(document) == ["schema", "cell", "fingerprint", "verdict", "findings", "cycles"]
    assert document["schema"] == 1


def test_tables_are_as_wide_as_they_like_where_no_terminal_cuts_them(terminal: Terminal) -> None:
    with redirect_stdout(terminal):
        assert console().width == 100
    with redirect_stdout(io.StringIO()):
        assert console().width == WIDTH_ELSEWHERE


class Finished:
    """As much of a run's result as a progress reads."""

    def __init__(self, *, lost: bool, tripped: bool) -> None:
        self.lost, self.tripped = lost, tripped


def test_a_study_counts_its_runs_in_a_bar_on_a_terminal(terminal: Terminal) -> None:
    with redirect_stderr(terminal), StudyProgress() as progress:
        progress.begin(1, 4)
        progress.advance(Finished(lost=True, tripped=False))  # type: ignore[arg-type]
        progress.advance(Finished(lost=False, tripped=True))  # type: ignore[arg-type]
    shown = "\n".join(lines(terminal))
    assert "1 of 4 runs are there already" in shown
    assert BAR in shown
    assert re.search(r"3/4 .*1 lost, 1 tripped", shown)


def test_a_study_writes_a_line_now_and_then_elsewhere() -> None:
    now = 0.0
    with redirect_stderr(io.StringIO()) as shown, StudyProgress(lambda: now) as progress:
        progress.begin(0, 3)
        progress.advance(Finished(lost=True, tripped=True))  # type: ignore[arg-type]
        now += LINE_EVERY_S
        progress.advance(Finished(lost=False, tripped=True))  # type: ignore[arg-type]
        progress.advance(Finished(lost=False, tripped=False))  # type: ignore[arg-type]
    assert shown.getvalue() == "2 of 3 runs, 1 lost, 2 tripped\n"
