"""What `coop run` shows while it runs: a bar with simulated time, real-time factor and error."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn


class RunProgress:
    """A progress bar on a terminal; on anything else one line now and then."""

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[t]:6.1f} s of {task.fields[duration]:g} s"),
            TextColumn("{task.fields[speed]:5.1f}x real time"),
            TextColumn("error {task.fields[error]}"),
            console=console,
            transient=False,
        )
        self._task = self._progress.add_task("starting", total=1.0, t=0.0, duration=0.0, speed=0.0, error="-")

    def __enter__(self) -> RunProgress:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()
        if not self._progress.console.is_terminal:
            self._progress.console.line()

    def phase(self, what: str) -> None:
        """Say what is being done."""
        self._progress.update(self._task, description=what)

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None:
        """Show how far the run is."""
        error = "-" if error_mm is None else f"{error_mm:.2f} mm"
        self._progress.update(
            self._task, completed=t_s / duration_s, t=t_s, duration=duration_s, speed=speed, error=error
        )
