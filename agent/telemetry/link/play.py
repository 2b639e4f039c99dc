"""A log back on the network, at its own pace or another, under keys of its own, so that nobody takes it for live."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import zenoh
from numpy.typing import NDArray

from agent.log.columns import Table
from agent.log.read import ColumnLog, LogError, open_log
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.link.playhead import Order, Playhead
from agent.telemetry.link.session import Network, open_session
from agent.telemetry.link.wire import BATCH_BYTES_MAX, CYCLE_S, BatchHeader, End
from agent.telemetry.row.event import Event
from agent.telemetry.row.topics import PLANT, RECORDER, Address, BadName, Kind

_STRETCH_ROWS: Final = 2048
_LONGER_NS: Final = 1e18  # than any log is: thirty years
SUSPENDED_S: Final = 1.0  # a cycle that took longer was none: whoever was suspended goes on where he was


def _nothing() -> Sequence[Order]:
    return ()


def _silent(_: Playhead) -> None:
    pass


@dataclass(frozen=True)
class PlayOptions:
    """What to play and how."""

    path: Path
    network: Network = field(default_factory=lambda: Network(listen=FREE_PORT))
    speed: float = 1.0
    start_s: float = 0.0  # seconds of the log, counted from its first row
    stop_s: float | None = None
    loop: bool = False
    orders: Callable[[], Sequence[Order]] = _nothing  # what was asked since the last call; asked 30 times a second
    show: Callable[[Playhead], None] = _silent  # told as often where it stands


@dataclass(frozen=True, slots=True)
class PlayReport:
    """What was played."""

    rows: int
    events: int
    loops: int  # times played to the end
    problems: tuple[str, ...]  # what is wrong with the log, and what is not in it


def run(options: PlayOptions, stop: Callable[[], bool], ready: Callable[[str], None] = lambda _: None) -> PlayReport:
    """Play until the end, or `stop`; `ready` gets the endpoint.  Raises LogError, NetworkError."""
    with ExitStack() as stack:
        log = stack.enter_context(open_log(options.path))
        report, tracks = PlayReport(0, 0, 0, tuple(log.remarks)), _tracks(options, log)
        player = _Player(tracks, options)
        opened = stack.enter_context(open_session(options.network))
        publishers = {
            key: stack.enter_context(
                opened.session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
            )
            for key in {track.key for track in tracks}
        }
        ready(opened.endpoint or "")
        while not stop() and not player.head.quit:
            rows, events = player.play_once(publishers, stop)
            finished = all(track.done for track in tracks)
            report = replace(
                report, rows=report.rows + rows, events=report.events + events, loops=report.loops + finished
            )
            if not options.loop:
                break
            player.seek(0.0)
    return report


class _Track:
    """Messages of one key with their times (UTC, ns), and how far they are played."""

    def __init__(
        self, address: Address, times: NDArray[np.int64], payload: Callable[[int, int], bytes], batch_max: int
    ) -> None:
        """`payload(first, behind)`: the messages of those numbers, one after the other."""
        self.key = address.replay_key
        self.is_rows = address.kind is Kind.STATE
        self.times = times
        self._payload = payload
        self._batch_max = batch_max
        self.seek(-math.inf)

    def seek(self, utc_ns: float) -> None:
        """Go on with the first message from that time on; to a listener that is a run of its own."""
        self._source = int.from_bytes(os.urandom(8), "little") | 1
        self._next = int(np.searchsorted(self.times, utc_ns, side="left"))
        self.done = False

    @property
    def next_ns(self) -> int | None:
        """Time of the message that comes next."""
        return int(self.times[self._next]) if self._next < len(self.times) else None

    def play_to(self, utc_ns: float, publisher: zenoh.Publisher) -> int:
        """Publish everything up to that time, then once the end marker; returns the number of messages."""
        begin, end = self._next, int(np.searchsorted(self.times, utc_ns, side="right"))
        while self._next < end:
            until = min(end, self._next + self._batch_max)
            publisher.put(self._payload(self._next, until), attachment=self._header(End.OPEN))
            self._next = until
        if end == len(self.times) and not self.done:
            self.done = True
            publisher.put(b"", attachment=self._header(End.FINISHED))
        return end - begin

    def _header(self, end: End) -> bytes:
        return BatchHeader(self._source, self._next, len(self.times), 0, end).pack()


class _Messages:
    """Rows as they are encoded; a stretch of them is in memory."""

    def __init__(self, rows: Table) -> None:
        self._rows = rows
        self._begin = 0
        self._some = rows[:0].messages()

    def __call__(self, first: int, behind: int) -> bytes:
        if not self._begin <= first <= behind <= self._begin + len(self._some):
            self._begin, self._some = first, self._rows[first : first + max(_STRETCH_ROWS, behind - first)].messages()
        return self._some[first - self._begin : behind - self._begin].tobytes()


def _row_track(address: Address, rows: Table) -> _Track:
    messages = _Messages(rows)
    size = rows[:0].messages().shape[1]
    return _Track(address, np.maximum.accumulate(rows["utc_ns"]), messages, max(1, BATCH_BYTES_MAX // size))


def _event_track(address: Address, events: list[Event], first_ns: int, last_ns: int) -> _Track:
    """Events at their time; what is told before the first row, or after the last one, comes with that."""
    times = np.clip(np.array([event.utc_ns for event in events], np.int64), first_ns, last_ns)
    return _Track(address, times, lambda a, b: b"".join(event.to_json() for event in events[a:b]), 1)


def _tracks(options: PlayOptions, log: ColumnLog) -> list[_Track]:
    """Everything of the log within the wanted seconds.  Raises LogError."""
    members = log.agents | ({PLANT: log.plant} if log.plant is not None else {})
    utc = [rows["utc_ns"] for rows in members.values()]
    times = np.concatenate(utc)
    length_s = float(times.max() - times.min()) / 1e9 if len(times) else 0.0
    stop_s = length_s if options.stop_s in (None, math.inf) else options.stop_s
    last_s = min(stop_s, length_s)
    some = options.start_s < last_s if options.loop else options.start_s <= stop_s  # loops need time
    if not (0 < options.speed < math.inf and len(times) and 0 <= options.start_s <= length_s and some):
        raise LogError(
            f"nothing to play of {options.path}",
            found=f"speed {options.speed:g}, from {options.start_s:g} s to {stop_s:g} s of {length_s:g} s",
            expected="a positive speed, and seconds within the log",
            remedy="correct the options",
        )
    begin_ns, end_ns = int(times.min()), int(times.max())
    first_ns, last_ns = (begin_ns + round(min(s * 1e9, _LONGER_NS)) for s in (options.start_s, stop_s))
    tracks = [
        _row_track(Address(log.cell, member, Kind.STATE), rows[(utc_ns >= first_ns) & (utc_ns <= last_ns)])
        for (member, rows), utc_ns in zip(members.items(), utc, strict=True)
    ]
    before, after = first_ns <= begin_ns, last_ns >= end_ns  # with what was told before the first row, behind the last
    for address, events in _by_source(log.cell, log.events).items():
        some_events = [e for e in events if (before or e.utc_ns >= first_ns) and (after or e.utc_ns <= last_ns)]
        tracks.append(_event_track(address, some_events, begin_ns, end_ns))
    if not any(len(track.times) for track in tracks):
        raise LogError(
            f"nothing to play of {options.path}", found=f"nothing from {options.start_s:g} s to {stop_s:g} s",
            expected="some", remedy="correct the options",
        )  # fmt: skip
    return tracks


def _by_source(cell: str, events: list[Event]) -> Mapping[Address, list[Event]]:
    """Events by the key they came on; a source that cannot be part of a key goes under the recorder's."""
    found: dict[Address, list[Event]] = {}
    for event in events:
        try:
            address = Address(cell, event.source, Kind.EVENT)
        except BadName:
            address = Address(cell, RECORDER, Kind.EVENT)
        found.setdefault(address, []).append(event)
    return found


