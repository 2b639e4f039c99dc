"""What a cell file says that may be meant but is more often a slip; findings for a person, most of them warnings."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.schema.driver import DriverKind
from agent.verify.finding import Finding, Verdict, judged, refused, warning

UPRIGHT_RAD = math.radians(5.0)
GUARD_WIDE_M, GUARD_WIDE_RAD = 0.2, 1.0
ON_EARTH_M_PER_S2 = 9.76, 9.84  # at the sea, from the equator to the poles
BESIDE_BOX_M = 0.03  # by which a grasp may be beside the object's box: fingers are longer than they grip
PUSH_MOST_N, PUSH_MOST_NM = 100.0, 20.0  # of a simulated push, ten times what any arm here lifts
LONG_S = 60.0  # for one step of a session
OFF_FAR_RAD = 1.0  # of a joint from its path
DENSITY_MIN_KG_PER_M3, DENSITY_MAX_KG_PER_M3 = 1.0, 25_000.0  # a frame in the air, and above all metals
INERTIA_MARGIN = 2.0  # on all the mass in the corners, of a box that is drawn too small


def plausibility(cell: Cell) -> list[Finding]:
    """Gravity and how the arms stand in it, the object, shares, guards and ports, and what is to befall them."""
    return [
        *_gravity(cell), *_object(cell), *_grasps(cell), *_shares(cell), *_guards(cell), *_ports(cell), *_session(cell),
        *_befalls(cell), *_pushes(cell), *_judged(cell),
    ]  # fmt: skip


def _gravity(cell: Cell) -> list[Finding]:
    """Nothing tells off-line which way is down; that most arms stand upright is what a wrong direction shows by."""
    g = float(np.linalg.norm(cell.gravity))
    if not g:
        moved = cell.file.driver is DriverKind.DYNAMIXEL
        return [
            judged(
                "gravity", "cell", "0", "that of the place", holds=False,
                remedy="give world.gravity_m_per_s2; without it nothing has weight",
                otherwise=Verdict.REFUSED if moved else Verdict.WARNING,
            )
        ]  # fmt: skip
    down = cell.gravity / g
    low, high = ON_EARTH_M_PER_S2
    findings = [
        judged(
            "gravity", "cell", f"{g:.4g} m/s² along {_direction(down)}", "straight down at the arms"
            if low <= g <= high else f"{low:g} to {high:g} m/s², straight down at the arms", holds=low <= g <= high,
            otherwise=Verdict.WARNING, remedy="right on another planet; else correct world.gravity_m_per_s2",
        )
    ]  # fmt: skip
    for arm in cell.arms:
        tilt = math.acos(max(-1.0, min(1.0, -float(arm.T_world_base.rotation[:, 2].dot(down)))))
        findings.append(
            judged(
                "base against gravity", arm.name, f"{math.degrees(tilt):.1f}° from upright", "upright",
                holds=tilt <= UPRIGHT_RAD, otherwise=Verdict.WARNING,
                remedy="right if the arm is mounted so; else correct quat_world_base or world.gravity_m_per_s2",
            )
        )  # fmt: skip
    return findings


def _object(cell: Cell) -> list[Finding]:
    """Warn of a mass, or moments about its centre, that no body within the object's box has; of others nothing."""
    mass_kg, (a, b, c) = cell.file.object.mass_kg, cell.file.object.size_m
    largest_kg_m2 = float(np.linalg.eigvalsh(cell.file.object.inertia_kg_m2.matrix())[-1])
    density = mass_kg / (a * b * c)
    corners_kg_m2 = mass_kg * (a * a + b * b + c * c) / 4.0  # all the mass as far away as it can be
    solid = ", ".join(f"{mass_kg * (p * p + q * q) / 12.0:.3g}" for p, q in ((b, c), (a, c), (a, b)))
    findings = [
        judged(
            "density of the object's box", "cell", f"{density:.3g} kg/m³",
            f"{DENSITY_MIN_KG_PER_M3:g} to {DENSITY_MAX_KG_PER_M3:g} kg/m³",
            holds=DENSITY_MIN_KG_PER_M3 <= density <= DENSITY_MAX_KG_PER_M3, otherwise=Verdict.WARNING,
            remedy="correct object.mass_kg (kg) or object.size_m (m)",
        ),
        judged(
            "inertia of the object", "cell", f"up to {largest_kg_m2:.3g} kg·m²",
            f"≤ {corners_kg_m2:.3g} kg·m², all its mass in the corners of its box",
            holds=largest_kg_m2 <= INERTIA_MARGIN * corners_kg_m2, otherwise=Verdict.WARNING,
            remedy=f"correct object.inertia_kg_m2, mass_kg or size_m; a solid box of these has {solid} kg·m²",
        ),
    ]  # fmt: skip
    return [found for found in findings if found.verdict is not Verdict.OK]


