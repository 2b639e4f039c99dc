"""From a wish to a cell file that `coop check` accepts, or to the demand that cannot be met."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from agent.config.cell import Cell, cell_from_toml, load_arm_file, placement
from agent.config.embed import embed, without_files
from agent.config.files import load_own_arm_file
from agent.config.tables import tables
from agent.make.place import HEIGHTS_M, RADII_M, Bend, base, bends, grasp
from agent.make.wish import ArmWish, MotionKind, Wish, WishError
from agent.make.write import Placed, cell_text, duration_s
from agent.verify.check import CheckReport, examine, reach
from agent.verify.collision.findings import collisions
from agent.verify.finding import Finding, Verdict
from agent.verify.session import not_gripped
from agent.verify.tune import Form, Margin, Tuner
from agent.verify.tune_refusal import NoGains
from drivers.dynamixel.servo.models import SERVOS

IN_PLANE: Final = ("shoulder", "elbow", "wrist_angle")
SPATIAL_JOINTS: Final = 6
SAMPLES: Final = 5  # of the motion, while places are sought
RANKED: Final = 3  # places of each arm that are tried together
COMFORTABLE: Final = 0.8  # with which no other height is sought


Base = tuple[float, float, float, float]


@dataclass(frozen=True)
class Made:
    """A cell that `coop check` accepts."""

    text: str
    cell: Cell
    report: CheckReport
    tuned: bool

    @property
    def warnings(self) -> list[Finding]:
        """What the check warns of, and what real grippers could not hold."""
        return [f for f in self.report.findings if f.verdict is Verdict.WARNING]


@dataclass(frozen=True)
class _Place:
    """An arm on a base, bent in one way."""

    base: Base
    bend: Bend


class Maker:
    """One wish.  Raises WishError for what its words alone rule out."""

    def __init__(self, wish: Wish, tell: Callable[[str], None] = lambda _: None) -> None:
        self._wish, self._tell = wish, tell
        files = [
            load_arm_file(arm.model, f"model of arm {arm.name}")[0]
            if arm.arm_file is None
            else load_own_arm_file(arm.arm_file)
            for arm in wish.arms
        ]
        joints = [[j.name for j in file.joints if SERVOS[j.servo].modes] for file in files]
        self._spatial = all(len(names) >= SPATIAL_JOINTS for names in joints)
        self._joints = [tuple(names) if self._spatial else IN_PLANE for names in joints]
        self._refuse_other_names([{j.name for j in file.joints} for file in files])
        self._locked = [
            tuple(j.name for j in file.joints if j.name not in names)
            for file, names in zip(files, self._joints, strict=True)
        ]
        self._refuse_out_of_plane()
        self._shares = _shares(wish.arms)
        self._grasps = [grasp(arm, wish.object.size_m, self._spatial) for arm in wish.arms]

    def make(self, *, tune: bool = True) -> Made:
        """The cell.  Raises WishError, or ConfigError where its numbers cannot be meant."""
        self._tell("looking for bases, heights and joint angles")
        text, cell = self._placed()
        self._tell("examining the cell")
        report = self._examined(cell, gains_stay=not tune)
        if tune:
            self._tell("looking for gains")
            try:
                text = Tuner(cell).propose(Form.REALITY, Margin()).toml()
            except NoGains as error:
                raise WishError(
                    "gains for this cell", found=error.found, expected=error.expected, remedy=error.remedy
                ) from error
            cell = self._loaded(text)
            report = self._examined(cell, gains_stay=True)
        return Made(without_files(text), cell, replace(report, findings=(*report.findings, *not_gripped(cell))), tune)

    def _examined(self, cell: Cell, *, gains_stay: bool) -> CheckReport:
        """What the check says.  Raises WishError with its first refusal, one that gains may mend if they stay."""
        report = examine(cell, wired=True, thorough=True)
        for f in report.findings:
            if f.verdict is Verdict.REFUSED and (gains_stay or not f.by_gains):
                remedy = "leave out --no-tune, or give a higher --rate" if f.by_gains else f.remedy
                raise WishError(f"{f.what} ({f.where})", found=f.found, expected=f.wanted, remedy=remedy)
        return report

    def _placed(self) -> tuple[str, Cell]:
        """The most comfortable arrangement whose bodies keep apart.  Raises WishError with what is lacking."""
        wish, best = self._wish, ""
        heights = HEIGHTS_M if wish.height_m is None else (wish.height_m,)
        ranked: list[tuple[float, float, tuple[_Place, ...]]] = []
        for height in heights:
            each = [self._ranked(i, height) for i in range(len(wish.arms))]
            lacking = [f"{arm.name}: {p[0].bend.lacks}" for arm, p in zip(wish.arms, each, strict=True) if not _fit(p)]
            if lacking:
                best = best or "; ".join(lacking)
                continue
            combined = itertools.product(*(p[:RANKED] for p in each))
            ranked += [(min(p.bend.comfort for p in places), height, places) for places in combined]
            if max(comfort for comfort, _, _ in ranked) >= COMFORTABLE:
                break
        if not ranked:
            raise WishError(
                f"arms of {wish.name}", found=best, expected="arms that hold the object along the motion", remedy=
                "take a lighter object, more or stronger arms, a smaller motion, another face, height or base",
            )  # fmt: skip
        ranked.sort(key=lambda found: (-found[0], -sum(place.bend.comfort for place in found[2])))
        return self._apart(ranked)

    def _apart(self, ranked: Sequence[tuple[float, float, tuple[_Place, ...]]]) -> tuple[str, Cell]:
        first: Finding | None = None
        for _, height, places in ranked[: RANKED ** len(self._wish.arms)]:
            text, cell = self._cell(height, places)
            refused = [f for f in _near(cell) if f.verdict is Verdict.REFUSED]
            if not refused:
                return text, cell
            first = first or refused[0]
        assert first is not None
        raise WishError(
            f"{first.what} ({first.where})", found=first.found, expected=first.wanted, remedy=
            "hold other faces, or farther out (inset), make the motion smaller, or give height and bases",
        )  # fmt: skip

    def _ranked(self, i: int, height: float) -> list[_Place]:
        """Places of one arm, the most comfortable first; there is one at least, which may not do."""
        wish = self._wish.arms[i]
        bases = [wish.base] if wish.base is not None else [base(self._grasps[i], wish.face, r) for r in RADII_M]
        found = []
        for at in bases:
            _, cell = self._cell(height, None, {i: at})
            poses = [placement(d.p, d.quat) for d in map(cell.trajectory().at, _times(self._wish))]
            found += [_Place(at, bend) for bend in bends(cell, cell.arms[i], poses)[:2]]
        if not found:
            found = [_Place(bases[0], Bend(np.zeros(len(self._joints[i])), -1.0, "the grasp is out of reach"))]
        return sorted(found, key=lambda place: -place.bend.comfort)

    def _cell(
        self,
        height: float,
        places: Sequence[_Place] | None,
        at: Mapping[int, Base] | None = None,
    ) -> tuple[str, Cell]:
        arms = []
        for i, wish in enumerate(self._wish.arms):
            q = np.zeros(len(self._joints[i])) if places is None else places[i].bend.q
            stands = places[i].base if places is not None else (at or {}).get(i) or (0.0, 0.0, 0.0, 0.0)
            controlled, locked = self._joints[i], self._locked[i]
            arms.append(Placed(wish, controlled, locked, stands, self._grasps[i], q, self._shares[i]))
        text = cell_text(self._wish, height, arms, spatial=self._spatial)
        return text, self._loaded(text)

    def _loaded(self, text: str) -> Cell:
        """The cell of this text, with the files that it names in it."""
        path, raw = self._wish.folder / f"{self._wish.name}.toml", text.encode()
        return cell_from_toml(embed(raw, tables(text), path), path.name)

    def _refuse_other_names(self, named: Sequence[set[str]]) -> None:
        for arm, joints in zip(self._wish.arms, named, strict=True):
            lacking = [] if self._spatial else [joint for joint in IN_PLANE if joint not in joints]
            if lacking:
                raise WishError(
                    f"arm {arm.name}, a {arm.model}", found=f"no joint {' or '.join(lacking)}",
                    expected=f"{', '.join(IN_PLANE)}, which move in a plane, or {SPATIAL_JOINTS} joints with torque",
                    remedy="name its joints so, in arm file and URDF",
                )  # fmt: skip

    def _refuse_out_of_plane(self) -> None:
        if self._spatial:
            return
        wish = self._wish
        models = ", ".join(dict.fromkeys(arm.model for arm in wish.arms))
        faces = [arm.face for arm in wish.arms if arm.face not in ("-x", "+x") and arm.pose is None]
        moves = [wish.motion.by_m, *(p for _, p in wish.motion.points)]
        if faces or len(wish.arms) > 2:
            raise WishError(
                f"arms of {wish.name}", found=f"{len(wish.arms)} arms at {', '.join(a.face for a in wish.arms)}",
                expected=f"at most two, at -x and +x: with {models} among them all move in the plane of x and z",
                remedy="leave arms out, or take arms with six joints",
            )  # fmt: skip
        if any(y for _, y, _ in moves):
            raise WishError(
                f"motion of {wish.name}", found="a part along y", expected=f"x and z alone: {models} move in a plane",
                remedy="leave it out, or take arms with six joints",
            )  # fmt: skip


def _fit(places: Sequence[_Place]) -> bool:
    return places[0].bend.comfort > 0.0


def _shares(arms: Sequence[ArmWish]) -> list[float]:
    """Load shares that sum to 1: those given, and equal ones of what they leave."""
    given = [arm.share for arm in arms if arm.share is not None]
    open_ones, left = len(arms) - len(given), 1.0 - sum(given)
    if left < -1e-9 or (not open_ones and abs(left) > 1e-9):
        raise WishError(
            "load shares", found=f"a sum of {sum(given):g}", expected="1", remedy="correct share=, or leave it out"
        )
    return [max(left, 0.0) / open_ones if arm.share is None else arm.share for arm in arms]


def _times(wish: Wish) -> list[float]:
    """Instants of the motion at which an arm is judged, the start first."""
    if wish.motion.kind is MotionKind.WAYPOINTS:
        ends = [0.0, *(t for t, _ in wish.motion.points)]
        return sorted({*ends, *np.linspace(0.0, ends[-1], SAMPLES).tolist()})
    times: list[float] = np.linspace(0.0, 0.5 * duration_s(wish.motion), 2 * SAMPLES - 1).tolist()
    return times


def _near(cell: Cell) -> list[Finding]:
    """What `coop check` will say of distances."""
    models, end = [cell.model(arm) for arm in cell.arms], min(cell.trajectory().period_s, cell.file.duration_s)
    times = np.linspace(0.0, end, 24).tolist()
    paths = []
    for arm, model in zip(cell.arms, models, strict=True):
        q, path = np.array(arm.entry.q_near_rad), []
        for t in times:
            desired = cell.trajectory().at(t)
            q = reach(arm, model, placement(desired.p, desired.quat), q, f"at t = {t:.2f} s")
            path.append(q)
        paths.append(path)
    return collisions(cell, models, paths, times)
