"""What an arm's ring says of its last seconds, whether its agent lives or not: mode, loop timing, errors, servos."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.modes import mode_name
from agent.safety import Flag
from agent.telemetry.ring.file import RingError
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextReader
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.health import GRIP, Health
from agent.telemetry.row.sample import AGENT_STATE, BUS_COUNTERS
from agent.telemetry.row.topics import Kind
from drivers.clock import LOCKSTEP_UTC_NS

OVER_S = 2.0
ROWS_MAX = 2000
_STALE = int(Flag.STALE)


@dataclass(frozen=True)
class Past:
    """The end of one ring."""

    written_by_the_living: bool
    rows: NDArray[np.void]  # (k,) of the last OVER_S, oldest first; k may be 0
    health: Health | None
    trouble: Event | None  # the last event that warns or is worse
    ended: bool = False  # in order, by whoever wrote it: the servos were told to let go before
    failed: str | None = None  # why whoever wrote it ended, where that was by an error
    failed_utc_ns: int | None = None  # when it told so

    @property
    def mode(self) -> str | None:
        """Mode of the last row."""
        if not len(self.rows):
            return None
        return mode_name(int(self.rows["mode"][-1]))

    @property
    def utc_ns(self) -> int | None:
        """Of the last row."""
        return int(self.rows["utc_ns"][-1]) if len(self.rows) else None

    def age_s(self, monotonic_ns: int, utc_ns: int) -> float | None:
        """How long ago the last row was, s, by these readings of CLOCK_MONOTONIC and UTC; None without a row.

        Stamps of somebody who lives are CLOCK_MONOTONIC's, so that a step of the wall clock is no age.  UTC tells of
        one who is dead, whose ring a restart of the host may have left, and of lockstep, whose zero is a whole second.
        """
        if not len(self.rows):
            return None
        stamp_ns, row_utc_ns = (int(self.rows[name][-1]) for name in ("stamp_ns", "utc_ns"))
        in_lockstep = (row_utc_ns - stamp_ns) % LOCKSTEP_UTC_NS == 0
        age_ns = monotonic_ns - stamp_ns if self.written_by_the_living and not in_lockstep else utc_ns - row_utc_ns
        return max(0.0, 1e-9 * age_ns)

    def timing(self) -> dict[str, float | int | None]:
        """The loop over these rows, s: how late it began, how long it took; cycles that had no fresh state."""
        rows = self.rows
        fresh = rows[(rows["flags"] & _STALE) == 0]
        busy = fresh["read_s"] + fresh["step_s"] + fresh["write_s"]
        span_s = 1e-9 * float(rows["stamp_ns"][-1] - rows["stamp_ns"][0]) if len(rows) > 1 else 0.0
        return {
            "rows": len(rows),
            "without_state": len(rows) - len(fresh),
            "rate_hz": (len(rows) - 1) / span_s if span_s > 0.0 else None,
            "late_p99_s": _share(fresh["late_s"], 0.99),
            "late_max_s": _share(fresh["late_s"], 1.0),
            "busy_p99_s": _share(busy, 0.99),
            "busy_max_s": _share(busy, 1.0),
        }

    def errors(self) -> dict[str, Any]:
        """Flags seen, the bus's counters, the servos' error bits (by servo), the last thing told as a warning."""
        flags = int(np.bitwise_or.reduce(self.rows["flags"])) if len(self.rows) else 0
        health = self.health
        servos = zip(health.servo_id, health.joint, health.error_bits, strict=True) if health else ()
        return {
            "flags": [flag.name for flag in Flag if flag and int(flag) & flags],
            **{name: int(self.rows[name][-1]) if len(self.rows) else None for name in BUS_COUNTERS},
            "servos": [{"servo_id": number, "joint": joint, "bits": bits} for number, joint, bits in servos if bits],
            "last": self.trouble.text if self.trouble else None,
            "last_utc_ns": self.trouble.utc_ns if self.trouble else None,
        }

    def temperatures(self) -> dict[str, Any]:
        """The hottest servo and the lowest supply; None where no servo tells."""
        health = self.health
        if health is None:
            return {"max_C": None, "joint": None, "servo_id": None, "min_V": None, "grip": None}
        warm = [(t, i) for i, t in enumerate(health.temperature_C) if math.isfinite(t)]
        volts = [v for v in health.voltage_V if math.isfinite(v)]
        hottest = max(warm)[1] if warm else None
        return {
            "max_C": None if hottest is None else health.temperature_C[hottest],
            "joint": None if hottest is None else health.joint[hottest],
            "servo_id": None if hottest is None else health.servo_id[hottest],
            "min_V": min(volts) if volts else None,
            "grip": _grip(health),
        }


def _grip(health: Health) -> dict[str, float | None] | None:
    """The gripper's width and force; None where it says nothing."""
    found = {name.removeprefix("grip_"): getattr(health, name) for name in GRIP}
    if not math.isfinite(found["width_m"]):
        return None
    return {name: x if math.isfinite(x) else None for name, x in found.items()}


def _share(values: NDArray[np.float64], share: float) -> float | None:
    """What this share of the values does not exceed."""
    finite = np.sort(values[np.isfinite(values)])
    return float(finite[math.ceil(share * len(finite)) - 1]) if len(finite) else None


def look(rings: Sequence[Path], rate_hz: float) -> Past | None:
    """The ring of an arm, of one who lives before one who does not; None where there is none that can be read."""
    found = [past for past in (_look(ring, rate_hz) for ring in rings) if past is not None]
    return max(found, key=lambda past: (past.written_by_the_living, past.utc_ns or 0), default=None)


def _look(ring: Path, rate_hz: float) -> Past | None:
    try:
        with RingReader(ring, AGENT_STATE) as reader:
            block = reader.read_last(min(ROWS_MAX, max(2, round(OVER_S * rate_hz))))
            alive, finished = reader.writer_alive, reader.finished
    except RingError:
        return None
    rows = AGENT_STATE.decode(block.payload)
    health, trouble, error = _texts(ring)
    over = finished and not alive
    failed = error if over else None
    return Past(
        alive, rows, health, trouble, ended=over and failed is None, failed=failed.text if failed else None,
        failed_utc_ns=failed.utc_ns if failed else None,
    )  # fmt: skip


def _texts(ring: Path) -> tuple[Health | None, Event | None, Event | None]:
    """The last health, the last warning, and the last error that no end in order followed.

    Who ends in order says so, after what went wrong before; a warning may follow either.  A text that makes no sense is
    left out.
    """
    health, trouble, error = None, None, None
    try:
        reader = TextReader(ring)
    except RingError:
        return None, None, None
    with contextlib.closing(reader):
        for kind, text in reader.read_new():
            with contextlib.suppress(ValueError):
                if kind is Kind.HEALTH:
                    health = Health.from_json(text)
                else:
                    event = Event.from_json(text)
                    trouble = event if event.level >= Level.WARN else trouble
                    if event.level is not Level.WARN:
                        error = event if event.level >= Level.ERROR else None
    return health, trouble, error
