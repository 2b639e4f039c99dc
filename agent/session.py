"""What one arm does from its rest to the object and back beside its torque: gripper, words, what each phase waits for.

`agent.runner` asks it once a cycle; it decides no torque, and what it decides is an event like any other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from agent import phases
from agent.control.life import Life
from agent.control.memory import Memory
from agent.grip import GripPlan, GripResult, Watch
from agent.loop import Agent, Outcome
from agent.modes import Event, Mode
from agent.standing import hold_after, hold_here
from drivers.interface import Gripper, GripState

HOLDING = frozenset({Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER})
# what an operator may ask for, by mode; a word that is not here is refused, and STOP is heard everywhere
WORDS: dict[Mode, Event] = {
    Mode.REST: Event.APPROACH | Event.RELEASED,
    Mode.APPROACH: Event.GRASP | Event.PARK,
    Mode.READY: Event.STARTED | Event.RELEASED,
    Mode.HOLD: Event.LOWER | Event.RELEASED,
    Mode.LOWER: Event.RELEASED,
    Mode.RELEASE: Event.PARK,
    Mode.PARK: Event.APPROACH,
    Mode.HALT: Event.APPROACH | Event.PARK | Event.RELEASED,
}
_BACK: dict[Mode, str] = {
    Mode.HOLD: "`coop lower`, `coop release`, `coop park`",
    Mode.HALT: "`coop park`",
    Mode.REST: "`coop release`",
}
_SAID = Event.APPROACH | Event.GRASP | Event.LOWER | Event.PARK | Event.RELEASED
_UNFINISHED = {
    Mode.APPROACH: "the arm is still on its way",
    Mode.READY: "the load is being taken up",
    Mode.LOWER: "the object is still on its way down",
    Mode.RELEASE: "the gripper is not open yet",
}
_OPENING = frozenset({Mode.APPROACH, Mode.HALT})  # in which the gripper may still be on its way
_MEND: dict[GripResult, str] = {
    GripResult.STUCK: "free its fingers",
    GripResult.NO_FORCE: "it is open again: see what keeps its fingers apart",
}
_MEND_ELSE = "it is open again: put the object in its place"


@dataclass(frozen=True, slots=True)
class StartBound:
    """How far from its place an arm may see the object when the motion begins."""

    error_max_m: float
    error_max_rad: float


class SessionLoop:
    """One arm's session.  `reason` says why a word was refused or the arm stopped."""

    def __init__(
        self, agent: Agent, gripper: Gripper, plan: GripPlan, start: StartBound, *, leads_back_only: bool = False
    ) -> None:
        """The agent has a session; leads_back_only: for a guard, that begins nothing."""
        if agent.session is None:
            raise ValueError("an agent without a session")
        self.reason = ""
        self._life: Life = agent.session.life
        self._gripper = gripper
        self._plan = plan
        self._start = start
        self._refused = Event.APPROACH | Event.GRASP if leads_back_only else Event.NONE
        self._watch: Watch | None = None
        self._state: GripState | None = None  # of the last cycle, if the gripper said something
        self._open = False
        self._opens = False  # it has been told to, in RELEASE
        self._holds = False
        self._now: tuple[Mode, Memory] | None = None  # of the last cycle
        self._seen = True
        self._void_ns: int | None = None  # a start that counts no more

    def not_yet(self, word: Event) -> str:
        """Why this word counts for nothing now, by the last cycle; empty where it does."""
        if self._now is None:
            return "it has just begun"
        if word is Event.STARTED and not self.taken_up(*self._now):
            return _UNFINISHED[Mode.READY]
        return self.refusal(self._now[0], word & _SAID, self._now[1]) if word & _SAID else ""

    def judge(self, mode: Mode, events: Event, memory: Memory, *, seen: bool = True) -> Event:
        """The events that count in this mode, with what the arm has found out by itself; seen: it answers."""
        self._now, self._seen = (mode, memory), seen
        state = self._state = self._gripper.grip_state()
        said = events & _SAID
        refused = self.refusal(mode, said, memory) if said else ""
        if refused:
            self.reason = refused
            events &= ~_SAID
        if mode is Mode.RELEASE and not self._opens and events & (Event.STOP | Event.TROUBLE):
            events |= Event.GRIPPED
        if Event.STARTED in events and (reason := self._bad_start(memory)):
            self.reason = reason
            events = (events & ~Event.STARTED) | Event.STOP
        if state is None:
            return events
        if self._watch is None:
            self._watch = self._plan.begin(state)
        self._watch = self._plan.watch(self._watch, state)
        return events | self._found(mode, memory, self._watch, state)

    def entered(self, mode: Mode) -> None:
        """Tell the gripper what this mode asks of it."""
        if mode in (Mode.APPROACH, Mode.RELEASE):
            self._open = self._opens = False
        if mode is Mode.APPROACH or mode is Mode.PARK or mode is Mode.HALT:  # a hand may be in a gripper that closes
            self._move(self._plan.open_m)
        elif mode is Mode.GRASP:
            self._open = False
            self._move(self._plan.closed_m)
        elif mode is Mode.READY:
            self._holds = True

    def await_start(self, given_ns: int | None) -> None:
        """READY has begun: a start that was given before counts no more."""
        self._void_ns = given_ns

    def counts(self, zero_ns: int | None, deadline_ns: int) -> bool:
        """Whether a start at zero_ns counts: none that was given before this READY, and none that has passed."""
        if zero_ns is None or zero_ns == self._void_ns:
            return False
        if zero_ns <= deadline_ns:
            self._void_ns = zero_ns
            self.reason = "start: its instant passed before this arm was ready; start all arms again"
            return False
        return True

    def taken_up(self, mode: Mode, memory: Memory) -> bool:
        """Whether a common start may be taken over."""
        return mode is Mode.READY and phases.arrived(self._life, mode, memory)

    def refusal(self, mode: Mode, said: Event, memory: Memory) -> str:
        """Why these words cannot be followed now; empty where they can."""
        if said & ~WORDS.get(mode, Event.NONE):
            return f"{_names(said)} in {mode.name}: found {mode.name}, expected {_where(said)}; {_way(mode)}"
        if said & self._refused:
            return f"{_names(said)}: the guard holds the arm in its agent's place and leads it back alone"
        if not self._seen:
            return f"{_names(said)}: the arm does not answer; check its cable and its supply"
        if mode in _UNFINISHED and not self._done(mode, memory) and said != Event.PARK:
            return f"{_names(said)}: {_UNFINISHED[mode]}; wait for it"
        if Event.PARK in said and mode is Mode.RELEASE and not self._open:
            return f"park: {_UNFINISHED[mode]}; wait for it"
        if Event.PARK in said and mode in _OPENING and self._is_opening():
            return f"park: {_UNFINISHED[Mode.RELEASE]}; wait for it"
        going = said & (Event.APPROACH | Event.PARK)
        if going and mode in (Mode.REST, Mode.HALT) and memory.q_hold is not None:
            off = self._life.off(memory.q_hold)
            if not off <= self._life.off_max_rad:
                return (
                    f"{_names(said)}: a joint is {off:.2f} rad from the arm's path, expected at most "
                    f"{self._life.off_max_rad:g}; release the arm, bring it to its rest by hand and start it again"
                )
        return ""

    def resume(self, mode: Mode) -> None:
        """Begin in this mode behind another loop, with what that had the gripper do."""
        self._holds = mode in HOLDING
        if mode in HOLDING:
            self._move(self._plan.closed_m)
        elif mode is not Mode.REST:
            self._move(self._plan.open_m)

    def _is_opening(self) -> bool:
        watch, state = self._watch, self._state
        return watch is not None and state is not None and self._plan.opening(watch, state) is GripResult.MOVING

    def _done(self, mode: Mode, memory: Memory) -> bool:
        return phases.arrived(self._life, mode, memory) and (mode is not Mode.RELEASE or self._open)

    def _found(self, mode: Mode, memory: Memory, watch: Watch, state: GripState) -> Event:
        """What the arm finds out by itself."""
        plan = self._plan
        if mode is Mode.GRASP:
            return self._closed(plan.closing(watch, state), state)
        if mode in HOLDING and self._holds and plan.lost(state):
            self._holds = False
            return self._trouble(f"the gripper lost the object: {state.width_m * 1e3:.1f} mm between its fingers")
        if mode is Mode.RELEASE and phases.arrived(self._life, mode, memory) and not self._open:
            self._holds = False
            if not self._opens:
                self._opens = True
                self._move(plan.open_m)
                return Event.NONE
            return self._opened(plan.opening(watch, state), state)
        if mode is Mode.APPROACH and not self._open:
            return self._opened(plan.opening(watch, state), state)
        if mode is Mode.PARK and phases.arrived(self._life, mode, memory):
            return Event.ARRIVED
        return Event.NONE

    def _closed(self, verdict: GripResult, state: GripState) -> Event:
        if verdict is GripResult.MOVING:
            return Event.NONE
        if verdict is GripResult.HOLDS:
            return Event.GRIPPED
        wanted = f"{self._plan.width_m * 1e3:.1f} mm"
        self.reason = (
            f"the gripper {verdict.value}: found {state.width_m * 1e3:.1f} mm, expected {wanted}; "
            f"{_MEND.get(verdict, _MEND_ELSE)}, then `coop grasp`, or `coop park`"
        )
        return Event.NOT_GRIPPED

    def _opened(self, verdict: GripResult, state: GripState) -> Event:
        if verdict is GripResult.OPEN:
            self._open = True
        elif verdict is GripResult.STUCK:
            return self._trouble(
                f"the gripper {verdict.value}: found {state.width_m * 1e3:.1f} mm, expected "
                f"{self._plan.open_m * 1e3:.1f} mm; free it, then `coop approach` or `coop park`"
            )
        return Event.NONE

    def _trouble(self, reason: str) -> Event:
        self.reason = reason
        return Event.TROUBLE

    def _move(self, width_m: float) -> None:
        state = self._gripper.grip_state()
        self._gripper.grip(width_m)
        self._watch = None if state is None else self._plan.begin(state)

    def _bad_start(self, memory: Memory) -> str:
        """Why the motion must not begin here; empty where it may."""
        d, rho = math.hypot(*memory.shift[:3]), math.hypot(*memory.shift[3:])
        if d <= self._start.error_max_m and rho <= self._start.error_max_rad:
            return ""
        return (
            f"start: found the object {d * 1e3:.1f} mm and {rho * 1e3:.0f} mrad from its place, expected at most "
            f"{self._start.error_max_m * 1e3:g} mm and {self._start.error_max_rad * 1e3:g} mrad; "
            "lower, release and park, then put the object in its place"
        )


