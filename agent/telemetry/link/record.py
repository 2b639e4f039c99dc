"""The recorder: takes what members publish over Zenoh, checks it, writes it into an MCAP log, says what it has."""

from __future__ import annotations

import json
import platform
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import zenoh
import zenoh.ext

from agent.log.channels import LogChannels
from agent.log.file import MIN_FREE_BYTES, Attachment, LogFile, LogFileError
from agent.log.parts import Limits, make_room, next_path
from agent.log.recover import RecoverReport
from agent.log.scene import Scene
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.link.inbox import Inbox, Listening
from agent.telemetry.link.intake import STRANGE, Intake, Rejection
from agent.telemetry.link.repair import Repair
from agent.telemetry.link.session import Network, open_session
from agent.telemetry.link.stream import Stream
from agent.telemetry.link.wire import End, StreamStatus, pack_status, seal_of
from agent.telemetry.row import topics
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.received import Rows, Text

_WAIT_S: Final = 0.05
_DRAIN_MAX: Final = 64  # batches between two looks at the clock
_STATUS_S: Final = 0.005  # the status is made anew at most this often
_LEFT_OUT_S: Final = 1.0  # what was left out is told at most this often
_BUDGET_S: Final = 10.0  # between two looks at what the folder's logs take
LOGS_MAX: Final = 10_000  # in one recording


def _tell_nobody(*_: object) -> None:
    """Where nobody asks."""


@dataclass(frozen=True)
class RecordOptions:
    """One recording: one log, or several one after the other."""

    path: Path  # of the first log
    scene: Scene  # the cell's name and its arms
    config_id: int  # rows of another configuration do not belong in this log
    fingerprint: str = ""  # of the cell's files: messages of who has other files do not count
    has_plant: bool = False
    network: Network = field(default_factory=lambda: Network(listen=FREE_PORT))
    attachments: tuple[Attachment, ...] = ()
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    min_free_bytes: int = MIN_FREE_BYTES
    limits: Limits = field(default_factory=Limits)
    repair: bool = True  # first mend what an earlier recorder left unfinished in the same folder
    left_out: Callable[[Mapping[str, int]], None] = _tell_nobody  # is told what did not belong here, by reason
    ended: Callable[[Path, str], None] = _tell_nobody  # is told of a log that ends before its time, at once, and why


@dataclass(frozen=True, slots=True)
class RecordReport:
    """What is in the log."""

    path: Path
    complete: bool  # of all logs together: a row that came late is in a later one than its stretch
    failure: str | None  # why the file ended before its time
    completeness: Mapping[str, str]  # of the last log
    repaired: tuple[RecoverReport, ...]
    not_repaired: tuple[str, ...]  # errors, for a person
    logs: tuple[Path, ...]  # `path` and those behind it


def run(
    options: RecordOptions, stop: Callable[[], bool], ready: Callable[[str], None] = lambda _: None
) -> RecordReport:
    """Record until `stop`; `ready` gets the endpoint to publish to.

    Everything that can be refused is refused before the first message: raises LogFileError, NetworkError, BadName.
    """
    topics.check_name(options.scene.cell, "cell")
    for arm in options.scene.arms:
        topics.check_arm_name(arm.name)
    with open_session(replace(options.network, passes_on=True)) as opened:
        recorder = _Recorder(options, _about_recorder(options, opened.endpoint))
        try:
            with recorder.listen(opened.session):
                ready(opened.endpoint or "")
                with Repair(options.path, wanted=options.repair) as repair:
                    while not stop():
                        recorder.step(_WAIT_S)
            recorder.drain()
        finally:
            completeness = recorder.finish()
    return RecordReport(
        path=options.path,
        complete=recorder.failure is None and recorder.whole,
        failure=recorder.failure,
        completeness=completeness,
        repaired=repair.repaired,
        not_repaired=repair.failed,
        logs=tuple(recorder.logs),
    )


