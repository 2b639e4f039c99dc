"""What a command is doing, on standard error: a spinner or a bar on a terminal, plain lines or nothing elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from agent.cli.options import note

if TYPE_CHECKING:
    from rich.progress import Progress

    from agent.study.measure import RunResult

LINE_EVERY_S: Final = 10.0  # of a run that no terminal shows


class Steps:
    """One step after another: a spinner with the time it takes.  Call it with what begins now.

    Where there is no terminal each step is a line if `lines`, otherwise nothing.
    """

    def __init__(self, *, lines: bool = False) -> None:
        self._lines = lines
        self._shown: Progress | None = None
        self._turning = set[threading.Thread]()  # what has it turn

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.clear()

    def __call__(self, what: str, *, still: bool = False) -> None:
        """Say what is being done from now on; still: without the thread that has a spinner turn."""
        if not _on_terminal():
            if self._lines:
                note(what)
            return
        self.clear()
        self._shown = _spinner(still=still)
        self._shown.add_task(what)
        before = set(threading.enumerate())
        self._shown.start()
        self._turning = set(threading.enumerate()) - before

    def clear(self) -> None:
        """Take the spinner away, and its thread; the next step brings it back."""
        if self._shown is not None:
            self._shown.stop()
            self._shown = None
            for thread in self._turning:
                thread.join()


class RunProgress:
    """What `coop run` shows: steps until it runs, then a bar with simulated time, real-time factor and error.

    Nothing is drawn before the first step, so a refused cell leaves no bar behind.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._steps = Steps()
        self._bar: Progress | None = None
        self._next_line_s = clock_s() + LINE_EVERY_S

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._steps.clear()
        if self._bar is not None:
            self._bar.stop()

    def phase(self, what: str, *, still: bool = False) -> None:
        """Say what is being done."""
        if self._bar is None:
            self._steps(what, still=still)
        else:
            self._bar.update(self._bar.task_ids[0], description=what)

    def note(self, text: str) -> None:
        """Write a line that stays: in the place of the spinner, above the bar."""
        self._steps.clear()
        if self._bar is None:
            note(text)
        else:  # which else has its own end in front of the text
            self._bar.console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None:
        """Show how far the run is."""
        error = "-" if error_mm is None else f"{error_mm:.2f} mm"
        if not _on_terminal():
            if self._clock_s() >= self._next_line_s:
                self._next_line_s = self._clock_s() + LINE_EVERY_S
                so_far = f"{t_s:.1f} s of {duration_s:g} s, {speed:.1f}x real time, seen error {error}"
                beside = "before the start of the trajectory" if t_s < 0.0 else "behind the end of the trajectory"
                note(so_far if 0.0 <= t_s <= duration_s else beside)
            return
        if self._bar is None:
            self._steps.clear()
            self._bar = _bar()
            self._bar.add_task("running", total=1.0, t=0.0, duration=0.0, speed=0.0, error="-")
            self._bar.start()
        self._bar.update(
            self._bar.task_ids[0], completed=max(0.0, t_s / duration_s), t=max(0.0, t_s), duration=duration_s,
            speed=max(0.0, speed), error=error,
        )  # fmt: skip


class StudyProgress:
    """What `coop study` shows: a bar with finished, lost and tripped runs and the time that is left."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._bar: Progress | None = None
        self._done = self._total = self._lost = self._tripped = 0
        self._next_line_s = clock_s() + LINE_EVERY_S

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def begin(self, done: int, total: int) -> None:
        """Runs are about to be done; `done` were there before."""
        self._done, self._total = done, total
        if done:
            note(f"{done} of {total} runs are there already")
        if _on_terminal():
            self._bar = _study_bar()
            self._bar.add_task("", total=total, completed=done, lost=0, tripped=0)
            self._bar.start()

    def advance(self, result: RunResult) -> None:
        """One more run is finished."""
        self._done += 1
        self._lost += result.lost
        self._tripped += result.tripped
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self._done, lost=self._lost, tripped=self._tripped)
        elif self._clock_s() >= self._next_line_s:
            self._next_line_s = self._clock_s() + LINE_EVERY_S
            note(f"{self._done} of {self._total} runs, {self._lost} lost, {self._tripped} tripped")


def _on_terminal() -> bool:
    """Whether standard error is a terminal; what rich 14 puts before it while it draws denies that."""
    shown: bool = getattr(sys.stderr, "rich_proxied_file", sys.stderr).isatty()
    return shown


def _study_bar() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        MofNCompleteColumn(),
        BarColumn(),
        TextColumn("{task.fields[lost]} lost, {task.fields[tripped]} tripped"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )


def _spinner(*, still: bool) -> Progress:
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True, auto_refresh=not still)


def _bar() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[t]:6.1f} s of {task.fields[duration]:g} s"),
        TextColumn("{task.fields[speed]:5.1f}x real time"),
        TextColumn("seen error {task.fields[error]}"),
        console=Console(stderr=True),
    )
