"""The tables of a report as plain text cells, for the terminal and the page."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from typing import Final

from agent.log.runinfo import Bounded
from agent.modes import Mode
from agent.report.numbers import ABSENT, instant, millimetres, milliradians, milliseconds, number
from agent.report.pace import pace_line
from agent.report.results import Judgement, PoseErrors, Results, WrenchSize

WORDS: Final = {Judgement.MET: "✓ met", Judgement.NOT_MET: "✗ not met", Judgement.NOT_SHOWN: "? not shown"}


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the table of results; `verdict` is None where the cell sets no bound."""

    what: str
    figure: str
    bound: str = ""
    verdict: Judgement | None = None


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text; the first column names the line, the others are figures unless `words`."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: bool = False


def lines(results: Results) -> list[Line]:
    """The table of results: figure, bound, verdict."""
    found = [
        _bounded(results, "largest position error", Bounded.POSITION),
        _bounded(results, "largest attitude error", Bounded.ATTITUDE),
        Line("rms position error", millimetres(results.headline("rms_position_error_m"))),
        Line("rms attitude error", milliradians(results.headline("rms_attitude_error_rad"))),
    ]
    if results.by_plant and results.info.plane:
        off = millimetres(results.by_plant.max_out_of_plane_error_m)
        found.append(Line("largest error out of the plane", off))
    value, arm, joint = results.worst_torque
    peak = f"{number(value, '%', 100.0)} of stall" if arm else ABSENT
    found += [
        Line("peak torque" + (f" ({arm} {joint.replace('_', ' ')})" if arm else ""), peak),
        _completeness(results),
        Line("arms disagree on the object by", _disagreement(results)),
        Line("real-time factor", number(results.real_time_factor)),
        Line("late cycles", str(results.late_cycles)),
        Line("cycles left out", pace_line({name: a.pace for name, a in results.arms.items()})),
        Line("events", str(results.events)),
    ]
    if results.rehearsing:
        found.append(Line("REHEARSAL, object simulated; real arms", ", ".join(results.rehearsing)))
    if results.loss:
        found += [Line(what, figure, bound, Judgement.NOT_MET) for what, figure, bound in results.loss.lines()]
        found += [Line("grasp slipped", figure) for figure in results.loss.slips()]
    found += [Line("HELD before its end", f"{arm} from {instant(t)}") for arm, t in _held(results)]
    if math.isfinite(results.set_down_error_m):
        off = f"{millimetres(results.set_down_error_m)}, {milliradians(results.set_down_error_rad)}"
        found.append(Line("object set down beside its place by", off))
    return found


def _disagreement(results: Results) -> str:
    most, end = millimetres(results.arm_disagreement_m), results.together
    if end is None or (results.loss and not results.loss.kept):  # their shifts then say nothing of a common object
        return most
    return f"{most}; at the end {millimetres(end.apart_m)}, and have found together to {millimetres(end.left_m)}"


def _held(results: Results) -> list[tuple[str, float]]:
    """Arms that held before the motion was over, or before it began, and when; the first of them first."""
    end_s = results.info.duration_s - 0.5 / results.info.rate_hz
    begun = {  # a start that is taken back, or the way home after the end, counts towards a day ahead again
        name: [t for t, mode in takewhile(lambda begins: begins[0] < end_s, a.modes) if mode == Mode.HOLD.name]
        for name, a in results.arms.items()
    }
    return sorted(((name, times[0]) for name, times in begun.items() if times), key=lambda held: held[1])


def _bounded(results: Results, what: str, bounded: Bounded) -> Line:
    show = millimetres if bounded is Bounded.POSITION else milliradians
    bound = results.info.bounds.get(bounded)
    figure = show(results.headline(bounded.value))
    return Line(what, figure, "" if bound is None else f"≤ {show(bound)}", results.verdict(bounded))


def _completeness(results: Results) -> Line:
    figure = f"{results.rows_recorded} of {results.rows_expected}"
    verdict = Judgement.MET if results.complete else Judgement.NOT_MET
    return Line("rows in the log", figure, "all", verdict)


def tables(results: Results) -> list[Table]:
    """Every table beyond the one of results, in the page's order; those without a line are left out."""
    each = (_errors, _torques, _forces, _noticed, _in_the_loop, _grips, _timing, _log, _states, _phases)
    return [table for table in (make(results) for make in each) if table.rows]


def _phases(results: Results) -> Table:
    rows = tuple(
        (f"{p.arm} {p.name}", number(p.begin, "s"), number(p.end - p.begin, "s"), p.outcome) for p in results.phases
    )
    return Table("Phases", ("phase", "begins", "lasts", "outcome"), rows, words=True)


def _errors(results: Results) -> Table:
    sources = [*([results.by_plant] if results.by_plant else []), *results.by_arm.values()]

    def row(e: PoseErrors) -> tuple[str, ...]:
        return (
            "true pose" if e is results.by_plant else f"seen by {e.source}",
            str(e.rows),
            millimetres(e.max_position_error_m),
            millimetres(e.rms_position_error_m),
            milliradians(e.max_attitude_error_rad),
            milliradians(e.rms_attitude_error_rad),
            f"{millimetres(e.position.initial)}, {milliradians(e.attitude.initial)}",
            f"{number(e.position.tenth_s, 's')}, {number(e.attitude.tenth_s, 's')}",
        )

    header = ("", "rows", "position max", "rms", "attitude max", "rms", "at the start", "below a tenth after")
    return Table("Errors after the transient", header, tuple(row(e) for e in sources))


