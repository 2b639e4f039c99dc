"""Whether the object was lost, when, and whose grasp was open: from the plant's rows, by the criterion of a study.

Where the object should be is the desired pose of the arms' rows: the trajectory's, and what an arm holds once it holds.
Once an arm hands the object over, in a session, nothing counts: it stands, and grasps are open because they may be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.log.columns import Table
from agent.modes import Mode
from agent.report.arithmetic import NAN, most
from agent.report.numbers import instant, number
from agent.report.quantity import Better, Unit
from agent.report.series import Array, PoseSeries, attitude_error, column, component, rotation_angle
from agent.telemetry.row.event import Event, Level

if TYPE_CHECKING:
    from agent.report.prepared import Prepared

LOST_M: Final = 0.1  # an object so far from where it should be has been dropped or thrown
LOST_RAD: Final = 1.0
SLIPPED_M: Final = 1e-4  # a grasp that has slipped by less is not told of
SLIPPED_RAD: Final = 1e-3
PLANT: Final = "plant"  # who tells of a loss


def is_lost(off_m: Array | float, off_rad: Array | float) -> NDArray[np.bool_]:
    """Whether an object so far from where it should be, (k,) or one number, is lost; what is no number is not."""
    return np.asarray((np.asarray(off_m) > LOST_M) | (np.asarray(off_rad) > LOST_RAD))


@dataclass(frozen=True, slots=True)
class Loss:
    """What became of the object and its grasps during the motion, by the truth, on ticks of a hold too."""

    object_lost_s: Annotated[float, Unit("s", Better.NEITHER)]  # of the run, first row with it lost; NaN: never
    object_off_max_m: Annotated[float, Unit("m")]  # farthest from where it should be
    object_off_max_rad: Annotated[float, Unit("rad")]
    grasp_open_s: Mapping[str, float]  # of each arm whose grasp has opened, the first row with it open
    grasp_gap_max_m: Mapping[str, float]  # of each arm, while its grasp was closed: what gave way and what slipped
    grasp_slip_s: Mapping[str, float]  # of each arm whose grasp has slipped, the first row in which it had
    grasp_slip_max_m: Mapping[str, float]  # of each arm; it need not have opened
    grasp_slip_max_rad: Mapping[str, float]

    @property
    def lost(self) -> bool:
        """Whether the object was lost."""
        return not math.isnan(self.object_lost_s)

    @property
    def kept(self) -> bool:
        """Whether the object was kept, by the grasps of all arms."""
        return not self.lost and not self.grasp_open_s

    def lines(self) -> list[tuple[str, str, str]]:
        """What a person must be told, as name, figure and bound; open grasps in the order in which they opened."""
        opened = sorted(self.grasp_open_s.items(), key=lambda grasp: grasp[1])
        found = [("GRASP OPEN", f"{arm} from {instant(t)}", "none") for arm, t in opened]
        if self.lost:
            off = f"{number(self.object_off_max_m, 'm')}, {number(self.object_off_max_rad, 'rad')}"
            bound = f"≤ {number(LOST_M, 'm', digits=1)}, {number(LOST_RAD, 'rad', digits=1)}"
            found.insert(0, ("OBJECT LOST", f"from {instant(self.object_lost_s)}, off by {off}", bound))
        return found

    def slips(self) -> list[str]:
        """Which grasps have slipped, from when and how far, in the order in which they began."""
        return [
            f"{arm} from {instant(t)}, by {number(self.grasp_slip_max_m[arm], 'mm', 1e3)}, "
            f"{number(self.grasp_slip_max_rad[arm], 'mrad', 1e3)}"
            for arm, t in sorted(self.grasp_slip_s.items(), key=lambda grasp: grasp[1])
        ]


def loss_keys(loss: Loss | None) -> dict[str, Any]:
    """The keys of results.json that tell of it; null without the truth."""
    keys = {f.name: None if loss is None else getattr(loss, f.name) for f in fields(Loss)}
    return {"object_lost": None if loss is None else loss.lost, **keys}


@np.errstate(over="ignore", invalid="ignore")  # poses of a run that went astray: what is no number counts as none
def loss_of(run: Prepared) -> Loss | None:
    """What the plant's rows of the motion say; None without any that can be held against the arms'."""
    if run.true is None or run.grasps is None:
        return None
    until_s = _handed_over_s(run)
    carried, judged = run.grasps.t < until_s, run.true.t < until_s
    off_m, off_rad = (off[judged] for off in _off(run.true))
    lost = np.flatnonzero(is_lost(off_m, off_rad))
    t, largest = run.grasps.t[carried], dict[str, float]()
    slipped, slip_m, slip_rad = dict[str, float](), dict[str, float](), dict[str, float]()
    for i, arm in enumerate(run.info.arms):
        largest[arm.name] = most(component(run.grasps.plant, "contact_error_m", i)[carried])
        by_m, by_rad = (_slip(run.grasps.plant, name, i)[carried] for name in ("slip_m", "slip_rad"))
        slip_m[arm.name], slip_rad[arm.name] = most(by_m), most(by_rad)
        seen = (by_m > SLIPPED_M) | (by_rad > SLIPPED_RAD)
        if seen.any():
            slipped[arm.name] = float(t[np.argmax(seen)])
    lost_s = float(run.true.t[judged][lost[0]]) if len(lost) else NAN
    return Loss(lost_s, most(off_m), most(off_rad), opened_s(run), largest, slipped, slip_m, slip_rad)


def opened_s(run: Prepared) -> dict[str, float]:
    """The first row, s, with the grasp open of each arm whose grasp opened during the motion; nothing without a plant.

    Of a grasp that was never closed nothing is known.
    """
    found = dict[str, float]()
    if run.grasps is None:
        return found
    carried = run.grasps.t < _handed_over_s(run)
    for i, arm in enumerate(run.info.arms):
        is_open = np.isnan(component(run.grasps.plant, "contact_error_m", i)[carried])
        if is_open.any() and not is_open.all():
            found[arm.name] = float(run.grasps.t[carried][np.argmax(is_open)])
    return found


def told(run: Prepared) -> list[Event]:
    """The same as events, which nobody told during the run, by time; none without the truth."""
    loss = loss_of(run)
    if loss is None or run.grasps is None:
        return []
    found = [(t, Level.ERROR, f"the grasp of {name} is open") for name, t in loss.grasp_open_s.items()]
    found += [(t, Level.WARN, f"the grasp of {name} slips") for name, t in loss.grasp_slip_s.items()]
    found += [(loss.object_lost_s, Level.ERROR, "the object is lost")] if loss.lost else []
    t, utc_ns = run.grasps.t, run.grasps.plant["utc_ns"]
    return [
        Event(int(utc_ns[np.argmin(np.abs(t - when))]), PLANT, level, text, {"t": when})
        for when, level, text in sorted(found)
    ]


def _slip(plant: Table, name: str, arm: int) -> Array:
    """(k,) how far a grasp has slipped; NaN in rows of a release in which none could."""
    try:
        return component(plant, name, arm)
    except KeyError:
        return np.full(len(plant), NAN)


def _off(true: PoseSeries) -> tuple[Array, Array]:
    """How far the object is from where it should be, (k,) m and rad.

    An arm that cannot be commanded desires nothing; the object should then be where it last should.
    """
    wanted = np.asarray(np.isfinite(np.hstack([true.p_des, true.quat_des])).all(axis=1))
    last = np.maximum.accumulate(np.where(wanted, np.arange(len(wanted)), 0))
    off_m = np.asarray(np.linalg.norm(true.p - true.p_des[last], axis=1))
    return off_m, rotation_angle(attitude_error(true.quat_des[last], true.quat))


def _handed_over_s(run: Prepared) -> float:
    """When the first arm of a session gives the object back; infinite where none does."""
    first = math.inf
    for rows in run.rows.values():
        over = column(rows, "t")[rows["mode"] > Mode.FAULT]
        first = min([first, *over[:1].tolist()])
    return first
