"""How the arms of this host are: what each agent answers, and what its ring says whether it answers or not."""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agent.config.cell import Cell
from agent.host.clock import ClockState
from agent.host.flock import file_of, flocks
from agent.host.paths import barred, ring_paths
from agent.log.locks import lock_path, note_path
from agent.operator.ask import Heard, Silence, ask_arms
from agent.operator.local import Places, host_name, local_arms, places
from agent.operator.message import Request
from agent.operator.past import Past, look
from agent.operator.show import HUNG, silent
from agent.operator.table import Verb

STATUS_TIMEOUT_S = 0.5  # an agent answers within a cycle
SCHEMA = 1
AGAIN, AGAIN_S = 5, 0.1
NOTE_BYTES_MAX = 1 << 16
LOG_FOLDERS = (Path("/var/lib/coop/runs"), Path("runs"))  # of the shipped unit, and of `coop record`


def status(
    cell: Cell, clock: ClockState, host: str | None = None, logs: Sequence[Path] = LOG_FOLDERS,
    timeout_s: float = STATUS_TIMEOUT_S,
) -> dict[str, Any]:  # fmt: skip
    """All that `coop status --json` shows.  Raises ControlError when no arm of the cell is on this host."""
    names = [arm.name for arm in local_arms(cell, host)]
    found = arms(cell, places(cell, names, (), host), timeout_s, whole=True)
    return {
        "schema": SCHEMA,
        "cell": cell.file.name,
        "fingerprint": cell.fingerprint,
        "host": host or host_name(),
        "utc_ns": time.time_ns(),
        "clock": {"synchronised": clock.synchronised, "max_error_s": _finite(clock.max_error_s)},
        "recorder": recorder(cell.file.name, logs),
        "arms": found,
    }


def arms(
    cell: Cell, meant: Places, timeout_s: float = STATUS_TIMEOUT_S, *, whole: bool = False
) -> list[dict[str, Any]]:
    """How these arms are, as in `status`; whole: with what only its ring says of one that answers.

    Who hangs by one look is asked again: its guard may be about to listen in the place of an agent that has ended.
    """
    found = {arm["arm"]: arm for arm in _asked(cell, meant, timeout_s, whole=whole)}
    for _ in range(AGAIN):
        hung = {name: meant[name] for name, arm in found.items() if _hangs(arm)}
        if not hung:
            break
        time.sleep(AGAIN_S)
        found |= {arm["arm"]: arm for arm in _asked(cell, hung, AGAIN_S, whole=whole) if not _hangs(arm)}
    return list(found.values())


def _hangs(arm: Mapping[str, Any]) -> bool:
    return not arm["answers"] and silent(arm)[0] == HUNG


def _asked(cell: Cell, meant: Places, timeout_s: float, *, whole: bool) -> list[dict[str, Any]]:
    heard = ask_arms(meant, Request(Verb.STATUS), timeout_s)
    wanted = {name: whole or isinstance(one, Silence) for name, one in heard.items()}
    pasts = {name: _past(cell, name, one) if wanted[name] else None for name, one in heard.items()}
    utc_ns, monotonic_ns = time.time_ns(), time.monotonic_ns()
    ages_s = {name: past.age_s(monotonic_ns, utc_ns) if past else None for name, past in pasts.items()}
    return [_arm(cell, name, one, pasts[name], ages_s[name]) for name, one in heard.items()]


def _past(cell: Cell, arm: str, heard: Heard) -> Past | None:
    """What its ring says; None also of what is no arm of the cell, but a socket.

    Who answers says where its ring is; one that nobody writes any more is that of an earlier run.
    """
    if arm not in {one.name for one in cell.arms}:
        return None
    own = None if isinstance(heard, Silence) else heard.details.get("ring")
    rings = ring_paths(cell.file.name, arm) if own is None else (Path(str(own)),)
    past = look([ring for ring in rings if not barred(ring)], cell.file.rate_hz)
    is_before = past is not None and not isinstance(heard, Silence) and not past.written_by_the_living
    return None if is_before else past


def _arm(cell: Cell, name: str, heard: Heard, past: Past | None, age_s: float | None) -> dict[str, Any]:
    """One arm; of a dead one the mode is that of its last row."""
    details: dict[str, Any] = {}
    silence = heard.found if isinstance(heard, Silence) else None
    if not isinstance(heard, Silence):
        details = dict(heard.details)
    return {
        "arm": name,
        "answers": silence is None,
        "silence": silence,
        "alive": silence is None or bool(past and past.written_by_the_living),
        "ended": silence is not None and bool(past and past.ended),
        "failed": past.failed if silence is not None and past else None,
        "failed_utc_ns": past.failed_utc_ns if silence is not None and past else None,
        "mode": heard.mode if not isinstance(heard, Silence) else past.mode if past else None,
        "reason": heard.reason if not isinstance(heard, Silence) else "",
        "same_cell": None if isinstance(heard, Silence) else heard.fingerprint == cell.fingerprint,
        "pid": details.get("pid"),
        "driver": details.get("driver"),
        "real_time": details.get("real_time"),
        "guard": details.get("guard"),
        "no_start": details.get("no_start"),
        "session": details.get("session"),
        "drops_on_stop": details.get("drops_on_stop"),
        "clock_bound_s": details.get("clock_bound_s"),
        "start_utc_ns": details.get("start_utc_ns"),
        "last_row_age_s": age_s,
        "timing": past.timing() if past else None,
        "errors": past.errors() if past else None,
        "servos": past.temperatures() if past else None,
    }


def recorder(cell: str, folders: Sequence[Path]) -> dict[str, Any]:
    """Whether a recorder of the cell has one of these folders, and the newest log there; elsewhere nobody looks."""
    locked, looked_in = flocks(), [str(folder) for folder in folders]
    for folder in folders:
        try:
            status = lock_path(folder, cell).stat()
        except OSError:
            continue
        if file_of(status) in locked:
            return {
                "alive": True,
                "folder": str(folder),
                **_newest(folder),
                "left_out": _left_out(note_path(folder, cell)),
                "looked_in": looked_in,
            }
    return {
        "alive": False, "folder": None, "log": None, "log_bytes": None, "left_out": {}, "looked_in": looked_in,
    }  # fmt: skip


def _left_out(note: Path) -> dict[str, int]:
    """Messages that the recorder did not take because they do not belong to the cell, by reason, as it has noted."""
    try:
        noted = json.loads(note.read_bytes()[:NOTE_BYTES_MAX] or b"{}").get("left_out", {})
        return {str(why): int(count) for why, count in noted.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def _newest(folder: Path) -> dict[str, Any]:
    logs = dict[Path, os.stat_result]()
    for path in folder.glob("*.mcap"):
        with contextlib.suppress(OSError):  # the recorder has removed it meanwhile, or a link leads nowhere
            logs[path] = path.stat()
    if not logs:
        return {"log": None, "log_bytes": None}
    newest = max(logs, key=lambda path: logs[path].st_mtime_ns)
    return {"log": newest.name, "log_bytes": logs[newest].st_size}


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None
