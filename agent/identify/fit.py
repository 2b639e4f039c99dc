"""Least squares of base parameters on a recording, with standard errors and a held-out part.

What is left over is not white: it comes from grids, and from what the model leaves out.  So the standard errors are
those of sums over whole blocks of time (cluster-robust), and for the model they have the distances by which an estimate
moves with a slower and a faster low-pass, and when the loop's delay does by its own standard error.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.control.models import ArmModel
from agent.identify.columns import Base, base_of, described_parameters
from agent.identify.delay import Delay
from agent.identify.equations import BLOCKS_MIN, Motion, Options, equations, too_short
from agent.identify.friction import CERTAIN, LOAD, SHAPES, Choice, Shape, Term, choose, clearly_larger
from agent.identify.joint import LONGEST_PERIODS, Found, joined_with, together
from agent.identify.recording import IdentifyError, Recording
from agent.identify.scales import Scales, in_one_unit, in_own_units, of_own_units, one_unit, scales_of
from agent.identify.solve import BLOCK_S, Part, least_squares
from drivers.interface import Vector

Matrix = NDArray[np.float64]

OTHER_CUTOFF: Final = 0.6  # the second low-pass, relative to the first
DELAY_ROUNDS: Final = 3
CONDITION_CHOICE: Final = 1e4  # of the columns of a friction model that is tried
EXPONENTS: Final = (1.0, 2.0)
BESIDE: Final = 0.002  # of an estimate: what no model of the arm has in it, as runs of known truth showed
USED_MIN: Final = 0.03  # share of the time that each joint moves fast enough, in each direction


@dataclass(frozen=True)
class Fit:
    """Base parameters of an arm, and how well they predict what they have not seen."""

    base: Base
    value: Vector  # (b,)
    sigma: Vector  # (b,) standard errors
    described: Vector  # (b,) the same combinations by URDF and arm file
    condition: float  # of the columns, each scaled to unit length
    used: Vector  # (n,) share of the time that each joint's equation is used
    held_out: Part
    residual: Vector  # (n,) rms on the held-out part, N·m
    residual_described: Vector  # (n,) with the described parameters
    torque: Vector  # (n,) rms of the torque itself
    choice: Choice  # of the friction model
    speed_sigma: float  # standard error of its Stribeck velocity, rad/s
    sticking: tuple[Term, ...]  # (key of the arm file, joint) of the last of `value`, behind the base's
    delay: Delay | None  # of the loop
    scales: Scales  # of the joints' torques


def fit(recording: Recording, options: Options) -> Fit:
    """Identify the arm, with the believed delay of the loop unless another one is found beyond doubt, then with that.

    Raises IdentifyError when the motion excites it too little.
    """
    found = _fit(recording, options)
    for _ in range(DELAY_ROUNDS):
        if found.delay is None or found.delay.is_taken:
            break
        again = _fit(recording.delayed(found.delay.value_s), options)
        if again.delay is None:
            break
        found = replace(again, delay=again.delay._replace(believed_s=recording.delay_s))
    return found


def _fit(recorded: Recording, options: Options) -> Fit:
    """Identify the arm with the delay that the recording says."""
    model = recorded.cell.model(recorded.arm)
    base, motion = base_of(model), Motion.of(recorded, options)
    whole = equations(recorded, model, base, options)
    train, _ = _split(whole, options.held_out)
    _refuse_too_little(train, base, recorded, options)
    scales = scales_of(train, motion, base)
    recording, whole = one_unit(recorded, scales.taken), in_one_unit(whole, motion, scales.taken)
    motion = replace(motion, recording=recording)
    train, held_out = _split(whole, options.held_out)
    condition = least_squares(train)[2]
    choice = _chosen(train, motion)
    filtered = _others(recording, model, base, options)
    delay = _delay((train, motion), filtered[:1], choice)  # noise lets it move much with a faster one
    sticking, found, moved_by_terms = _certain(train, motion, choice)
    choice = choice._replace(shape=found.shape)
    others = [together(*other, sticking, found.shape, recording.delay_s) for other in filtered]
    off_s = recording.period_s if delay is None else max(abs(delay.value_s - delay.taken_s), delay.sigma_s)
    others.append(together(train, motion, sticking, found.shape, recording.delay_s + off_s))
    moved = [moved_by_terms, BESIDE * found.value, *(one.value - found.value for one in others)]
    held_out = joined_with(held_out, motion, sticking, choice.shape, slice(-len(held_out.t), None))
    described = np.concatenate(
        [base.combination @ described_parameters(recording.arm, model), _described(recording, sticking)]
    )
    by = in_own_units(scales.taken, base, sticking)
    held_out, value = of_own_units(held_out, scales.taken, by), by * found.value
    return Fit(
        base=base,
        value=value,
        sigma=by * np.sqrt(found.sigma**2 + sum(m**2 for m in moved)),
        described=described,
        condition=condition,
        used=train.used.mean(axis=0),
        held_out=held_out,
        residual=_rms(held_out, value),
        residual_described=_rms(held_out, described),
        torque=_rms(held_out, np.zeros_like(value)),
        choice=choice,
        speed_sigma=math.hypot(found.speed_sigma, *(one.speed - found.speed for one in others)),
        sticking=sticking,
        delay=delay,
        scales=scales,
    )


def _others(recording: Recording, model: ArmModel, base: Base, options: Options) -> list[tuple[Part, Motion]]:
    """Training data of a slower and of a faster low-pass, of which a short motion may leave too little."""
    found = []
    for by in (OTHER_CUTOFF, 1.0 / OTHER_CUTOFF):
        other = replace(options, cutoff_hz=by * options.cutoff_hz)
        part, _ = _split(equations(recording, model, base, other), options.held_out)
        try:
            least_squares(part)
        except IdentifyError:
            continue
        found.append((part, Motion.of(recording, other)))
    return found


def _chosen(train: Part, motion: Motion) -> Choice:
    """The friction model, whatever the loop's delay is: that is one more column of each candidate."""
    rate = motion.rate(motion.recording.delay_s)[: len(train.t), :, None]
    columns = np.concatenate([train.columns, rate], axis=2)
    friction = motion.friction(SHAPES).some(slice(len(train.t)))
    return choose(columns, train.tau, train.used, friction, CONDITION_CHOICE)