def _torques(results: Results) -> Table:
    header = (
        "joint",
        "peak",
        "of stall",
        "limit",
        "rms",
        "of continuous",
        "change per tick",
        "cut by safety",
        "at the limit",
    )
    rows = tuple(
        (
            f"{arm} {joint.replace('_', ' ')}",
            number(r.peak_torque_Nm, "N·m"),
            number(r.peak_torque_fraction, "%", 100.0),
            number(r.tau_max_Nm, "N·m"),
            number(r.rms_torque_Nm, "N·m"),
            number(r.rms_of_continuous, "%", 100.0),
            number(r.chatter_Nm, "N·m"),
            number(r.limited_s, "s"),
            number(r.at_limit_s, "s"),
        )
        for arm, a in results.arms.items()
        for joint, r in a.joints.items()
    )
    return Table("Torque of each joint: peak and limits of the whole run, rms and change of the motion", header, rows)


def _forces(results: Results) -> Table:
    def size(w: WrenchSize) -> str:
        return f"{number(w.max_force_N, 'N')}, {number(w.max_moment_Nm, 'N·m')}"

    header = ("arm", "largest wrench u", "internal, commanded", "internal, realised", "load share", "realised")
    rows = tuple(
        (
            name,
            size(a.wrench_cmd),
            size(a.internal_cmd),
            size(a.internal_realised),
            number(a.load_share_cmd),
            number(a.load_share_realised),
        )
        for name, a in results.arms.items()
    )
    return Table("Wrenches and load share", header, rows)


def _noticed(results: Results) -> Table:
    header = (
        "arm",
        "desired pose shifted by",
        "friction, of its file's",
        "unexpected, sudden",
        "unexpected, staying",
        "most loaded joint",
    )
    rows = tuple(
        (
            name,
            f"{millimetres(a.shift_max_m)}, {milliradians(a.shift_max_rad)}",
            number(a.friction_factor),
            f"{number(a.unexpected_fast_max_N, 'N')}, {number(a.unexpected_fast_max_Nm, 'N·m')}",
            f"{number(a.unexpected_slow_max_N, 'N')}, {number(a.unexpected_slow_max_Nm, 'N·m')}",
            f"{number(a.load_max, '%', 100.0)} of its limit",
        )
        for name, a in results.arms.items()
    )
    return Table("Largest of what each arm noticed and gave, whole run; friction as learned in the end", header, rows)


def _in_the_loop(results: Results) -> Table:
    header = ("arm", "largest addition", "arm and twin apart by", "oldest state of the twin", "coupled")
    rows = tuple(
        (
            name,
            f"{number(a.hil.added_max, '%', 100.0)} of the limit",
            milliradians(a.hil.apart_max_rad),
            milliseconds(a.hil.twin_age_max_s),
            f"{number(a.hil.coupled, '%', 100.0)} of the cycles",
        )
        for name, a in results.arms.items()
        if a.hil is not None
    )
    return Table("Real arms in the loop of a simulated cell", header, rows)


def _grips(results: Results) -> Table:
    header = ("arm", "told", "between the fingers", "force of each", "its limit")
    rows = tuple(
        (
            name,
            millimetres(a.grip.width_cmd_m),
            f"{millimetres(a.grip.width_min_m)} to {millimetres(a.grip.width_max_m)}",
            f"{number(a.grip.force_min_N, 'N')} to {number(a.grip.force_max_N, 'N')}",
            number(a.grip.force_limit_N, "N"),
        )
        for name, a in results.arms.items()
        if a.grip is not None
    )
    return Table("Grippers while they held the object", header, rows)


def _timing(results: Results) -> Table:
    def rows() -> Iterator[tuple[str, ...]]:
        for name, a in results.arms.items():
            for what, spread in a.timing.items():
                label = f"{name} {what.removesuffix('_s')}"
                yield label, milliseconds(spread.p50_s), milliseconds(spread.p99_s), milliseconds(spread.max_s)

    return Table("Loop timing", ("", "median", "99 %", "largest"), tuple(rows()))


def _log(results: Results) -> Table:
    header = (
        "arm",
        "expected",
        "recorded",
        "after the end",
        "missing",
        "late",
        "overruns",
        "left out of those due",
        "bus: timeout, corrupt, alert, retry",
    )

    def row(name: str) -> tuple[str, ...]:
        c, a = results.rows[name], results.arms.get(name)
        gaps = ", ".join(f"{first}–{last}" if last > first else str(first) for first, last in c.gaps[:4])
        more = f" and {len(c.gaps) - 4} more" if len(c.gaps) > 4 else ""
        bus = ", ".join(str(v) for v in a.bus.values()) if a else ABSENT
        late = (
            (str(a.late_cycles), str(a.overruns), f"{a.pace.left_out_cycles} of {a.pace.due_cycles}")
            if a
            else 3 * (ABSENT,)
        )
        return name, str(c.expected), str(c.recorded), str(c.after_end), (gaps + more) or "none", *late, bus

    return Table("Rows and cycles", header, tuple(row(name) for name in results.rows))


def _states(results: Results) -> Table:
    header = (
        "arm",
        "modes",
        "flags raised on ticks",
        "e_η start → end",
        "Lyapunov start → end",
        "least bound of σ",
        "velocity error rms",
    )
    rows = tuple(
        (
            name,
            ", ".join(f"{mode} from {instant(t)}" for t, mode in a.modes),
            ", ".join(f"{flag} {count}" for flag, count in a.flags.items() if count) or "none",
            f"{a.e_eta_start:.6f} → {a.e_eta_end:.6f}",
            f"{a.lyapunov_start_J:.2g} → {a.lyapunov_end_J:.2g} J",
            number(a.sigma_min),
            number(a.rms_velocity_error_m_per_s, "mm/s", 1e3),
        )
        for name, a in results.arms.items()
    )
    return Table("States of each arm", header, rows, words=True)
