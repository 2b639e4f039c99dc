"""Events that can be told from the rows alone, mode changes and safety flags; the same for the same rows."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.modes import Mode, mode_name
from agent.safety import Flag
from agent.telemetry.row.event import Event, Level

FLAG_PAUSE_NS: Final = 1_000_000_000  # a flag that flutters is told of at most once in this time
_LEVEL_OF_MODE: Final = {Mode.HOLD: Level.WARN, Mode.STAND: Level.WARN, Mode.FAULT: Level.ERROR}


class RowEvents:
    """Watches the rows of one agent, in their order."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._mode: int | None = None
        self._flags = 0
        self._told_ns: dict[Flag, int] = {}

    def watch(self, rows: NDArray[np.void]) -> list[Event]:
        """Events of `rows` (k,) of AGENT_STATE, the ones that follow the rows watched before."""
        if not len(rows):
            return []
        modes, flags = rows["mode"], rows["flags"]
        before_mode = np.concatenate([[self._mode if self._mode is not None else modes[0]], modes[:-1]])
        before_flags = np.concatenate([np.array([self._flags], flags.dtype), flags[:-1]])
        events = []
        for i in np.flatnonzero((modes != before_mode) | (flags & ~before_flags)).tolist():
            if modes[i] != before_mode[i]:
                events.append(self._mode_event(rows[i], int(before_mode[i])))
            events += self._flag_events(rows[i], int(flags[i] & ~before_flags[i]))
        self._mode, self._flags = int(modes[-1]), int(flags[-1])
        return events

    def _mode_event(self, row: np.void, before: int) -> Event:
        old, new = mode_name(before), mode_name(int(row["mode"]))
        level = _LEVEL_OF_MODE.get(Mode[new], Level.INFO) if new in Mode.__members__ else Level.WARN
        data = {"sequence": int(row["sequence"]), "t": float(row["t"]), "from": old, "to": new}
        return Event(int(row["utc_ns"]), self._source, level, f"mode {old} → {new}", data)

    def _flag_events(self, row: np.void, set_now: int) -> list[Event]:
        utc_ns = int(row["utc_ns"])
        events = []
        for flag in Flag:
            if not flag & set_now or utc_ns - self._told_ns.get(flag, utc_ns - FLAG_PAUSE_NS) < FLAG_PAUSE_NS:
                continue
            self._told_ns[flag] = utc_ns
            level = Level.ERROR if flag is Flag.NOT_FINITE else Level.WARN
            data = {"sequence": int(row["sequence"]), "t": float(row["t"]), "flag": flag.name}
            text = f"safety: {str(flag.name).lower().replace('_', ' ')}"
            events.append(Event(utc_ns, self._source, level, text, data))
        return events
