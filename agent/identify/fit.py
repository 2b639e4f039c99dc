"""Least squares of base parameters on a recording, with standard errors and a held-out part.

What is left over is not white: it comes from grids, and from what the model leaves out.  So the standard errors are
those of sums over whole blocks of time (cluster-robust), and for the model they have the distance by which an estimate
moves when the low-pass does, and when the loop's delay does by its own standard error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.control.models import ArmModel
from agent.identify.columns import Base, base_of, described_parameters
from agent.identify.delay import Delay, measured
from agent.identify.equations import (
    BLOCKS_MIN,
    Options,
    equations,
    friction_columns,
    kept_samples,
    low_pass,
    too_short,
)
from agent.identify.friction import CERTAIN, Choice, Columns, Term, choose, with_friction
from agent.identify.recording import IdentifyError, Recording
from agent.identify.solve import BLOCK_S, CONDITION_MAX, Part, least_squares
from drivers.interface import Vector

Matrix = NDArray[np.float64]

OTHER_CUTOFF: Final = 0.6  # the second low-pass, relative to the first
DELAY_CUTOFF: Final = 0.4  # that of the delay
DELAY_OTHER: Final = 0.5  # the second one of the delay
DELAY_MOTION: Final = 2.0  # of the motion beside it: joints must turn when they did, or friction passes for delay
DELAY_ROUNDS: Final = 3
NYQUIST: Final = 0.45  # of the rate, above which no motion is looked at
USED_MIN: Final = 0.1  # share of the time that each joint moves fast enough, in each direction


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
    sticking: tuple[Term, ...]  # (key of the arm file, joint) of the last of `value`, behind the base's
    delay: Delay | None  # of the loop


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


def _fit(recording: Recording, options: Options) -> Fit:
    """Identify the arm with the delay that the recording says."""
    model = recording.cell.model(recording.arm)
    base = base_of(model)
    train, held_out = _split(equations(recording, model, base, options), options.held_out)
    _refuse_too_little(train, base, recording, options)
    friction = friction_columns(recording, options)
    choice = choose(train.columns, train.tau, train.used, friction.some(slice(len(train.t))), CONDITION_MAX)
    sticking, train = _certain(train, friction, choice)
    value, sigma, condition = least_squares(train)
    used = train.used.mean(axis=0)
    delay = _delay(recording, model, base, options, choice, sticking)
    moved_by_delay = _moved_by(delay, train, value, recording, options)
    del train  # a long recording's are large
    slower = replace(options, cutoff_hz=OTHER_CUTOFF * options.cutoff_hz)
    other, _ = _split(equations(recording, model, base, slower), options.held_out)
    if sticking:
        other = _joined(other, friction_columns(recording, slower), choice, sticking)
        held_out = _joined(held_out, friction.some(slice(-len(held_out.t), None)), choice, sticking)
    moved = least_squares(other)[0] - value
    described = np.concatenate(
        [base.combination @ described_parameters(recording.arm, model), _described(recording, sticking)]
    )
    return Fit(
        base=base,
        value=value,
        sigma=np.hypot(np.hypot(sigma, moved), moved_by_delay),
        described=described,
        condition=condition,
        used=used,
        held_out=held_out,
        residual=_rms(held_out, value),
        residual_described=_rms(held_out, described),
        torque=_rms(held_out, np.zeros_like(value)),
        choice=choice,
        sticking=sticking,
        delay=delay,
    )


def _joined(part: Part, friction: Columns, choice: Choice, sticking: Sequence[Term]) -> Part:
    """The part with the chosen columns of friction, of the same samples, behind its own."""
    columns = {name: column[: len(part.t)] for name, column in friction.of.items()}
    return replace(part, columns=with_friction(part.columns, Columns(columns), choice.shape, sticking))


def _certain(train: Part, friction: Columns, choice: Choice) -> tuple[tuple[Term, ...], Part]:
    """The chosen parameters that are known well, joint by joint, and the training data with their columns."""
    sticking = tuple((key, joint) for key in choice.keys for joint in range(train.tau.shape[1]))
    while sticking:
        joined = _joined(train, friction, choice, sticking)
        value, sigma, _ = least_squares(joined)
        own = slice(-len(sticking), None)
        unsure = sigma[own] / np.where(value[own] > 0.0, value[own], 1e-300)
        if unsure.max() <= CERTAIN:
            return sticking, joined
        worst = int(np.argmax(unsure))
        sticking = (*sticking[:worst], *sticking[worst + 1 :])
    return (), train


def _described(recording: Recording, sticking: Sequence[Term]) -> Vector:
    """What the arm file has for the parameters of `sticking`."""
    figures = [getattr(recording.arm.servos[joint], key) for key, joint in sticking]
    return np.array([0.0 if figure is None else figure.value for figure in figures])


def _delay(
    recording: Recording, model: ArmModel, base: Base, options: Options, choice: Choice, sticking: Sequence[Term]
) -> Delay | None:
    """Of the loop, from the whole recording; its error holds how far it moves with the low-pass."""
    motion_hz = min(DELAY_MOTION * options.cutoff_hz, NYQUIST / recording.period_s)
    slowest, slower = (
        _delay_below(
            recording, model, base, replace(options, cutoff_hz=share * options.cutoff_hz), motion_hz, choice, sticking
        )
        for share in (DELAY_CUTOFF, DELAY_OTHER)
    )
    if slowest is None or slower is None:
        return None
    return slowest._replace(sigma_s=math.hypot(slowest.sigma_s, slowest.value_s - slower.value_s))


def _moved_by(delay: Delay | None, train: Part, value: Vector, recording: Recording, options: Options) -> Vector:
    """(b,) how far the estimates move with the delay as far as it may be off, by its own estimate."""
    if delay is None:
        return np.zeros_like(value)
    off_s = max(abs(delay.value_s - delay.taken_s), delay.sigma_s)
    later = low_pass(
        recording.delayed(delay.taken_s + off_s).tau - recording.tau, options.cutoff_hz, recording.period_s
    )
    shift = later[kept_samples(recording, options)][: len(train.t)]
    return least_squares(replace(train, tau=train.tau + shift))[0] - value


def _delay_below(
    recording: Recording, model: ArmModel, base: Base, slowest: Options, motion_hz: float, choice: Choice,
    sticking: Sequence[Term],
) -> Delay | None:  # fmt: skip
    """The delay from slow motion alone, of which the encoders' steps hide the least."""
    part, kept = equations(recording, model, base, slowest, motion_hz), kept_samples(recording, slowest)
    if sticking:
        part = _joined(part, friction_columns(recording, slowest, motion_hz), choice, sticking)

    def filtered(tau: Matrix) -> Matrix:
        return low_pass(tau, slowest.cutoff_hz, recording.period_s)[kept]

    def solve(shift: Matrix, rate: Matrix) -> tuple[Vector, Vector]:
        columns = np.concatenate([part.columns, rate[:, :, None]], axis=2)
        try:
            value, sigma, _ = least_squares(replace(part, columns=columns, tau=part.tau + shift))
        except IdentifyError:  # such slow motion does not tell everything apart
            return np.full(1, np.nan), np.full(1, np.nan)
        return value, sigma

    return measured(recording, filtered, solve)


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
