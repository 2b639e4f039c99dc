"""What run.json says of a run, typed, for the report; for what is absent there is a note in its place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from agent.config.schema.driver import DriverKind
from agent.config.schema.fault import FaultKind
from agent.host.info import RUN_FILE
from drivers.interface import Refusal

if TYPE_CHECKING:
    from agent.log.read import AnyLog

_WORLD_AXES: Final = ("x", "y", "z")
# after these an arm follows nothing, and gives nothing up by itself
_STRUCK: Final = (FaultKind.LIMP, FaultKind.HOLD)


class Bounded(Enum):
    """The figures of a run that its cell file may bound; the values are the keys in run.json and results.json."""

    POSITION = "max_position_error_m"
    ATTITUDE = "max_attitude_error_rad"


@dataclass(frozen=True, slots=True)
class EstimateBounds:
    """Between which values an adaptive arm keeps its estimates: (lower, upper) per parameter, in the rows' order."""

    arm: tuple[tuple[float, float], ...]
    object: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class RunArm:
    """One arm of the run: names and limits, per controlled joint in the order of the rows; NaN where not known."""

    name: str
    model: str
    joints: tuple[str, ...]
    tau_stall_Nm: tuple[float, ...]
    tau_max_Nm: tuple[float, ...]
    load_share: float
    p_object_ee_m: (
        tuple[float, float, float] | None
    )  # grasp point in the object's frame, for moments of internal wrenches
    estimate_bounds: EstimateBounds | None = None  # adaptive runs


@dataclass(frozen=True, slots=True)
class Plane:
    """A plane of motion whose normal is a world axis: the axes in it, the axis out of it."""

    in_plane: tuple[int, int]
    normal: int
    sign: float  # of the normal along its axis

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of the two axes in the plane and of the normal."""
        a, b = self.in_plane
        return _WORLD_AXES[a], _WORLD_AXES[b], _WORLD_AXES[self.normal]


@dataclass(frozen=True, slots=True)
class RunInfo:
    """The run as its own file describes it.  `notes` says what was missing and what was assumed instead."""

    cell: str
    fingerprint: str
    driver: str
    controller: Mapping[str, Any]
    rate_hz: float
    duration_s: float
    transient_s: float
    plane: Plane | None
    arms: tuple[RunArm, ...]  # in the plant's order
    bounds: Mapping[Bounded, float]
    versions: Mapping[str, str]
    host: str
    notes: tuple[str, ...]
    reality: Mapping[str, Any] = field(
        default_factory=dict
    )  # what the simulated cell had against its file; empty: nothing
    befell: Mapping[str, str] = field(default_factory=dict)  # pushes, openings, faults of the simulated cell, in words
    struck_s: Mapping[str, float] = field(default_factory=dict)  # of arms that its faults let go limp or stop: when
    emulated: bool = False  # the servos of its driver were, beside a plant
    plane_normal: tuple[float, ...] | None = None  # (3,) of a cell that moves in a plane, any plane, world axes

    @property
    def ticks(self) -> int:
        """Control cycles in the run: those that begin at 0, 1/rate, … before the duration is over."""
        return round(self.duration_s * self.rate_hz)

    @property
    def adaptive(self) -> bool:
        """True when the run used the adaptive law."""
        return self.controller.get("kind") == "adaptive"

    def arm(self, name: str) -> RunArm:
        """Return the arm called `name`; raises KeyError for a name that the run does not have."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise KeyError(name)


def read_info(log: AnyLog) -> RunInfo:
    """Typed view of run.json; whatever it does not hold is taken from the rows and said in `notes`."""
    try:
        return _typed(log, log.run_info(), [])
    except Refusal as refusal:
        what = refusal.what
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
        what = f"{RUN_FILE} of {log.path} does not say what it should ({error!r})"
    return _typed(log, {}, [f"{what}: rate, duration and joint names are taken from the rows, no bound is known"])