def _grasps(cell: Cell) -> list[Finding]:
    """Warn of grasps where the object's box is not."""
    half = np.array(cell.file.object.size_m) / 2.0
    beside = [float(np.linalg.norm(np.maximum(np.abs(a.entry.p_object_ee_m) - half, 0.0))) for a in cell.arms]
    return [
        warning(
            "grasp beside the object", arm.name, f"{m * 1e3:.3g} mm outside its box", f"≤ {BESIDE_BOX_M * 1e3:g} mm",
            "correct p_object_ee_m (object axes, from its centre), or object.size_m",
        )
        for arm, m in zip(cell.arms, beside, strict=True)
        if m > BESIDE_BOX_M
    ]  # fmt: skip


def _session(cell: Cell) -> list[Finding]:
    """Warn of steps that take minutes, and of joints that may be far from their path or never yield on it."""
    session = cell.file.session
    if session is None:
        return []
    slow = {key: getattr(session, key) for key in ("lift_s", "lower_s", "ease_s", "take_up_s", "start_blend_s")}
    found = [
        warning(
            f"session.{key}", "cell", f"{x:g} s", f"≤ {LONG_S:g} s", "seconds are meant; right where it is to crawl"
        )
        for key, x in slow.items()
        if x > LONG_S
    ]
    if session.off_max_rad > OFF_FAR_RAD:
        remedy = "an arm that is held up goes on that far: rad are meant; the default suits most cells"
        found.append(
            warning("session.off_max_rad", "cell", f"{session.off_max_rad:g} rad", f"≤ {OFF_FAR_RAD:g} rad", remedy)
        )
    if session.soft_rad >= session.off_max_rad:
        remedy = "a joint that is held up stops the arm before it yields: lower soft_rad"
        found.append(
            warning(
                "session.soft_rad",
                "cell",
                f"{session.soft_rad:g} rad",
                f"< off_max_rad, {session.off_max_rad:g}",
                remedy,
            )
        )
    return found


def _pushes(cell: Cell) -> list[Finding]:
    """Warn of pushes that push nothing, or as nobody does."""
    sizes = [(p.at_s, math.hypot(*p.force_N), math.hypot(*p.moment_Nm)) for p in cell.file.simulation.push]
    return [
        warning(
            "simulated push", "cell", f"{force:g} N, {moment:g} N·m at {at_s:g} s",
            f"above 0, up to {PUSH_MOST_N:g} N and {PUSH_MOST_NM:g} N·m", "give it force_N or moment_Nm as a hand has",
        )
        for at_s, force, moment in sizes
        if force == moment == 0.0 or force > PUSH_MOST_N or moment > PUSH_MOST_NM
    ]  # fmt: skip


def _judged(cell: Cell) -> list[Finding]:
    """Warn of a transient that no run of this length gets over."""
    transient_s, end_s = cell.file.report.transient_s, cell.file.duration_s
    if transient_s < end_s:
        return []
    remedy = "no error is judged: shorten report.transient_s, or let the run last longer"
    return [warning("report.transient_s", "cell", f"{transient_s:g} s", f"before the end, {end_s:g} s", remedy)]