def _explained(
    part: Part, motion: Motion, keys: Sequence[str], shape: Shape | None, delay_s: float | None
) -> list[Found]:
    """What explains the part with these terms of every joint: the best first, then what is as good."""
    terms = tuple(itertools.product(keys, range(part.tau.shape[1])))
    shapes = [None] if shape is None else [Shape(shape.stribeck_rad_per_s, p) for p in EXPONENTS]
    tried = [together(part, motion, terms, one, delay_s) for one in shapes]
    weight = 1.0 / tried[0].squares.mean(axis=0)
    scores = [found.squares @ weight for found in tried]
    first = min(range(len(tried)), key=lambda i: float(scores[i].mean()))
    rest = [tried[i] for i in range(len(tried)) if i != first and not clearly_larger(scores[i], scores[first])]
    return [tried[first], *rest]


def _certain(train: Part, motion: Motion, choice: Choice) -> tuple[tuple[Term, ...], Found, Vector]:
    """The chosen terms that are known well, joint by joint, what is found with them, and how far that may be off.

    That is how far it moves with the other exponent, where that is as good, and with the terms that are left out.
    """
    delay_s = motion.recording.delay_s
    all_found, *rivals = _explained(train, motion, choice.keys, choice.shape, delay_s)
    n, b = train.tau.shape[1], train.columns.shape[2]
    sticking = tuple(itertools.product(choice.keys, range(n)))
    moved2 = sum(((rival.value - all_found.value) ** 2 for rival in rivals), np.zeros_like(all_found.value))
    kept, found = list(range(b + len(sticking))), all_found
    while sticking:
        own = slice(b, None)
        sigma = np.sqrt(found.sigma[own] ** 2 + moved2[kept][own])
        unsure = sigma / np.where(found.value[own] > 0.0, found.value[own], 1e-300)
        falling = [key != LOAD for key, _ in sticking]
        unsure[falling] = np.maximum(unsure[falling], found.speed_sigma / max(found.speed, 1e-300))
        if unsure.max() <= CERTAIN:
            break
        worst = int(np.argmax(unsure))
        del kept[b + worst]
        sticking = (*sticking[:worst], *sticking[worst + 1 :])
        found = together(train, motion, sticking, found.shape, delay_s)
    if len(kept) < b + len(choice.keys) * n:
        moved2 = moved2[kept] + all_found.sigma[kept] ** 2 + (all_found.value[kept] - found.value) ** 2
    return sticking, found, np.sqrt(moved2)


