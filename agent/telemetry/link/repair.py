"""What earlier recorders left unfinished is mended beside a recording, in a thread of its own."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Self

from agent.log.recover import RecoverReport, repair_leftovers


class Repair:
    """Mends, beside the recording, what earlier recorders left in the folder; given up when recording ends."""

    def __init__(self, path: Path, *, wanted: bool) -> None:
        """`path`: the log that is being written, which is left alone; `wanted`: whether anything is done."""
        self.repaired: tuple[RecoverReport, ...] = ()
        self.failed: tuple[str, ...] = ()
        self._path, self._wanted = path, wanted
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log-repair", daemon=True)

    def __enter__(self) -> Self:
        if self._wanted:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._wanted:
            self._thread.join()

    def _run(self) -> None:
        self.repaired, self.failed = repair_leftovers(self._path.parent, but=self._path, stop=self._stop.is_set)