def way_back(mode: Mode, reason: str, *, seen: bool = True) -> str:
    """The reason for which an arm of a session stands, with the words that lead back; seen: it answers now."""
    words = _BACK.get(mode, "")
    when = "way back" if seen else "way back once it answers again"
    return "; ".join(part for part in (reason, f"{when}: {words}" if words else "") if part)


def entered(agent: Agent, mode: Mode, memory: Memory, outcome: Outcome | None) -> Memory:
    """Memory with which an arm of a session enters a mode; outcome: of the tick before, None without a fresh state."""
    memory = memory._replace(age=0.0)
    if mode is Mode.LOWER:  # from the pose that was held
        return memory
    if outcome is not None and (mode is Mode.HOLD or mode is Mode.RELEASE):
        return hold_after(agent, outcome._replace(memory=memory))
    if outcome is not None and mode is Mode.HALT and agent.session is not None:  # where it comes to rest
        return hold_here(agent, outcome.q + outcome.dq / agent.session.life.rate_rad_per_s, memory)
    return memory._replace(hold=None, q_hold=None)  # where it is seen first


def _names(events: Event) -> str:
    words = {Event.RELEASED: "release"}
    return " and ".join(words.get(e, (e.name or "").lower()) for e in Event if e and e in events & _SAID)


def _where(said: Event) -> str:
    return " or ".join(mode.name for mode, words in WORDS.items() if said & words == said)


def _way(mode: Mode) -> str:
    words = _names(WORDS.get(mode, Event.NONE))
    return f"from here: {words.replace(' and ', ' or ')}" if words else "wait"
