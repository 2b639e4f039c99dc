"""The operator as the loop of one arm sees them: events, the common start, and what the agent answers about itself.

Where nothing can fall (simulation), a stop also releases the object; on real arms, and in a session, a stop holds it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Protocol

from agent.host.clock import bound_text
from agent.host.signals import StopFlag
from agent.modes import Event, Mode
from agent.operator.message import Request
from agent.operator.socket import ControlSocket, Standing
from agent.operator.table import EVENT_OF
from agent.process.clocked import ClockWatch
from agent.session import way_back
from agent.session_modes import next_in_session
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Level
from drivers.clock import utc_offset_ns
from drivers.interface import Clock

MOTIONS = Event.APPROACH | Event.GRASP | Event.LOWER | Event.PARK  # words that begin one
IN_LOCKSTEP = {
    "found": "an agent in lockstep", "expected": "one at the wall clock's pace",
    "remedy": "it starts by itself; for a start of your own give plant and agents --real-time",
}  # fmt: skip
NO_REAL_TIME_REMEDY = "give --priority 80 (the shipped unit does), or --allow-no-realtime to accept late torques"


class Tell(Protocol):
    """Writes an event of the agent."""

    def __call__(self, level: Level, text: str, **data: float | str) -> None:
        """Something happened now."""
        ...


class Operator:
    """Requests of an operator, by signal or over the control socket."""

    def __init__(
        self,
        stop: StopFlag,
        control: ControlSocket | None,
        clock: Clock,
        tell: Tell,
        *,
        drops_on_stop: bool,
        watch: Callable[[], str] = lambda: "",
        session: bool = False,
        standing: Standing | None = None,
    ) -> None:
        """session: a stop holds, whatever drops_on_stop says, and is said once: the arm goes on from it by words.

        standing: what is answered about the arm, also where there is no control socket yet.
        """
        self._signals = stop
        self._control = control
        self._clock = clock
        self._tell = tell
        self.drops_on_stop = drops_on_stop and not session  # in HOLD a session's release ends nothing
        self._watch = watch  # what else of this host is wrong, because of which the arm must hold now
        self.watched = ""  # what that said in the last cycle
        self._session = session
        self._stopped = False
        self._signals_heard, self._signal = 0, ""  # of stops; which was the last, since the mode changed
        self._stops_said = 0  # in a session: signals, and holds of this host
        self._arranged = ""  # why the arm holds by a stop that was arranged before
        self._trouble, self._holds = "", 0  # of this host: why the arm holds since the last start, and how often it did
        self._start: Request | None = None
        self._start_ns: int | None = None
        self._lower: Request | None = None
        self._lower_ns = 0
        self.clock: ClockWatch | None = None  # where arms of the cell are on other hosts
        self._standing = standing or (control.standing if control is not None else Standing(""))

    @property
    def is_deaf(self) -> bool:
        """Whether nobody's words are heard, only signals."""
        return self._control is None

    def listen(self, control: ControlSocket) -> None:
        """From here on words are heard."""
        self._control = control

    @property
    def start(self) -> Request | None:
        """The start that counts now."""
        return self._start

    def is_pressed(self) -> bool:
        """Whether somebody asks for something that no cycle has acted on: then the loop waits for nobody else."""
        signals, control = self._signals, self._control
        if control is not None:
            control.poll()
        said = signals.released or signals.stops + self._holds != self._stops_said
        said = said or (control is not None and bool(control.requests.words))
        return said or (self.drops_on_stop and (self._stopped or signals.stopped))

    def events(self) -> Event:
        """What is asked for now.  A release counts once: one that came too early must not drop a later hold."""
        released = self._signals.released
        self._signals.released = False
        happened = Event.NONE if self._control is None else self._said(self._control)
        watched = self.watched = self._watch()
        if not (happened or released or watched or self._stopped or self._signals.stopped):
            return happened  # of nearly every cycle; what follows takes 5 µs
        self._hear_signals()
        asked = Event.STOP in happened and not self._session
        self._stopped = self._stopped or asked or self._signals.stopped
        released = released or Event.RELEASED in happened
        happened &= ~Event.RELEASED
        if watched:
            happened |= Event.TROUBLE
        new = Event.STOP in happened or self._signals.stops + self._holds != self._stops_said
        if self._stopped and self._says_stop():
            happened |= Event.STOP
            if self._control is not None:
                self._control.requests.lower = None
        if Event.STOP in happened:  # it wins over what was said in the same cycle, whichever was said first
            happened &= ~MOTIONS
        if released and ((new and not self.drops_on_stop) or self._outdoes(happened)):
            released = False
            self._tell(Level.WARN, "a stop wins over the release that came with it: say it again")
        if released or (self._stopped and self.drops_on_stop):
            happened |= Event.RELEASED
        return happened

    def _hear_signals(self) -> None:
        """Keep which signal it was, as the reason of the hold that follows, and tell of it."""
        if self._signals.stops != self._signals_heard:
            self._signals_heard, self._signal = self._signals.stops, self._signals.why
            self._tell(Level.INFO, f"asked to stop: {self._signal}")

    def _outdoes(self, others: Event) -> bool:
        """Whether a session goes another way by these events than by a release alone, which has been answered `ok`."""
        mode, released = self._standing.mode, Event.RELEASED
        return self._session and next_in_session(mode, others | released) is not next_in_session(mode, released)

    def _says_stop(self) -> bool:
        """Always, but in a session once for each signal and each hold of this host."""
        stops = self._signals.stops + self._holds
        said, self._stops_said = self._stops_said, stops
        return stops != said or not self._session

    def _said(self, control: ControlSocket) -> Event:
        """What was asked for over the socket; the way down once its instant has come."""
        control.poll()
        requests, said = control.requests, Event.NONE
        if requests.words:
            for verb in requests.take():
                said |= EVENT_OF[verb]
        lower = requests.lower
        if lower is not self._lower:  # mapped once, as a start is
            if lower is None:
                self._tell(Level.WARN, "the lowering has been taken back")
            self._lower, self._lower_ns = lower, 0 if lower is None else lower.start_utc_ns - utc_offset_ns()
        if lower is not None and self._clock.now_ns() >= self._lower_ns:
            requests.lower = self._lower = None
            said |= Event.LOWER
        return said

    def start_ns(self) -> int | None:
        """The common start on CLOCK_MONOTONIC, which is the clock of every arm that can be given one.

        Mapped once, when it is given: later steps of the wall clock cannot move it.  A later start replaces an
        earlier one; None while there is none, or none any more.
        """
        given = self._control.requests.start if self._control is not None else None
        if given is not self._start:
            self._start = given
            if given is None:
                self._start_ns = None
                self._tell(Level.WARN, "the start has been taken back")
            else:
                self._start_ns, self._trouble = given.start_utc_ns - utc_offset_ns(), ""
                self._say_start(given)
        return self._start_ns

    def _say_start(self, given: Request) -> None:
        instant = datetime.fromtimestamp(given.start_utc_ns * 1e-9, UTC)
        bound_s = given.clock_bound_s
        if self.clock is not None:
            self.clock.given(bound_s)
        clock = "not synchronised" if bound_s is None else f"off by at most {bound_text(bound_s)}"
        data = {} if bound_s is None else {"clock_bound_s": bound_s}
        self._tell(Level.INFO, f"start given: {instant:%H:%M:%S.%f} UTC, clock {clock}", **data)

    def hold(self, reason: str) -> None:
        """Let the arm hold for a reason of this host; in a session once for each start."""
        if not self._stopped or (self._session and not self._trouble):
            self._stopped, self._trouble, self._holds = True, reason, self._holds + 1
            self._tell(Level.WARN, f"holds: {reason}")

    def arranged(self, reason: str) -> None:
        """The stop comes now that was arranged before; unlike others it lets nothing go, also in simulation."""
        self._arranged = reason
        self._tell(Level.WARN, reason)

    def now_ns(self) -> int:
        """On the clock of the arm."""
        return self._clock.now_ns()

    def mode(self, mode: Mode) -> None:
        """The arm's mode has changed."""
        took_nothing = self._standing.mode is Mode.GRASP and mode is Mode.APPROACH  # why has been said by `trouble`
        self._standing.enter(mode)
        signal, self._signal = self._signal, ""
        if self._session and not took_nothing:
            stands = mode is Mode.HOLD or mode is Mode.HALT
            if signal or not stands:
                self._standing.reason = way_back(mode, signal) if stands else ""
        elif not self._session and mode is Mode.HOLD:
            asked = self._trouble or signal or self._arranged or "it was asked to"
            self._standing.reason = asked if self._stopped or self._arranged else "the trajectory has ended"

    def trouble(self, reason: str) -> None:
        """Why the arm holds when nobody asked it to."""
        self._standing.reason = reason


def no_real_time(found: str) -> dict[str, str]:
    """The refusal of a start without real time."""
    return {"found": found, "expected": "SCHED_FIFO on a real arm", "remedy": NO_REAL_TIME_REMEDY}


def tick_of(ring: RingWriter) -> dict[str, float | None]:
    """How long the last cycle took, s, and how many there have been; None for what a cycle without a state lacks."""
    took = {name: float(ring.row[name]) for name in ("late_s", "read_s", "step_s", "write_s")}
    return {"cycles": ring.written, **{name: s if math.isfinite(s) else None for name, s in took.items()}}
