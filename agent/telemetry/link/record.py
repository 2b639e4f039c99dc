"""The recorder: takes what members publish over Zenoh, checks it, writes it into an MCAP log, says what it has."""

from __future__ import annotations

import json
import platform
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Self

import zenoh
import zenoh.ext

from agent.log.channels import LogChannels
from agent.log.file import MIN_FREE_BYTES, Attachment, LogFile
from agent.log.recover import repair_leftovers
from agent.log.scene import Scene
from agent.telemetry.link.intake import Intake, Rejection
from agent.telemetry.link.session import FREE_PORT, Network, open_session
from agent.telemetry.link.wire import HEADER_BYTES, pack_status
from agent.telemetry.row import topics
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.received import Rows, Text

INBOX_BYTES_MAX: Final = 256 << 20
BATCH_BYTES_MAX: Final = 1 << 18
_WAIT_S: Final = 0.02
_DRAIN_MAX: Final = 64  # batches between two looks at the clock
_STATUS_S: Final = 0.005  # the status is made anew at most this often


@dataclass(frozen=True)
class RecordOptions:
    """One log."""

    path: Path
    scene: Scene  # the cell's name and its arms
    config_id: int  # rows of another configuration do not belong in this log
    has_plant: bool = False
    network: Network = field(default_factory=lambda: Network(listen=FREE_PORT))
    attachments: tuple[Attachment, ...] = ()
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    min_free_bytes: int = MIN_FREE_BYTES
    repair: bool = True  # first mend what an earlier recorder left unfinished in the same folder


@dataclass(frozen=True, slots=True)
class RecordReport:
    """What is in the log."""

    path: Path
    complete: bool
    failure: str | None  # why the file ended before its time
    completeness: Mapping[str, str]
    repaired: tuple[Path, ...]
    not_repaired: tuple[str, ...]  # errors, for a person


def run(
    options: RecordOptions, stop: Callable[[], bool], ready: Callable[[str], None] = lambda _: None
) -> RecordReport:
    """Record until `stop`; `ready` gets the endpoint to publish to.

    Everything that can be refused is refused before the first message: raises LogFileError, NetworkError, BadName.
    """
    topics.check_name(options.scene.cell, "cell")
    for arm in options.scene.arms:
        topics.check_arm_name(arm.name)
    created_ns = time.time_ns()
    with open_session(options.network) as opened:
        metadata = {"recorder": _about_recorder(options, opened.endpoint), **options.metadata}
        log = LogFile(
            options.path, options.attachments, metadata, created_ns=created_ns, min_free_bytes=options.min_free_bytes
        )
        recorder = _Recorder(options, log)
        try:
            with recorder.listen(opened.session):
                ready(opened.endpoint or "")
                with _Repair(options) as repair:
                    while not stop():
                        recorder.step(_WAIT_S)
            recorder.drain()
        finally:
            completeness = recorder.finish()
    return RecordReport(
        path=options.path,
        complete=log.failure is None and completeness["complete"] == "true",
        failure=log.failure,
        completeness=completeness,
        repaired=repair.repaired,
        not_repaired=repair.failed,
    )


class _Repair:
    """Mends, beside the recording, what earlier recorders left in the folder; given up when recording ends."""

    def __init__(self, options: RecordOptions) -> None:
        self.repaired: tuple[Path, ...] = ()
        self.failed: tuple[str, ...] = ()
        self._options = options
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log-repair", daemon=True)

    def __enter__(self) -> Self:
        if self._options.repair:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._options.repair:
            self._thread.join()

    def _run(self) -> None:
        path = self._options.path
        self.repaired, self.failed = repair_leftovers(path.parent, but=path, stop=self._stop.is_set)


class _Inbox:
    """Between Zenoh's threads and the recorder's: bounded, and putting in never waits."""

    def __init__(self, keys: frozenset[str]) -> None:
        self._keys = keys
        # Not SimpleQueue: a signal that comes as its timeout ends makes it wait for ever (CPython 3.11, measured here).
        self._queue: queue.Queue[tuple[str, bytes, bytes]] = queue.Queue()
        self._lock = threading.Lock()
        self._bytes = 0
        self.rejected: Counter[Rejection] = Counter()
        self.overflowed = 0

    def put(self, sample: zenoh.Sample) -> None:
        """Runs in a thread of Zenoh's: look at the envelope, keep or count."""
        key, size, attachment = str(sample.key_expr), len(sample.payload), sample.attachment
        why = None
        if key not in self._keys:
            why = Rejection.UNKNOWN_KEY
        elif attachment is None or len(attachment) != HEADER_BYTES:
            why = Rejection.NO_HEADER
        elif size > BATCH_BYTES_MAX:
            why = Rejection.TOO_LARGE
        with self._lock:
            if why is not None:
                self.rejected[why] += 1
                return
            if self._bytes + size > INBOX_BYTES_MAX:
                self.overflowed += 1  # not acknowledged, so its publisher sends it again
                return
            self._bytes += size
        assert attachment is not None
        self._queue.put((key, sample.payload.to_bytes(), attachment.to_bytes()))

    def get(self, timeout_s: float) -> tuple[str, bytes, bytes] | None:
        try:
            item = self._queue.get(timeout=timeout_s) if timeout_s > 0 else self._queue.get_nowait()
        except queue.Empty:
            return None
        with self._lock:
            self._bytes -= len(item[1])
        return item