def _described(recording: Recording, sticking: Sequence[Term]) -> Vector:
    """What the arm file has for the parameters of `sticking`."""
    figures = [getattr(recording.arm.servos[joint], key) for key, joint in sticking]
    return np.array([0.0 if figure is None else figure.value for figure in figures])


def _delay(own: tuple[Part, Motion], filtered: Sequence[tuple[Part, Motion]], choice: Choice) -> Delay | None:
    """Of the loop; its error holds how far it moves with other low-passes and with friction that explains as much."""
    taken_s, longest_s = own[1].recording.delay_s, LONGEST_PERIODS * own[1].recording.period_s
    try:
        first, *rest = _explained(*own, choice.keys, choice.shape, None)
        others = [_explained(*other, choice.keys, choice.shape, None)[0] for other in filtered]
        for keys, shape in choice.rivals:
            terms = tuple(itertools.product(keys, range(own[0].tau.shape[1])))
            rest.append(together(*own, terms, shape, hold=True))
    except IdentifyError:  # it is not to be told apart
        return None
    if not first.delay_s < longest_s:
        return None
    by_friction_s = max((abs(found.delay_s - first.delay_s) for found in rest), default=0.0)
    sigma_s = math.hypot(first.delay_sigma_s, *(one.delay_s - first.delay_s for one in others), by_friction_s)
    return Delay(first.delay_s, sigma_s, taken_s, taken_s, by_friction_s)


def _split(part: Part, share: float) -> tuple[Part, Part]:
    """The first part, and a copy of the last."""
    at = round((1.0 - share) * len(part.t))
    return (
        Part(part.t[:at], part.columns[:at], part.tau[:at], part.used[:at]),
        Part(part.t[at:].copy(), part.columns[at:].copy(), part.tau[at:].copy(), part.used[at:].copy()),
    )


def _rms(part: Part, value: Vector) -> Vector:
    squares = ((part.tau - part.columns @ value) * part.used) ** 2
    rms: Vector = np.sqrt(squares.sum(axis=0) / np.maximum(part.used.sum(axis=0), 1))
    return rms


def _refuse_too_little(part: Part, base: Base, recording: Recording, options: Options) -> None:
    if part.t[-1] - part.t[0] < BLOCKS_MIN * BLOCK_S:
        raise too_short(float(part.t[-1] - part.t[0]))
    for joint, name in enumerate(recording.arm.entry.controlled):
        viscous = part.columns[:, joint, base.viscous(joint)]  # its own filtered velocity
        for sign, direction in ((1.0, "forward"), (-1.0, "backward")):
            share = float(((sign * viscous > 0.0) & part.used[:, joint]).mean())
            if share < USED_MIN:
                raise IdentifyError(
                    f"motion of joint {name}",
                    found=f"faster than {options.slow_rad_per_s:g} rad/s {direction} in {share:.0%} of the time",
                    expected=f"at least {USED_MIN:.0%}, in both directions",
                    remedy="record a trajectory that moves it more, or lower --slow-rad-per-s",
                )
