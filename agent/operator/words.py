"""An operator's words to the agents of this host: all are asked first, and told only when all would take the word.

Stop and release are not asked about: they reach everybody who is alive, and say who did not answer.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from datetime import time as time_of_day
from pathlib import Path
from types import MappingProxyType

from agent.config.cell import Cell
from agent.host.clock import ClockState
from agent.modes import Mode
from agent.operator.ask import REPLY_TIMEOUT_S, Heard, Silence, ask_arms
from agent.operator.error import ControlError, InstantError
from agent.operator.local import Places, has_other_hosts, judge_clock, named, places
from agent.operator.message import Reply, Request
from agent.operator.session_table import SESSION
from agent.operator.table import LETS_GO, TABLE, Verb

SOONEST_S = 0.05
ATTEMPTS = 3  # of a patient start
FORGET_S = 0.25  # for answers to what takes an instant back that somebody has broken off; who is late obeys it too
DAY, MIDNIGHT = timedelta(days=1), timedelta(hours=1)

_SEE = "see `coop status` and their logs; stop reaches all who answer"
_ELSEWHERE = "agents of another user, XDG_RUNTIME_DIR or cell name listen elsewhere"
_SOME = "name those that are meant with --arm; "
_REACH_WHO_LIVES = (Verb.STOP, Verb.RELEASE)
_NEEDED: Mapping[Verb, str] = MappingProxyType({
    Verb.START: "every arm of this host READY with this cell",
    Verb.LOWER: "every arm of this host to hold the object",
    Verb.APPROACH: "every arm of this host ready to approach",
    Verb.GRASP: "every arm of this host at its grasp",
    Verb.PARK: "every arm of this host free to go",
})  # fmt: skip


@dataclass(frozen=True)
class Here:
    """What belongs to this host rather than to the cell."""

    clock: ClockState
    host: str | None = None  # None: this host's own name


def start_arms(
    cell: Cell, at: str | None, in_s: float | None, sockets: Sequence[Path], here: Here, tell: Callable[[str], None]
) -> str:
    """Give all agents of this host one start instant, or none of them; one line about it.

    tell: is told how good the clock is.  Raises ControlError; its text says what became of those who had accepted.
    """
    instant = _instant(Verb.START, at, in_s)
    request = Request(
        Verb.START, cell.fingerprint, int(instant.timestamp() * 1e9),
        clock_bound_s=here.clock.max_error_s if here.clock.synchronised else None,
    )  # fmt: skip
    _require_time(request)
    tell(judge_clock(here.clock, several_hosts=has_other_hosts(cell, sockets, here.host)))
    arms = places(cell, [], sockets, here.host)
    start_together(arms, request)
    return f"{len(arms)} arms start at {instant:%H:%M:%S.%f} UTC"


def start_together(
    arms: Places, request: Request, timeout_s: float = REPLY_TIMEOUT_S, look: Callable[[], None] | None = None
) -> None:
    """Give a start or a lowering to all or none: prepare, then commit.  Raises ControlError when not every arm accepts.

    Then no arm begins that can be reached; nor where it is broken off, by what `look`, which is called meanwhile,
    raises, or by Ctrl-C.
    """
    verb, needed = request.verb, _NEEDED[request.verb]
    request = replace(request, token=secrets.token_hex(8), asked_ns=time.monotonic_ns())
    _ask_first(arms, request, timeout_s, look)
    _require_time(request)
    left_s = 1e-9 * (request.start_utc_ns - time.time_ns())
    refused = _unwilling(_asked(arms, request, min(timeout_s, 0.5 * left_s), look))  # half is left for taking it back
    if refused:
        left_s = max(SOONEST_S, 1e-9 * (request.start_utc_ns - time.time_ns()))
        taken_back = _asked(arms, Request(Verb.CANCEL, token=request.token), min(timeout_s, left_s), look)
        raise ControlError(
            verb.value, found=named(refused), expected=f"{needed} still, when it was given the instant",
            remedy=f"the {verb.value} was taken back ({_outcome(taken_back)}); {_SEE}",
        )  # fmt: skip


def start_patiently(arms: Places, fingerprint: str, in_ns: int, look: Callable[[], None]) -> int:
    """The same, so many ns from now, and again where that fails: a machine that stalls answers late; UTC of it, ns.

    look: is called before each attempt and during it; what it raises ends them.
    Raises ControlError of the last attempt; a start that failed, or was broken off, has been taken back.
    """
    for attempt in range(ATTEMPTS):
        look()
        request = Request(Verb.START, fingerprint, time.time_ns() + in_ns)
        try:
            start_together(arms, request, look=look)
        except ControlError:
            if attempt + 1 == ATTEMPTS:
                raise
        else:
            break
    return request.start_utc_ns


def _asked(arms: Places, request: Request, timeout_s: float, look: Callable[[], None] | None) -> Mapping[str, Heard]:
    """What each arm answers; where the asking is broken off every arm is told to forget it, however it ended."""
    with ExitStack() as broken_off:
        if request.token:
            forget = Request(Verb.CANCEL, prepare=request.prepare, token=request.token)
            broken_off.callback(ask_arms, arms, forget, FORGET_S)
        heard = ask_arms(arms, request, timeout_s, look)
        broken_off.pop_all()
    return heard


def _ask_first(arms: Places, request: Request, timeout_s: float, look: Callable[[], None] | None = None) -> None:
    """Raise ControlError, nothing having been done, unless all arms would take the word."""
    heard = _asked(arms, replace(request, prepare=True), timeout_s, look)
    refused = _unwilling(heard) | _others(heard, request)
    if refused:
        agreed = {arm: arms[arm] for arm, one in heard.items() if isinstance(one, Reply) and one.ok}
        if agreed and request.token:  # the next operator need not wait until they have forgotten it
            _asked(agreed, Request(Verb.CANCEL, prepare=True, token=request.token), timeout_s, look)
        raise ControlError(
            request.verb.value, found=named(refused), expected=_NEEDED[request.verb],
            remedy=f"no arm has been told; {'' if request.verb is Verb.START else _SOME}{_SEE}{_elsewhere(heard)}",
        )  # fmt: skip


def _unwilling(heard: Mapping[str, Heard]) -> dict[str, str]:
    """Those who did not accept, and what is said of each."""
    return {arm: _told(one) for arm, one in heard.items() if not (isinstance(one, Reply) and one.ok)}


def _others(heard: Mapping[str, Heard], request: Request) -> dict[str, str]:
    """Those who accept a word that is not theirs: agents of another version."""
    needs, ready = request.fingerprint, request.verb is Verb.START
    return {
        arm: f"{one.mode} with cell {one.fingerprint[:12]}, not {'READY ' if ready else ''}with {needs[:12]}"
        for arm, one in heard.items()
        if isinstance(one, Reply) and one.ok and (one.fingerprint != needs or (ready and one.mode != Mode.READY.name))
    }


def _told(heard: Heard) -> str:
    if not isinstance(heard, Reply):
        return f"does not answer ({heard.found})"
    if heard.ok:
        return f"{heard.mode} {heard.reason}".strip()
    refusal = heard.refusal
    found = refusal["found"].removeprefix(f"arm {heard.arm} in {heard.mode}: ")  # who, and in which mode, is said here
    return f"refuses in {heard.mode}: {found}, expected {refusal['expected']}, {refusal['remedy']}"


def _elsewhere(heard: Mapping[str, Heard]) -> str:
    """Where else one may be that is nowhere here."""
    return f"; {_ELSEWHERE}" if any(isinstance(one, Silence) and one.nowhere for one in heard.values()) else ""


def _outcome(heard: Mapping[str, Heard]) -> str:
    """What became of what was taken back, arm by arm."""
    said = {}
    for arm, one in heard.items():
        if not isinstance(one, Reply):
            said[arm] = "NOT KNOWN, it does not answer"
        elif one.mode in ("TRACK", "LOWER"):
            said[arm] = f"had begun, {LETS_GO[Mode[one.mode]] if _lets_go(one) else 'holds now'}"
        else:
            said[arm] = "does not begin"
    return named(said)


def tell_arms(cell: Cell, verb: Verb, arms: Sequence[str], sockets: Sequence[Path], host: str | None = None) -> str:
    """Say a word that needs no instant to this host's agents; what each does.

    Raises ControlError: of stop and release when one did not answer, after all others were told; of any other word
    before an arm moves, unless one refuses what it had agreed to.
    """
    return _tell_all(places(cell, arms, sockets, host), Request(verb, cell.fingerprint), REPLY_TIMEOUT_S)


def lower_arms(
    cell: Cell,
    at: str | None,
    in_s: float | None,
    arms: Sequence[str],
    sockets: Sequence[Path],
    host: str | None = None,
) -> str:
    """Have the arms meant set the object down from one instant on, all of them or none.  Raises ControlError."""
    instant = _instant(Verb.LOWER, at, in_s)
    request = Request(Verb.LOWER, cell.fingerprint, int(instant.timestamp() * 1e9))
    _require_time(request)
    meant = places(cell, arms, sockets, host)
    start_together(meant, request)
    return f"{len(meant)} arms lower the object at {instant:%H:%M:%S.%f} UTC"


def _tell_all(arms: Places, request: Request, timeout_s: float) -> str:
    verb = request.verb
    if verb not in _REACH_WHO_LIVES:
        _ask_first(arms, request, timeout_s)
    heard = ask_arms(arms, request, timeout_s)
    refused = _unwilling(heard)
    if refused:
        done = _done({arm: one for arm, one in heard.items() if arm not in refused}, verb)
        raise ControlError(
            verb.value, found=named(refused), expected="every arm of this host to take it",
            remedy=f"done: {done or 'none'}; for the others see `coop status` and their logs{_elsewhere(heard)}",
        )  # fmt: skip
    return _done(heard, verb)


def _done(heard: Mapping[str, Heard], verb: Verb) -> str:
    """What those do who took the word."""
    does = {arm: _does(verb, one) for arm, one in heard.items() if isinstance(one, Reply)}
    return "; ".join(f"{arm} {text}" for arm, text in does.items())


def _does(verb: Verb, one: Reply) -> str:
    table, mode = SESSION if one.details.get("session") else TABLE, Mode[one.mode]
    does = table[verb][mode].does
    return LETS_GO.get(mode, does) if verb is Verb.STOP and _lets_go(one) else does


def _lets_go(one: Reply) -> bool:
    """Whether a stop ends this agent; one of a release that does not say so is taken for one that holds."""
    return one.details.get("drops_on_stop") is True


def _require_time(request: Request) -> None:
    """Raise ControlError when the instant is too near to be given to every arm."""
    if request.start_utc_ns - time.time_ns() < SOONEST_S * 1e9:
        instant = datetime.fromtimestamp(request.start_utc_ns * 1e-9, UTC)
        raise ControlError(
            request.verb.value, found=f"{instant:%H:%M:%S.%f} UTC", expected=f"at least {SOONEST_S:g} s from now",
            remedy="choose a later instant",
        )  # fmt: skip


def _instant(verb: Verb, at: str | None, in_s: float | None) -> datetime:
    """The instant that a command line names.  Raises InstantError."""
    now = datetime.now(UTC)
    if (at is None) == (in_s is None):
        raise InstantError(verb.value, found="no instant, or two", expected="--at or --in", remedy="e.g. --in 5")
    if in_s is not None:
        return now + timedelta(seconds=in_s)
    try:
        clock = datetime.strptime(at or "", "%H:%M:%S").time()  # noqa: DTZ007 - the date is today's, in UTC
    except ValueError as error:
        raise InstantError(
            verb.value, found=repr(at), expected="HH:MM:SS (UTC)", remedy="e.g. --at 14:30:00"
        ) from error
    return on_its_day(clock, now)


def on_its_day(clock: time_of_day, now: datetime) -> datetime:
    """That time of today, UTC; around midnight that of the day next to it, where that is less than MIDNIGHT from now.

    Hosts that are told the same time on either side of midnight so mean the same instant.
    """
    today = datetime.combine(now.date(), clock, UTC)
    near = (day for day in (today - DAY, today + DAY) if abs(day - now) < MIDNIGHT)
    return next(near, today)