def _befalls(cell: Cell) -> list[Finding]:
    """Warn of what is to befall the cell after the end of its run, and of faults of one arm at one instant."""
    simulation, end_s = cell.file.simulation, cell.file.duration_s
    planned = [("push", one.at_s) for one in simulation.push] + [("opening", one.at_s) for one in simulation.opening]
    planned += [("fault", one.at_s) for one in simulation.fault]
    twice = Counter((one.arm, one.at_s) for one in simulation.fault)
    return [
        warning(
            "simulated fault", arm, f"{count} at {at_s:g} s", "one at a time",
            "which of them shows is left to chance: let them come one after the other",
        )
        for (arm, at_s), count in twice.items()
        if count > 1
    ] + [
        Finding(
            f"simulated {what}", "cell", f"at {at_s:g} s", f"before the end, {end_s:g} s", Verdict.WARNING,
            "it does not happen: let it come earlier, or the run last longer",
        )
        for what, at_s in planned
        if at_s >= end_s
    ]  # fmt: skip


def _direction(unit: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    """A world axis with its sign, or the three components."""
    k = int(np.argmax(np.abs(unit)))
    if abs(unit[k]) > 1.0 - 1e-9:
        return f"{'+' if unit[k] > 0.0 else '−'}{'xyz'[k]}"
    return "[" + ", ".join(f"{x:.3f}" for x in unit) + "]"


def _shares(cell: Cell) -> list[Finding]:
    total = math.fsum(a.entry.load_share for a in cell.arms)
    findings = [judged("sum of load shares", "cell", f"{total:.6f}", "1", holds=abs(total - 1.0) < 1e-9, remedy="")]
    for arm in cell.arms:
        if arm.entry.load_share == 0.0:
            findings.append(
                judged(
                    "load share", arm.name, "0", "above 0", holds=False, otherwise=Verdict.WARNING,
                    remedy="allowed, but this arm carries nothing and does not pull the object towards its path",
                )
            )  # fmt: skip
    return findings


def _guards(cell: Cell) -> list[Finding]:
    """A guard against lost neighbours and grasps that is so wide that the object is lost first."""
    safety = cell.file.safety
    guards = (
        ("tracking_error_max_m", safety.tracking_error_max_m, GUARD_WIDE_M),
        ("tracking_error_max_rad", safety.tracking_error_max_rad, GUARD_WIDE_RAD),
    )
    return [
        judged(
            key, "cell", f"{value:g}", f"≤ {wide:g}", holds=False, otherwise=Verdict.WARNING,
            remedy="what [safety.noticing] does not feel of a neighbour that fails is noticed by this error only; the "
            "default suits most cells",
        )
        for key, value, wide in guards
        if value > wide
    ]  # fmt: skip


def _ports(cell: Cell) -> list[Finding]:
    """Ports of several arms: refused where servos move two of one stated host, fine on hosts that all differ."""
    arms = defaultdict[str, list[Arm]](list)
    for arm in cell.arms:
        if arm.entry.dynamixel is not None:
            arms[arm.entry.dynamixel.port].append(arm)
    return [_shared_port(cell, port, sharing) for port, sharing in arms.items() if _may_meet(sharing)]


def _may_meet(arms: Sequence[Arm]) -> bool:
    """Whether two of these may be on one host; an arm that states none may be on any."""
    hosts = [arm.entry.host for arm in arms]
    return len(hosts) > 1 and (None in hosts or len(set(hosts)) < len(hosts))


def _shared_port(cell: Cell, port: str, sharing: Sequence[Arm]) -> Finding:
    real = [arm for arm in sharing if cell.file.driver is DriverKind.DYNAMIXEL or arm.name in cell.file.looped]
    for host, count in Counter(arm.entry.host for arm in real).items():
        if host is not None and count > 1:
            names = " and ".join(arm.name for arm in real if arm.entry.host == host)
            return refused(
                "port", names, f"{port} on host {host}", "one for each arm of a host",
                "name the port of each; or correct `host`, if they are on different ones",
            )  # fmt: skip
    return warning(
        "port", " and ".join(arm.name for arm in sharing), port, "one for each arm",
        "right only where the arms are on different hosts (`host` says so); else name the port of each",
    )  # fmt: skip