class _Recorder:
    """Inbox -> intake -> file, and the next file when it is time."""

    def __init__(self, options: RecordOptions, about: Mapping[str, str]) -> None:
        self._options = options
        self._about = about
        self._cell = options.scene.cell
        joints = {arm: len(names) for arm, names in options.scene.joints.items()}
        self._intake = Intake(
            self._cell, joints, has_plant=options.has_plant, config_id=options.config_id,
            fingerprint=options.fingerprint,
        )  # fmt: skip
        self._seal = seal_of(self._cell, options.fingerprint, topics.RECORDER)
        self._inbox = Inbox(frozenset(self._intake.streams))
        self._zenoh_missed, self._told = 0, set[str]()
        self._left_out: Counter[Rejection] = Counter()  # of the logs before
        self._left_out_told: Mapping[str, int] = {}
        self._left_out_s = 0.0
        self.failure: str | None = None
        self.logs, self._budget_s = list[Path](), time.monotonic()
        self._open(options.path)
        self._completeness: dict[str, str] | None = None
        self._status_s, self._cause, self._taken = 0.0, "", False  # taken: anything since the status was made
        self._kept: dict[str, StreamStatus] | None = None  # what is in the log, once it has ended before its time
        self._to_write = False  # of a stream that has ended: its publisher goes once it is told that all is here
        self._refresh_status()

    def listen(self, session: zenoh.Session) -> Listening:
        """Subscribe and answer; ends with the `with` block."""
        return Listening(session, self._cell, self._inbox, lambda: self._status, self._count_missed)

    def step(self, timeout_s: float) -> None:
        """Take what has come when the time is over, or before when it is much; flush when it is time."""
        for message in self._inbox.take(_DRAIN_MAX, timeout_s):
            self._take(*message)
        now_s = time.monotonic()
        if self._to_write:
            self._to_write = False
            self._log.flush(now_s)
        self._log.tick(now_s)
        self._tell_of_strangers(now_s)
        if now_s - self._budget_s >= _BUDGET_S:
            self._make_room(now_s)
        if self._log.nearly_full and self._completeness is None:
            self.failure = "disk nearly full"
            self._say(Level.ERROR, "disk nearly full: the log ends here", {})
            self.finish()
        cause = self.failure or self._log.failure or ""
        if cause and self._kept is None:
            lost = None if self._log.removed else self._channels.rows_lost()
            self._kept = {key: _kept(stream, lost) for key, stream in self._intake.streams.items()}
            self._options.ended(self.logs[-1], cause)
        if (self._taken or cause != self._cause) and now_s - self._status_s >= _STATUS_S:
            self._status_s, self._cause, self._taken = now_s, cause, False
            self._refresh_status()

    def drain(self) -> None:
        """Take what is still in the inbox."""
        while messages := self._inbox.take(_DRAIN_MAX):
            for message in messages:
                self._take(*message)

    @property
    def whole(self) -> bool:
        return self._intake.whole

    def finish(self) -> Mapping[str, str]:
        """End the last file; returns its last metadata record.  Safe twice: the first time counts."""
        if self._completeness is None:
            self._completeness = self._close(continued=False)
        return self._completeness

    def _open(self, path: Path) -> None:
        """Begin a log.  Raises LogFileError."""
        options = self._options
        previous = {"previous": self.logs[-1].name} if self.logs else {}
        about = {**self._about, **previous, "part": str(len(self.logs) + 1), "started_utc_ns": str(time.time_ns())}
        self._log = LogFile(
            path, options.attachments, {"recorder": about, **options.metadata},
            created_ns=time.time_ns(), min_free_bytes=options.min_free_bytes,
        )  # fmt: skip
        self._channels = LogChannels(self._log, options.scene, has_plant=options.has_plant)
        self._opened_s = time.monotonic()
        self.logs.append(path)

    def _close(self, *, continued: bool) -> dict[str, str]:
        completeness = self._make_completeness(continued)
        if not self._log.finish({"completeness": completeness}):
            completeness = self._make_completeness(continued)
        self.failure = self.failure or self._log.failure
        return completeness

    def _next(self, why: str) -> None:
        """End this log and go on in the next one; when there can be none, the recording ends here."""
        if self._completeness is not None or self._log.failure is not None:
            return
        path = next_path(self._options.path)
        self._say(Level.INFO, f"goes on in {path.name}: {why}", {})
        completeness = self._close(continued=True)
        self._left_out.update(self._intake.rejected)
        self._intake.begin_log()
        self._told.clear()
        try:
            self._open(path)
        except LogFileError as error:
            self.failure, self._completeness = str(error), completeness
        self._make_room(time.monotonic())

    def _has_rows(self) -> bool:
        return any(s.here for s in self._intake.streams.values() if s.address.kind is topics.Kind.STATE)

    def _make_room(self, now_s: float) -> None:
        """Remove the oldest logs of the folder when they take more than they may; says which."""
        self._budget_s, limit = now_s, self._options.limits.folder_bytes
        if limit is not None and self._completeness is None:
            for path in make_room(self._options.path.parent, limit):
                self._say(Level.WARN, f"removed {path.name}: the logs here may take {limit >> 20} MB", {})

    def _make_completeness(self, continued: bool) -> dict[str, str]:
        self._intake.also_refused(*self._inbox.take_refused())
        return self._intake.completeness(self._channels.rows_lost(), continued=continued) | {
            "inbox_overflows": str(self._inbox.overflowed),
            "zenoh_missed_batches": str(self._zenoh_missed),
        }

    def _take(self, key: str, payload: bytes, attachment: bytes) -> None:
        self._taken = True
        stream = self._intake.streams.get(key)
        age_s = time.monotonic() - self._opened_s
        if payload and self._options.limits.reached(self._log.size, age_s) and self._has_rows():
            self._next("it reached its limit")  # not before there is something to go on with
        items = self._intake.take(key, payload, attachment, time.monotonic())
        if self._intake.another_run and len(self.logs) < LOGS_MAX:
            self._next(f"{key} started again")
            items = self._intake.take(key, payload, attachment, time.monotonic())  # nothing when there can be no other
        self._to_write |= stream is not None and stream.end is not End.OPEN
        for item in items:
            if isinstance(item, Rows):
                self._channels.write_rows(item)
            elif isinstance(item, Text):
                self._channels.write_text(item)

    def _say(self, level: Level, text: str, data: Mapping[str, Any]) -> None:
        """An event of the recorder's own, once."""
        if text not in self._told:
            self._told.add(text)
            self._channels.write_own(Event(time.time_ns(), topics.RECORDER, level, text, data))

    def _tell_of_strangers(self, now_s: float) -> None:
        """Once in a log and for each reason; how many there were is told beside it, and in the log at its end."""
        here = self._intake.rejected + self._inbox.rejected()
        for why in STRANGE & here.keys():
            self._say(Level.WARN, f"left out what does not belong here: {why.value}", {"reason": why.value})
        for member in sorted(self._intake.told_twice):
            self._say(Level.WARN, f"two telemetry processes tell of one run, both are heard: stop one of {member}", {})
        if now_s - self._left_out_s >= _LEFT_OUT_S:
            self._left_out_s = now_s
            every = self._left_out + here
            counts = {why.value: every[why] for why in sorted(STRANGE & every.keys(), key=lambda why: why.value)}
            if counts != self._left_out_told:
                self._left_out_told = counts
                self._options.left_out(counts)

    def _count_missed(self, miss: zenoh.ext.Miss) -> None:
        self._zenoh_missed += miss.nb

    def _refresh_status(self) -> None:
        streams = self._kept
        if streams is None:
            streams = {key: stream.status for key, stream in self._intake.streams.items()}
        self._status = pack_status(not self._cause, self._cause, streams, self._seal)


def _kept(stream: Stream, lost: Mapping[str, int] | None) -> StreamStatus:
    """What of it is in a log that has ended before its time; lost: rows by member, None: all.  Texts are not told."""
    if lost is not None and stream.address.kind is topics.Kind.STATE:
        return stream.kept(lost.get(stream.address.member, 0))
    return StreamStatus(stream.source, (), ended=False)


def _about_recorder(options: RecordOptions, endpoint: str | None) -> dict[str, str]:
    packages = ("widowx-coop", "eclipse-zenoh", "mcap", "numpy")
    return {
        "cell": options.scene.cell,
        "config_id": str(options.config_id),
        "arms": json.dumps({arm: list(joints) for arm, joints in options.scene.joints.items()}),
        "plant": str(options.has_plant).lower(),
        "endpoint": endpoint or str(options.network.config_file),
        "host": platform.node(),
        "python": platform.python_version(),
    } | {package: version(package) for package in packages}
