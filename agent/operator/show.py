"""`coop status` for a person: one line per arm, what is wrong in front, and one line each for clock and recorder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from typing import Any

from agent.host.clock import bound_text

WIDTH_REASON = 60  # of a table that is shown again and again; elsewhere a reason is whole, for its remedy is at its end
HANGS_S = 1.0  # without a row, of an arm that is asked nothing
ENDED, STARTING, HUNG, DEAD, NONE = "ENDED", "STARTING", "HUNG", "DEAD", "NONE"
_DEAF = frozenset({"FLOAT", "STAND", "SINK"})


class Tone(Enum):
    """How a line is meant; a terminal shows it as a colour."""

    GOOD = "green"
    BUSY = "cyan"
    HELD = "yellow"
    BAD = "red"


_TONES = {"READY": Tone.GOOD, "TRACK": Tone.BUSY, "FAULT": Tone.BAD, "OFF": Tone.BAD}


@dataclass(frozen=True)
class Line:
    """One line, of which `head` has the tone."""

    head: str
    rest: str
    tone: Tone


def lines(document: Mapping[str, Any], *, live: bool = False) -> list[Line]:
    """The document of agent.operator.status as lines; live: reasons are cut, so that a table keeps its place."""
    arms: Sequence[Mapping[str, Any]] = document["arms"]
    widest = max(len(arm["arm"]) for arm in arms)
    return [*(_arm(arm, widest, WIDTH_REASON if live else None) for arm in arms), _host(document)]


def _arm(arm: Mapping[str, Any], widest: int, width: int | None) -> Line:
    parts = [_loop(arm["timing"]), _servos(arm["servos"]), _errors(arm["errors"])]
    if arm["answers"]:
        head, tone = arm["mode"], _TONES.get(arm["mode"], Tone.HELD)
        wrong = [_cut(why, width) for why in (*unfit(arm), *_unguarded(arm))]
        if wrong:
            parts, tone = [*wrong, *parts], Tone.BAD
        if arm["reason"] and arm["mode"] not in ("READY", "TRACK"):
            parts.insert(0, _cut(arm["reason"], width))
        if arm["start_utc_ns"] is not None and arm["mode"] == "READY":
            parts.insert(0, "start given")
        parts.append(f"guard {arm['guard']}" if arm["guard"] else "")
    else:
        head, why = silent(arm)
        known = arm["mode"] and head != arm["mode"]
        tone = Tone.BAD if head not in (arm["mode"], ENDED, STARTING) or arm["mode"] == "FAULT" else Tone.HELD
        last = f"last {arm['mode']}, {arm['last_row_age_s']:.1f} s ago" if known else ""
        parts = [_cut(why, width), last, *(parts if arm["mode"] else ())]
    return Line(f"{arm['arm']:<{widest}}  {head:<5}", "; ".join(part for part in parts if part), tone)


def _cut(text: str, width: int | None) -> str:
    return text if width is None or len(text) <= width else f"{text[: width - 1]}…"


def unfit(arm: Mapping[str, Any]) -> list[str]:
    """Why an arm that answers takes no start, whatever it does now."""
    found = ["RUNS OTHER SETTINGS THAN THIS FILE"] if arm["same_cell"] is False else []
    why = arm["no_start"]
    return found + ([f"NO START: {why['found']}, expected {why['expected']}; {why['remedy']}"] if why else [])


def silent(arm: Mapping[str, Any]) -> tuple[str, str]:
    """Of an arm that gives no answer: in one word how it is, and why; the mode itself of one that listens to nobody."""
    if arm["alive"] and arm["mode"] in _DEAF and arm["last_row_age_s"] < HANGS_S:
        return arm["mode"], "listens to nobody"
    if arm["ended"] and arm["mode"]:
        return ENDED, ""
    if arm["alive"] and not arm["mode"]:
        return STARTING, f"{arm['silence']}: it loads or connects, and has made no cycle yet"
    head = HUNG if arm["alive"] else DEAD if arm["mode"] else NONE
    if not arm["failed"]:
        return head, arm["silence"]
    # an agent that is being started in the place of that one has no ring yet
    return head, f"{arm['failed']} (at {datetime.fromtimestamp(arm['failed_utc_ns'] // 10**9, UTC):%F %T} UTC)"


def _loop(timing: Mapping[str, Any] | None) -> str:
    if not timing or timing["late_max_s"] is None:
        return ""
    rate = f"{timing['rate_hz']:.0f} Hz, " if timing["rate_hz"] else ""
    lost = f", {timing['without_state']} of {timing['rows']} without a state" if timing["without_state"] else ""
    return f"{rate}late ≤ {timing['late_max_s'] * 1e3:.2f} ms, busy ≤ {timing['busy_max_s'] * 1e3:.2f} ms{lost}"


def _servos(servos: Mapping[str, Any] | None) -> str:
    if not servos or servos["max_C"] is None:
        return ""
    volts = f", {servos['min_V']:.1f} V" if servos["min_V"] is not None else ""
    grip = servos.get("grip")
    gripper = f", grip {grip['width_m'] * 1e3:.1f} mm" if grip else ""
    if grip and grip["force_N"] is not None:
        gripper += f" {grip['force_N']:z.0f} N"  # no -0
    return f"{servos['max_C']:.0f} °C {servos['joint']}{volts}{gripper}"


def _errors(errors: Mapping[str, Any] | None) -> str:
    if not errors:
        return ""
    found = list(errors["flags"])
    found += [f"servo {servo['servo_id']} ({servo['joint']}) error {servo['bits']:#04x}" for servo in errors["servos"]]
    bad = {name.removeprefix("bus_"): errors[name] for name in ("bus_timeouts", "bus_corrupt") if errors[name]}
    found += [f"{count} bus {name}" for name, count in bad.items()]
    return ", ".join(found)


def _unguarded(arm: Mapping[str, Any]) -> list[str]:
    """Of an arm with servos that holds where it is stopped: that nobody goes on when its agent cannot."""
    holds = arm["driver"] == "dynamixel" and arm["drops_on_stop"] is False
    return ["NO GUARD"] if holds and arm["guard"] is None else []


def _host(document: Mapping[str, Any]) -> Line:
    clock, recorder = document["clock"], document["recorder"]
    error_s = clock["max_error_s"]
    bound = "error not known" if error_s is None else f"error ≤ {bound_text(error_s)}"
    told = f"clock {'synchronised' if clock['synchronised'] else 'not synchronised'}, {bound}"
    if recorder["alive"]:
        size = "" if recorder["log_bytes"] is None else f", {recorder['log']} {recorder['log_bytes'] / 1e6:.1f} MB"
        record = f"recorder in {recorder['folder']}{size}"
        if left_out := recorder["left_out"]:
            whys = ", ".join(f"{count} {why}" for why, count in left_out.items())
            record += f"; LEFT OUT what does not belong here: {whys}"
    else:
        record = f"no recorder in {' or '.join(recorder['looked_in'])}"
    good = recorder["alive"] and not recorder["left_out"]
    return Line(f"host {document['host']}", f"{told}; {record}", Tone.GOOD if good else Tone.HELD)