def _typed(log: AnyLog, raw: dict[str, Any], notes: list[str]) -> RunInfo:
    rate_hz = _number(raw, "rate_hz", notes) or _rate_of(log)
    transient_s = _number(raw, "transient_s", notes)
    simulation = raw.get("simulation") or {}
    faults = [one for one in simulation.get("fault", []) if one["kind"] in _STRUCK]
    return RunInfo(
        cell=str(raw.get("cell", log.cell)),
        fingerprint=str(raw.get("fingerprint", "unknown")),
        driver=str(raw.get("driver", "unknown")),
        controller=dict(raw.get("controller", {"kind": "unknown"})),
        rate_hz=rate_hz,
        duration_s=_number(raw, "duration_s", notes) or _last_t(log) + 1.0 / rate_hz,
        transient_s=0.0 if transient_s is None else transient_s,
        plane=_plane(raw.get("plane_normal"), notes),
        arms=_arms(raw.get("arms", []), log, notes),
        bounds={b: float(raw["bounds"][b.value]) for b in Bounded if raw.get("bounds", {}).get(b.value) is not None},
        versions={str(k): str(v) for k, v in raw.get("versions", {}).items()},
        host=_one_line(raw.get("host", "unknown")),
        notes=tuple(notes),
        reality=dict(raw.get("reality") or {}),
        befell=_befell(simulation),
        struck_s={
            arm: min(float(one["at_s"]) for one in faults if one["arm"] == arm)
            for arm in dict.fromkeys(one["arm"] for one in faults)
        },
        emulated=raw.get("driver") == DriverKind.DYNAMIXEL.value and log.plant is not None,
        plane_normal=tuple(float(x) for x in raw["plane_normal"]) if raw.get("plane_normal") else None,
    )


def _befell(simulation: Mapping[str, Any]) -> dict[str, str]:
    """What the cell file has happen, one by one: its table and number, and its keys with their values."""
    return {
        f"{table} {number}": ", ".join(f"{key} {value}" for key, value in dict(entry).items())
        for table in ("push", "opening", "fault")
        for number, entry in enumerate(simulation.get(table, []), 1)
    }


def _number(raw: Mapping[str, Any], key: str, notes: list[str]) -> float | None:
    if raw.get(key) is None:
        if raw:
            notes.append(f"{RUN_FILE} has no {key}")
        return None
    number = float(raw[key])
    if not (math.isfinite(number) and number >= 0.0):
        raise ValueError(f"{key} is {number}")
    return number


def _rate_of(log: AnyLog) -> float:
    steps = [np.median(np.diff(rows["t"]) / np.diff(rows["sequence"])) for rows in log.agents.values() if len(rows) > 1]
    return float(1.0 / min(steps)) if steps else 1.0


def _last_t(log: AnyLog) -> float:
    return max((float(rows["t"][-1]) for rows in log.agents.values() if len(rows)), default=0.0)


def _plane(normal: list[float] | None, notes: list[str]) -> Plane | None:
    if normal is None:
        return None
    n = np.asarray(normal, dtype=float)
    axis = int(np.argmax(np.abs(n)))
    if abs(abs(n[axis]) - 1.0) > 1e-6:
        notes.append(f"the plane normal {normal} is no world axis: figures show all three axes")
        return None
    a, b = (i for i in range(3) if i != axis)
    return Plane((a, b), axis, float(np.sign(n[axis])))


def _arms(raw: list[dict[str, Any]], log: AnyLog, notes: list[str]) -> tuple[RunArm, ...]:
    arms = []
    for a in raw:
        joints = tuple(str(j) for j in a["joints"])
        unknown = [float("nan")] * len(joints)
        grasp = a.get("p_object_ee_m")
        arms.append(
            RunArm(
                name=str(a["name"]),
                model=str(a.get("model", "unknown")),
                joints=joints,
                tau_stall_Nm=tuple(float(v) for v in a.get("tau_stall_Nm", unknown)),
                tau_max_Nm=tuple(float(v) for v in a.get("tau_max_Nm", unknown)),
                load_share=float(a.get("load_share", "nan")),
                p_object_ee_m=None if grasp is None else (float(grasp[0]), float(grasp[1]), float(grasp[2])),
                estimate_bounds=_estimate_bounds(a.get("estimate_bounds")),
            )
        )
    described = {a.name for a in arms}
    for name, rows in log.agents.items():
        if name in described:
            continue
        count = int(rows["joint_count"][0]) if len(rows) else 0
        unknown_limits = (float("nan"),) * count
        joints = tuple(f"joint {i + 1}" for i in range(count))
        arms.append(RunArm(name, "unknown", joints, unknown_limits, unknown_limits, float("nan"), None))
        if raw:
            notes.append(f"{RUN_FILE} does not describe the arm {name}")
    return tuple(arms)


def _estimate_bounds(raw: Mapping[str, Any] | None) -> EstimateBounds | None:
    if raw is None:
        return None
    pairs = {key: tuple((float(low), float(up)) for low, up in raw[key]) for key in ("arm", "object")}
    return EstimateBounds(pairs["arm"], pairs["object"])


def _one_line(host: Any) -> str:
    if isinstance(host, Mapping):
        return ", ".join(f"{k} {v}" for k, v in host.items())
    return str(host)
