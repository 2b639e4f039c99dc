"""The telemetry process of one arm or of the plant: reads a ring, publishes over Zenoh, until the recorder has it all.

Congestion control, measured on loopback: with DROP and no waiting a 12 s stall of the recorder cost no row at 25
batches/s (recovered from the cache) and `put` never took longer than 1.4 ms; but a burst of 4000 batches lost 3800 of
them.  With BLOCK nothing was lost at 390 000 rows/s, and a stalled recorder blocks `put` until the link is closed.  So
real time drops and recovers, lockstep blocks, and in both the recorder's own status decides what is sent again.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Final

import numpy as np
import zenoh
import zenoh.ext

from agent.telemetry.link.cut import CutWatch
from agent.telemetry.link.patience import Patience
from agent.telemetry.link.publication import Pace, PublishOptions, PublishReport
from agent.telemetry.link.rings import open_texts, wait_for_ring
from agent.telemetry.link.sender import LockstepPauses, Sender
from agent.telemetry.link.session import has_link, open_session
from agent.telemetry.link.source import HEALTH_KEPT, RowSource, TextSource
from agent.telemetry.link.status import StatusQuery
from agent.telemetry.link.wire import (
    BATCH_BYTES_MAX,
    CYCLE_S,
    LOCKSTEP_BATCH_BYTES_MAX,
    End,
    RecorderStatus,
    Sent,
    seal_of,
)
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextReader
from agent.telemetry.row.derive import RowEvents
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import RECORDER, Address, Kind

_BURST_PAUSE_S: Final = 0.005  # in real time, between the bursts that catch up
_BURST: Final = {False: 2, True: 64}  # by lockstep: batches between two looks at the stop flag
_STATUS_S: Final = {False: 0.25, True: 0.0}  # in lockstep in every cycle
_LINGER_S: Final = 10.0  # for a recorder that is there and says nothing
_WINDOW_ROWS: Final = 4096  # lockstep: rows on their way at most
_CACHE_BATCHES: Final = {False: 600, True: 4}  # 20 s in real time; in lockstep the ring keeps what is not acknowledged


def run(
    options: PublishOptions,
    stop: Callable[[], bool],
    ready: Callable[[str], None] = lambda _: None,
    say: Callable[[str], None] = lambda _: None,
) -> PublishReport:
    """Publish until the recorder has everything, or `stop`.  `ready` gets the member's name once the session is open.

    Waits for the ring to appear, and for a recorder; `say` is told in words once that lasts.
    Raises RingError, NetworkError, BadName.
    """
    address = Address(options.cell, options.member, Kind.STATE)
    since_ns = time.time_ns()
    with open_session(options.network) as opened:
        ready(options.member)
        report = PublishReport(0, 0, 0, End.OPEN)
        while (reader := wait_for_ring(options, since_ns, stop, say)) is not None:
            with reader:
                with ExitStack() as stack:  # closed with the ring: its cache must not reach the next run's recorder
                    report = _Telemetry(options, address, opened.session, reader, stack).run(stop, say)
                if not options.follow:
                    break
                while not stop() and not reader.replaced:
                    time.sleep(CYCLE_S)
        return report


class _Telemetry:
    """One ring on one session."""

    def __init__(
        self, options: PublishOptions, address: Address, session: zenoh.Session, reader: RingReader, stack: ExitStack
    ) -> None:
        self._options = options
        self._address = address
        self._session = session
        self._reader = reader
        self._lockstep = options.pace is Pace.LOCKSTEP
        self._derive = RowEvents(options.member) if options.layout == AGENT_STATE else None
        self._stack = stack
        self._texts: TextReader | None = None
        text_id = int.from_bytes(os.urandom(8), "little") | 1
        self._outbox = {Kind.EVENT: TextSource(text_id), Kind.HEALTH: TextSource(text_id, HEALTH_KEPT)}
        batch_bytes = LOCKSTEP_BATCH_BYTES_MAX if self._lockstep else BATCH_BYTES_MAX
        self._senders = {
            Kind.STATE: Sender(RowSource(reader, batch_bytes), window=_WINDOW_ROWS if self._lockstep else None),
            Kind.EVENT: Sender(self._outbox[Kind.EVENT], window=None),
            Kind.HEALTH: Sender(self._outbox[Kind.HEALTH], window=None),
        }
        self._publishers = {
            kind: stack.enter_context(_publisher(session, self._address_of(kind), self._lockstep))
            for kind in self._senders
        }
        self._dtype = options.layout.dtype
        self._last_row: np.void | None = None
        info = self._address_of(Kind.INFO).key
        stack.enter_context(session.declare_queryable(info, lambda query: query.reply(info, self._info())))
        seal = seal_of(options.cell, options.fingerprint, RECORDER)
        self._status = StatusQuery(session, options.cell, seal, _STATUS_S[self._lockstep])
        own = seal_of(options.cell, options.fingerprint, options.member, options.layout)
        self._sent = Sent(own, reader.header.ring_id)
        self._ended_s = 0.0
        self._cut = CutWatch(lambda: has_link(session))
        self._heard = False  # a recorder has said what it has
        self._unheard_why = ""  # why the recorder that is there records nothing
        self._cut_told = False
        self._say: Callable[[str], None] = lambda _: None
        self._pauses = LockstepPauses(_BURST[True])

    def run(self, stop: Callable[[], bool], say: Callable[[str], None]) -> PublishReport:
        self._say = say
        lonely = Patience(lambda: say(self._without_recorder()))
        while True:
            sent = self._cycle(time.monotonic())
            lonely.waiting(not self._heard)
            if all(sender.complete for sender in self._senders.values()) or stop() or self._is_over():
                return self._report()
            if self._unheard_why and all(sender.ended for sender in self._senders.values()):
                return self._report()
            if self._lockstep:
                time.sleep(self._pauses.after(sent, self._senders[Kind.STATE]))
            else:
                time.sleep(CYCLE_S if sent < 2 else _BURST_PAUSE_S)

    def _without_recorder(self) -> str:
        network = self._options.network
        where = " ".join(network.connect) or f"the endpoints of {network.config_file} (do certificates last?)"
        kept = "simulated time waits too" if self._lockstep else "the ring keeps the newest rows meanwhile"
        return f"no recorder at {where} has answered; waits for one until it is stopped (`coop record`); {kept}"

    def _is_over(self) -> bool:
        """Whether to let go of a ring that has ended: a recorder that comes now is there for the next run."""
        if not self._options.follow or not self._senders[Kind.STATE].ended:
            return False
        self._ended_s = self._ended_s or time.monotonic()
        return not has_link(self._session) or time.monotonic() - self._ended_s > _LINGER_S

    def _cycle(self, now_s: float) -> int:
        """Publish what is new, ask what arrived, publish again what did not; return the number of batches."""
        burst = _BURST[self._lockstep]
        rows = self._senders[Kind.STATE]
        sent = 0
        for header, payload in rows.new(burst, now_s):
            self._publishers[Kind.STATE].put(payload, attachment=header.pack(self._sent, payload))
            self._watch(payload)
            sent += 1
        self._tell_of_cuts(now_s)
        self._tell_of_a_cut_ring()
        self._collect_texts(ended=rows.ended and not self._cut.away)
        for kind, sender in self._senders.items():
            if kind is not Kind.STATE:
                for header, payload in sender.new(burst, now_s):
                    self._publishers[kind].put(payload, attachment=header.pack(self._sent, payload))
        sent += self._send_again(now_s)
        if self._lockstep:
            self._reader.acknowledge(rows.acknowledged)
        return sent

    def _watch(self, payload: bytes) -> None:
        if not payload:
            return
        rows = np.frombuffer(payload, self._dtype)
        self._last_row = rows[-1]
        for event in self._derive.watch(rows) if self._derive else ():
            self._outbox[Kind.EVENT].append(event.to_json())

    def _tell_of_cuts(self, now_s: float) -> None:
        if (away_s := self._cut.ended(now_s)) is not None and self._outbox[Kind.EVENT].end is End.OPEN:
            text = f"link to the recorder was cut for {away_s:.1f} s"
            event = Event(time.time_ns(), self._options.member, Level.WARN, text, {"cut_s": round(away_s, 1)})
            self._outbox[Kind.EVENT].append(event.to_json())

    def _tell_of_a_cut_ring(self) -> None:
        left = "" if self._cut_told else self._reader.cut
        if left:
            self._cut_told = True
            text = f"the ring was cut to {left}: rows are lost"
            self._say(text)
            if self._outbox[Kind.EVENT].end is End.OPEN:
                event = Event(time.time_ns(), self._options.member, Level.ERROR, text, {})
                self._outbox[Kind.EVENT].append(event.to_json())

    def _collect_texts(self, *, ended: bool) -> None:
        if self._texts is None:
            self._texts = open_texts(self._options.ring, self._reader.header.pid, self._stack)
        for kind, text in self._texts.read_new() if self._texts else ():
            self._outbox[kind].append(text)
        if ended:
            for box in self._outbox.values():
                box.end = End.FINISHED

    def _send_again(self, now_s: float) -> int:
        status, sent = self._status.poll(now_s), 0
        if status is not None:
            self._hear(status, now_s)
        for kind, sender in self._senders.items():
            if self._heard and not self._unheard_why:
                for header, payload in sender.again(_BURST[self._lockstep], now_s):
                    self._publishers[kind].put(payload, attachment=header.pack(self._sent, payload))
                    sent += 1
        return sent

    def _hear(self, status: RecorderStatus, now_s: float) -> None:
        """Take note of what the recorder has; one whose log has ended takes nothing more, and is not waited for."""
        self._heard = True
        why = "" if status.recording else status.cause or "no log"
        if why and why != self._unheard_why:
            self._say(f"the recorder's log has ended: {why}; another recorder gets what the ring still holds then")
        self._unheard_why = why
        for kind, sender in self._senders.items():
            sender.on_status(status.streams.get(self._address_of(kind).key), now_s)
            if why and self._lockstep:
                sender.go_on_alone()

    def _address_of(self, kind: Kind) -> Address:
        return Address(self._options.cell, self._options.member, kind)

    def _info(self) -> bytes:
        rows = self._senders[Kind.STATE]
        ring = {"id": self._reader.header.ring_id, "pid": self._reader.header.pid, "written": self._reader.written}
        row = self._last_row
        last = {} if row is None else {name: int(row[name]) for name in ("sequence", "utc_ns", "config_id")}
        live = {"ring": ring | {"lost": rows.lost, "published": rows.published}, "last_row": last}
        return json.dumps({"member": self._options.member, **self._options.info, **live}, default=str).encode()

    def _report(self) -> PublishReport:
        rows = self._senders[Kind.STATE]
        return PublishReport(
            self._reader.written,
            rows.lost,
            rows.unrecorded(),
            RowSource(self._reader).end,
            self._unheard_why,
            self._reader.cut,
        )


def _publisher(session: zenoh.Session, address: Address, lockstep: bool) -> zenoh.ext.AdvancedPublisher:
    return zenoh.ext.declare_advanced_publisher(
        session,
        address.key,
        encoding=zenoh.Encoding.APPLICATION_CDR if address.kind is Kind.STATE else zenoh.Encoding.APPLICATION_JSON,
        congestion_control=zenoh.CongestionControl.BLOCK if lockstep else zenoh.CongestionControl.DROP,
        cache=zenoh.ext.CacheConfig(max_samples=_CACHE_BATCHES[lockstep]),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=0.5),  # type: ignore[call-arg]
        publisher_detection=True,
    )