class _Player:
    """All tracks of a log under one playhead."""

    def __init__(self, tracks: list[_Track], options: PlayOptions) -> None:
        self._tracks, self._options = tracks, options
        times = [int(t) for track in tracks if len(track.times) for t in (track.times[0], track.times[-1])]
        self._begin_ns = min(times, default=0)
        self.head = Playhead((max(times, default=0) - self._begin_ns) / 1e9, options.speed)

    def seek(self, at_s: float) -> None:
        """Go on from there."""
        self.head.at_s = at_s
        for track in self._tracks:
            track.seek(self._begin_ns + round(at_s * 1e9))

    def play_once(self, publishers: Mapping[str, zenoh.Publisher], stop: Callable[[], bool]) -> tuple[int, int]:
        """Play from where it stands to the end; returns rows and events published."""
        before_s, head = time.monotonic(), self.head
        rows = events = 0
        while not stop() and not head.quit and (head.paused or not all(track.done for track in self._tracks)):
            now_s = time.monotonic()
            head.pass_time(min(now_s - before_s, SUSPENDED_S))
            before_s = now_s
            for order in (*self._options.orders(), None):
                if order is not None and head.take(order, self._next_s()):
                    self.seek(head.at_s)
                played = self._publish(publishers)
                rows, events = rows + played[0], events + played[1]
            self._options.show(head)
            time.sleep(CYCLE_S)
        return rows, events

    def _publish(self, publishers: Mapping[str, zenoh.Publisher]) -> tuple[int, int]:
        """Everything up to the playhead; returns rows and events."""
        until_ns = self._begin_ns + round(self.head.at_s * 1e9)
        counts = [(track.is_rows, track.play_to(until_ns, publishers[track.key])) for track in self._tracks]
        return sum(n for is_rows, n in counts if is_rows), sum(n for is_rows, n in counts if not is_rows)

    def _next_s(self) -> float | None:
        """Where the next message is, beginning with what is behind the playhead."""
        coming = [t for track in self._tracks if (t := track.next_ns) is not None]
        return (min(coming) - self._begin_ns) / 1e9 if coming else None
