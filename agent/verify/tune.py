"""Gains for a cell: the stiffest that survive what reality may make of it, or those that keep the rigid cell damped.

REALITY searches by the criterion of `coop check` (agent.verify.stiffest), from the configured gains on, or from usual
ones where those are unstable, or so small that friction alone holds the cell, and say nothing of how much noise is
wanted.  The other two look at the rigid cell alone, also with the arms' inertia off, in two ways, because the paper has
one K where a sampled loop would rather have two:

- RATIO scales k_p and k_eps together with their forms in v̇_r;
- RATE leaves k_p and k_eps, which say how stiffly the object is held, and lowers only their forms in v̇_r, which are
  fed back through the believed inertia and are what a delay makes unstable first.

Where even small gains would not do, k_v alone is too much for the rate and is lowered too, rotation and translation
apart, because the same number means far more for the small rotational inertia than for the mass.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from agent.config import observer
from agent.config.cell import Cell, ConfigError, cell_from_toml
from agent.config.edit import Change, apply
from agent.config.schema.controller import ControllerKind
from agent.control.errors import Gains
from agent.control.estimator import Observer
from agent.verify.adaptive import examine_adaptation
from agent.verify.along import instants, walk
from agent.verify.binding import Binding, Stated, binding
from agent.verify.chatter import Shaking
from agent.verify.criterion.cases import Loop
from agent.verify.criterion.examine import STABLE, Criterion, examine
from agent.verify.lowering import descend, k_v_factors
from agent.verify.margin import Damping, Place, damping, damping_at, places, sampled_loop
from agent.verify.proposed import changed
from agent.verify.robustness import Walk, loop_of, poses, ranges_of
from agent.verify.scale import Scale, rounded_down
from agent.verify.stiffest import Search, Wanted, scaled
from agent.verify.tune_refusal import NoGains, less, looked_at, none_found, stating, too_late
from agent.verify.usual_gains import usual_loop
from drivers.interface import Vector

POSE_MAX: Final = 2.0  # k_p and k_eps are not proposed above this, relative to the configured ones
POSE_FLOORS: Final = (0.5, 0.1)  # nor below the first, unless no k_v keeps the margin with them, nor ever the second
RATE_RANGE: Final = (0.05, 1.0)
SLOW_S: Final = 4.0  # time constant without friction, above which gains are of no use (2.2 of the cells that ship)
ELSEWHERE: Final = 0.9  # of the largest adaptation gains at these places, for others


class Form(enum.StrEnum):
    """Which gains may change."""

    REALITY = "reality"
    RATIO = "ratio"
    RATE = "rate"


RIGID = (Form.RATIO, Form.RATE)


@dataclass(frozen=True, slots=True)
class Margin:
    """What a proposal keeps, for the nominal inertia and for the stated error of it."""

    radius: float = 0.999  # at most
    damping: float = 0.05  # at least, of every mode that swings: each swing then takes a quarter off
    worst: float = 0.985  # largest radius of all that reality may make of the cell, of REALITY

    def kept_by(self, found: Damping) -> bool:
        """Whether it is kept."""
        return found.radius <= self.radius and found.ratio >= self.damping


@dataclass(frozen=True)
class GainSet:
    """Gains of a cell and what the sampled loop makes of them."""

    cell: Cell
    damping: Mapping[float, Damping]  # by the error of the arms' inertia
    noise_Nm: tuple[float, ...]  # per arm: largest rms joint torque that the grids of measured angle and velocity cause
    criterion: Criterion

    @property
    def gains(self) -> Gains:
        """Of the first arm; k_p and k_eps are those of all."""
        return self.cell.offline(self.cell.arms[0]).gains

    @property
    def observer(self) -> Observer | None:
        """Of every arm, where there is one."""
        return observer.build(self.cell.file)

    @property
    def slowest_s(self) -> float:
        """Time constant of the slowest mode with the nominal inertia, s."""
        return self.damping[0.0].time_constant_s(1.0 / self.cell.file.rate_hz)

    @property
    def useless(self) -> bool:
        """Whether these say nothing of how much noise is wanted: unstable, or held by little else than friction."""
        return self.criterion.radius >= STABLE or self.slowest_s > SLOW_S


@dataclass(frozen=True)
class Proposal:
    """Gains to take instead of the configured ones."""

    form: Form
    before: GainSet
    after: GainSet
    changes: tuple[Change, ...]
    from_usual: bool = False  # whether the search began with usual gains

    def toml(self) -> str:
        """The whole cell file with these gains."""
        return self.after.cell.toml.decode()


class Tuner:
    """One cell, its inertia along the trajectory computed once."""

    def __init__(self, cell: Cell) -> None:
        """Raise ConfigError where a grasp cannot be reached along the trajectory."""
        self.cell = cell
        self._models = [cell.model(arm) for arm in cell.arms]
        self._along = walk(cell, self._models)
        self._places: tuple[Place, ...] = places(cell, self._models, self._along)
        self._cases = [(true, place.believed) for place in self._places for true in place.true.values()]
        self._offline = [cell.offline(arm) for arm in cell.arms]
        self._gains = [o.gains for o in self._offline]
        self._shaking = [[self._shaken(i, q[i]) for q in self._along] for i in range(len(cell.arms))]
        self._poses = poses(Walk(cell, self._models, self._along, ()))
        self._configured: GainSet | None = None

    def configured(self) -> GainSet:
        """The gains as the cell file has them, examined once."""
        if self._configured is None:
            self._configured = self._examined(self.cell)
        return self._configured

    def propose(self, form: Form, margin: Margin) -> Proposal:
        """The largest gains of this form that keep the margin.  Raises NoGains."""
        if form is Form.REALITY:
            begin, usual = self._begin()
            return self._proposal(form, self._stiffest(margin, begin), from_usual=usual)
        for floor, (linear, angular) in itertools.product(POSE_FLOORS, k_v_factors()):
            found = self._largest(form, margin, floor, Scale(k_v_linear=linear, k_v_angular=angular))
            if found is not None:
                return self._proposal(form, scaled(loop_of(self.cell), found))
        raise NoGains(
            f"gains for {self.cell.file.name} at {self.cell.file.rate_hz:g} Hz",
            found="none, however small",
            expected=f"a spectral radius of at most {margin.radius:g} and a damping of at least {margin.damping:g}",
            remedy="raise rate_hz, lower inertia_error, or ask for less damping",
        )

    def proposals(self, margin: Margin, forms: Sequence[Form] = RIGID) -> list[Proposal]:
        """One of each form that has one.  Raises NoGains when none has."""
        found: list[Proposal] = []
        refusal: NoGains | None = None
        for form in forms:
            try:
                found.append(self.propose(form, margin))
            except NoGains as error:
                refusal = error
        if refusal is not None and not found:
            raise refusal
        return found

    def _proposal(self, form: Form, loop: Loop, *, from_usual: bool = False) -> Proposal:
        changes = tuple(changed(self.cell, loop.gains, loop.observer))
        proposed = self._with(changes)
        slower = tuple(self._slower_to_learn(proposed))
        if slower:
            changes += slower
            proposed = self._with(changes)
        return Proposal(form, self.configured(), self._examined(proposed), changes, from_usual)

    def _with(self, changes: Sequence[Change]) -> Cell:
        text = apply(self.cell.toml.decode(), changes)
        return cell_from_toml(text.encode(), f"the gains proposed for {self.cell.file.name}")

    def _slower_to_learn(self, proposed: Cell) -> Iterator[Change]:
        """Adaptation gains that `coop check` finds too large beside these gains, as large as they may be."""
        if proposed.file.controller.kind is not ControllerKind.ADAPTIVE:
            return
        spec = proposed.file.controller.adaptive
        most = examine_adaptation(proposed, self._models, self._along, instants(self.cell))
        for key, value, limit in (
            ("gamma", spec.gamma, most.gamma_max), ("gamma_object", spec.gamma_object, most.gamma_object_max)
        ):  # fmt: skip
            if value > ELSEWHERE * limit:
                yield Change("controller.adaptive", key, f"{rounded_down(ELSEWHERE * limit)!r}")

    def _begin(self) -> tuple[Loop, bool]:
        """Where the search of REALITY begins, and whether that is with usual gains."""
        own, usual = loop_of(self.cell), self.configured().useless
        return (usual_loop(self.cell, own) if usual else own), usual

    def _wanted(self, margin: Margin, loop: Loop) -> Wanted:
        L = self.cell.file.safety.noticing.rate_per_s
        return Wanted(margin.worst, self._noise_against(loop), math.exp(-L * loop.period_s))

    def _stiffest(self, margin: Margin, loop: Loop) -> Loop:
        """By the criterion of `coop check`, no noisier than this loop.  Raises NoGains, naming what binds."""
        cell, stated = self.cell, ranges_of(self.cell)
        ranges, wanted, tried = looked_at(stated), self._wanted(margin, loop), partial(_tried, self.cell, margin)
        found = Search(self._poses, loop, ranges, wanted).run()
        if found.kept and ranges != stated:
            shorter = {"tolerance.delay": ranges}
            raise too_late(cell, stated, ranges, less(cell, Binding(() if tried(shorter) else (shorter,))))
        if found.kept:
            return scaled(loop, found.scale)
        inertia = "tolerance.masses" if cell.tolerance.masses >= ranges.inertia_error else "safety.inertia_error"
        binds = binding(self._poses, scaled(loop, found.scale), ranges, wanted, inertia, tried)
        raise none_found(cell, found, margin.worst, less(cell, binds))

    def missed(self, margin: Margin) -> float:
        """Radius that the search of REALITY comes to where it finds nothing; 0 where it finds some, inf without one."""
        ranges, (begin, _) = ranges_of(self.cell), self._begin()
        if looked_at(ranges) != ranges:
            return math.inf
        found = Search(self._poses, begin, ranges, self._wanted(margin, begin)).run()
        return 0.0 if found.kept else found.worst.radius

    def _shaken(self, arm: int, q: Vector) -> Shaking:
        viscous = np.array([servo.viscous_Nm_s_per_rad.value for servo in self.cell.arms[arm].servos])
        return Shaking(self._models[arm], self._offline[arm], viscous, q)

    def _noise_against(self, own: Loop) -> Callable[[Loop], float]:
        """Torque noise of a loop relative to that of another, of each arm where it is largest with the other."""
        loudest = [
            max(((s.torque_Nm(g, own.observer), s) for s in where), key=lambda each: each[0])
            for g, where in zip(own.gains, self._shaking, strict=True)
        ]

        def noise(loop: Loop) -> float:
            each = zip(loop.gains, loudest, strict=True)
            return max(s.torque_Nm(gains, loop.observer) / quiet for gains, (quiet, s) in each)

        return noise

    def _torque_noise(self, loop: Loop) -> tuple[float, ...]:
        """Of each arm the largest along the trajectory, N·m."""
        each = zip(loop.gains, self._shaking, strict=True)
        return tuple(max(s.torque_Nm(gains, loop.observer) for s in where) for gains, where in each)

    def _largest(self, form: Form, margin: Margin, floor: float, base: Scale) -> Scale | None:
        def keeps(scale: Scale) -> bool:
            return self._keeps([scale.of(g) for g in self._gains], margin)

        if form is Form.RATIO:
            pose = descend(lambda x: keeps(replace(base, pose=x)), floor, POSE_MAX)
            return None if pose is None else replace(base, pose=pose)
        for pose in (1.0, 0.7, floor):
            at = replace(base, pose=pose)
            rate = descend(lambda x, at=at: keeps(replace(at, rate=x)), *RATE_RANGE)  # type: ignore[misc]
            if rate is not None:
                return replace(at, rate=rate)
        return None

    def _keeps(self, gains: Sequence[Gains], margin: Margin) -> bool:
        """Whether the margin is kept everywhere; begins where it was missed last, which is where it will be again."""
        loop, P = sampled_loop(self.cell, gains), self._models[0].task_basis
        for i, (true, believed) in enumerate(self._cases):
            if not margin.kept_by(damping_at(true, believed, P, loop)):
                self._cases.insert(0, self._cases.pop(i))
                return False
        return True

    def _examined(self, cell: Cell) -> GainSet:
        loop, P = loop_of(cell), self._models[0].task_basis
        found = examine(self._poses, loop, ranges_of(cell))
        rigid = damping(self._places, P, sampled_loop(cell))
        return GainSet(cell, rigid, self._torque_noise(loop), found)


def _tried(cell: Cell, margin: Margin, stated: Stated) -> float:
    """What `coop tune` comes to with the cell that states this: Tuner.missed."""
    try:
        return Tuner(stating(cell, stated)).missed(margin)
    except ConfigError:  # it may not be stated
        return math.inf