class _Recorder:
    """Inbox -> intake -> file."""

    def __init__(self, options: RecordOptions, log: LogFile) -> None:
        self._cell = options.scene.cell
        self._log = log
        joints = {arm: len(names) for arm, names in options.scene.joints.items()}
        self._intake = Intake(self._cell, joints, has_plant=options.has_plant, config_id=options.config_id)
        self._inbox = _Inbox(frozenset(self._intake.streams))
        self._channels = LogChannels(log, options.scene, has_plant=options.has_plant)
        self._zenoh_missed = 0
        self._told: set[str] = set()
        self._completeness: dict[str, str] | None = None
        self._status_s = 0.0
        self._taken = False  # anything since the status was made
        self._cause = ""
        self._refresh_status()

    def listen(self, session: zenoh.Session) -> _Listening:
        """Subscribe and answer; ends with the `with` block."""
        return _Listening(session, self._cell, self._inbox, lambda: self._status, self._count_missed)

    def step(self, timeout_s: float) -> None:
        """Wait for a message, take what is there, flush when it is time."""
        item = self._inbox.get(timeout_s)
        for _ in range(_DRAIN_MAX):
            if item is None:
                break
            self._take(*item)
            item = self._inbox.get(0.0)
        if item is not None:
            self._take(*item)
        now_s = time.monotonic()
        self._log.tick(now_s)
        if self._log.nearly_full and self._completeness is None:
            self._say(Level.ERROR, "disk nearly full: the log ends here", {})
            self.finish()
        cause = self._log.failure or ("disk nearly full" if self._log.nearly_full else "")
        if (self._taken or cause != self._cause) and now_s - self._status_s >= _STATUS_S:
            self._status_s, self._cause, self._taken = now_s, cause, False
            self._refresh_status()

    def drain(self) -> None:
        """Take what is still in the inbox."""
        while (item := self._inbox.get(0.0)) is not None:
            self._take(*item)

    def finish(self) -> Mapping[str, str]:
        """End the file; returns its last metadata record.  Safe twice: the first time counts."""
        if self._completeness is None:
            self._completeness = self._make_completeness()
            if not self._log.finish({"completeness": self._completeness}):
                self._completeness = self._make_completeness()
        return self._completeness

    def _make_completeness(self) -> dict[str, str]:
        self._intake.rejected.update(self._inbox.rejected)
        self._inbox.rejected.clear()
        return self._intake.completeness(self._channels.rows_lost()) | {
            "inbox_overflows": str(self._inbox.overflowed),
            "zenoh_missed_batches": str(self._zenoh_missed),
        }

    def _take(self, key: str, payload: bytes, attachment: bytes) -> None:
        self._taken = True
        before = self._intake.rejected[Rejection.ANOTHER_RUN]
        for item in self._intake.take(key, payload, attachment):
            if isinstance(item, Rows):
                self._channels.write_rows(item)
            elif isinstance(item, Text):
                self._channels.write_text(item)
        if self._intake.rejected[Rejection.ANOTHER_RUN] != before:
            self._say(Level.WARN, f"{key}: started again; one log holds one run, start a new recording", {"key": key})

    def _say(self, level: Level, text: str, data: Mapping[str, Any]) -> None:
        """An event of the recorder's own, once."""
        if text not in self._told:
            self._told.add(text)
            self._channels.write_own(Event(time.time_ns(), topics.RECORDER, level, text, data))

    def _count_missed(self, miss: zenoh.ext.Miss) -> None:
        self._zenoh_missed += miss.nb

    def _refresh_status(self) -> None:
        streams = {key: stream.status for key, stream in self._intake.streams.items()}
        self._status = pack_status(not self._cause, self._cause, streams)


class _Listening:
    """Subscriber and queryable of a recorder, for the time of a `with` block."""

    def __init__(
        self, session: zenoh.Session, cell: str, inbox: _Inbox, status: Callable[[], bytes],
        missed: Callable[[zenoh.ext.Miss], None],
    ) -> None:  # fmt: skip
        key = topics.status_key(cell)
        self._queryable = session.declare_queryable(key, lambda query: query.reply(key, status()))
        self._subscriber = zenoh.ext.declare_advanced_subscriber(
            session,
            topics.cell_keys(cell),
            inbox.put,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
            recovery=zenoh.ext.RecoveryConfig(heartbeat=True),  # type: ignore[call-arg]
        )
        self._listener = self._subscriber.sample_miss_listener(missed)

    def __enter__(self) -> _Listening:
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.undeclare()  # type: ignore[no-untyped-call]
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._queryable.undeclare()  # type: ignore[no-untyped-call]


def _about_recorder(options: RecordOptions, endpoint: str | None) -> dict[str, str]:
    packages = ("widowx-coop", "eclipse-zenoh", "mcap", "numpy")
    return {
        "cell": options.scene.cell,
        "config_id": str(options.config_id),
        "arms": json.dumps({arm: list(joints) for arm, joints in options.scene.joints.items()}),
        "plant": str(options.has_plant).lower(),
        "endpoint": endpoint or str(options.network.config_file),
        "host": platform.node(),
        "started_utc_ns": str(time.time_ns()),
        "python": platform.python_version(),
    } | {package: version(package) for package in packages}
