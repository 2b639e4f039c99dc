"""Least squares of base parameters on a recording, with standard errors and a held-out part.

Torque and every column go through the same zero-phase low-pass, so the equation still holds between them (parallel
filtering).  Positions are differentiated after one of their own.  What the model does not say is left out: around each
turn of a joint, where friction is neither its Coulomb value nor at rest, that joint's equation is not used.

What is left over is not white: it comes from grids, and from what the model leaves out.  So the standard errors are
those of sums over whole blocks of time (cluster-robust), and for the model they have the distance by which an estimate
moves when the low-pass does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, sosfiltfilt

from agent.control.models import ArmModel
from agent.identify.columns import Base, all_columns, base_of, described_parameters, object_torque
from agent.identify.delay import Delay, measured
from agent.identify.friction import CERTAIN, Choice, Columns, Term, choose, raw_columns, with_friction
from agent.identify.recording import IdentifyError, Recording
from agent.identify.solve import BLOCK_S, CONDITION_MAX, Part, least_squares
from drivers.interface import Vector

Matrix = NDArray[np.float64]

FILTER_ORDER: Final = 4
EDGE_PERIODS: Final = 5.0  # of the cut-off, left out at both ends
STRETCH_S: Final = 20.0  # filtered at a time, so that a long recording takes little more memory than a short one
MARGIN_PERIODS: Final = 30.0  # of the cut-off, filtered with it on both sides: two filters forget what is beyond
SAMPLES_PER_PERIOD: Final = 6  # of the cut-off, kept after filtering
BLOCKS_MIN: Final = 10
OTHER_CUTOFF: Final = 0.6  # the second low-pass, relative to the first
DELAY_CUTOFF: Final = 0.4  # that of the delay
USED_MIN: Final = 0.1  # share of the time that each joint moves fast enough, in each direction


@dataclass(frozen=True, slots=True)
class Options:
    """How a recording is looked at."""

    cutoff_hz: float = 5.0
    slow_rad_per_s: float = 0.2  # slower than this a joint's friction is not the model's
    held_out: float = 1.0 / 3.0  # last part of the recording, for validation alone


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
    """Identify the arm.  Raises IdentifyError when the motion excites it too little."""
    model = recording.cell.model(recording.arm)
    base = base_of(model)
    train, held_out = _split(_equations(recording, model, base, options), options.held_out)
    _refuse_too_little(train, base, recording, options)
    friction = _friction_columns(recording, options)
    choice = choose(train.columns, train.tau, train.used, friction.some(slice(len(train.t))), CONDITION_MAX)
    sticking, train = _certain(train, friction, choice)
    value, sigma, condition = least_squares(train)
    used = train.used.mean(axis=0)
    delay = _delay(recording, model, base, options, choice, sticking)
    del train  # a long recording's are large
    slower = replace(options, cutoff_hz=OTHER_CUTOFF * options.cutoff_hz)
    other, _ = _split(_equations(recording, model, base, slower), options.held_out)
    if sticking:
        other = _joined(other, _friction_columns(recording, slower), choice, sticking)
        held_out = _joined(held_out, friction.some(slice(-len(held_out.t), None)), choice, sticking)
    moved = least_squares(other)[0] - value
    described = np.concatenate(
        [base.combination @ described_parameters(recording.arm, model), _described(recording, sticking)]
    )
    return Fit(
        base=base,
        value=value,
        sigma=np.hypot(sigma, moved),
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


def _friction_columns(recording: Recording, options: Options) -> Columns:
    """Columns of all friction that may be there, at the samples of the equations."""
    T, cutoff_hz = recording.period_s, options.cutoff_hz
    kept = _kept(recording, options)
    dq = np.gradient(low_pass(recording.q, cutoff_hz, T), T, axis=0)
    raw = raw_columns(dq, recording.tau, 0.1 * options.slow_rad_per_s)
    return Columns({name: low_pass(column, cutoff_hz, T)[kept] for name, column in raw})


def _delay(
    recording: Recording, model: ArmModel, base: Base, options: Options, choice: Choice, sticking: Sequence[Term]
) -> Delay | None:
    """Of the loop, from the whole recording; its error holds how far it moves with the low-pass."""
    slowest, slower = (
        _delay_below(recording, model, base, replace(options, cutoff_hz=share * options.cutoff_hz), choice, sticking)
        for share in (DELAY_CUTOFF, OTHER_CUTOFF)
    )
    if slowest is None or slower is None:
        return None
    return slowest._replace(sigma_s=math.hypot(slowest.sigma_s, slowest.value_s - slower.value_s))


def _delay_below(
    recording: Recording, model: ArmModel, base: Base, slowest: Options, choice: Choice, sticking: Sequence[Term]
) -> Delay | None:
    """The delay from slow motion alone, of which the encoders' steps hide the least."""
    part, kept = _equations(recording, model, base, slowest), _kept(recording, slowest)
    if sticking:
        part = _joined(part, _friction_columns(recording, slowest), choice, sticking)

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


def _equations(recording: Recording, model: ArmModel, base: Base, options: Options) -> Part:
    """All equations of the recording, filtered and thinned out, a stretch of time after the other."""
    T, kept = recording.period_s, _kept(recording, options)
    if not len(kept):
        raise _too_short(0.0)
    columns, tau = np.empty((len(kept), model.n, len(base.kept))), np.empty((len(kept), model.n))
    part = Part(T * kept.astype(np.float64), columns, tau, np.empty((len(kept), model.n), dtype=bool))
    at = 0
    for some in np.split(kept, np.flatnonzero(np.diff(kept // round(STRETCH_S / T))) + 1):
        of = slice(at, at := at + len(some))
        stretch = Part(part.t[of], part.columns[of], part.tau[of], part.used[of])
        _fill(stretch, some, recording, model, base, options)
    return part


def _kept(recording: Recording, options: Options) -> NDArray[np.intp]:
    """Samples of the recording that have an equation."""
    T, count = recording.period_s, len(recording.q)
    edge = math.ceil(EDGE_PERIODS / options.cutoff_hz / T)
    return np.arange(edge, count - edge, max(1, int(1.0 / T / options.cutoff_hz / SAMPLES_PER_PERIOD)))


def _fill(
    part: Part, samples: NDArray[np.intp], recording: Recording, model: ArmModel, base: Base, options: Options
) -> None:
    """Fill in the equations of these samples (k,) of the recording."""
    T, cutoff_hz = recording.period_s, options.cutoff_hz
    margin = math.ceil(MARGIN_PERIODS / cutoff_hz / T)
    near = slice(max(0, int(samples[0]) - margin), int(samples[-1]) + margin + 1)
    chosen = samples - near.start
    q = low_pass(recording.q[near], cutoff_hz, T)
    dq = np.gradient(q, T, axis=0)
    columns = all_columns(model, q, dq, np.gradient(dq, T, axis=0), 0.1 * options.slow_rad_per_s)
    part.tau[:] = low_pass(recording.tau[near] - object_torque(recording.cell, model, columns), cutoff_hz, T)[chosen]
    for joint in range(model.n):
        part.columns[:, joint] = low_pass(columns[:, joint, base.kept], cutoff_hz, T)[chosen]
    reach = math.ceil(0.5 / cutoff_hz / T)  # a turn is felt this far away through the filter
    turning = maximum_filter1d((np.abs(dq) < options.slow_rad_per_s).astype(np.int8), 2 * reach + 1, axis=0) > 0
    part.used[:] = ~turning[chosen]


def low_pass(values: Matrix, cutoff_hz: float, period_s: float) -> Matrix:
    """Zero-phase Butterworth low-pass along the first axis.  Raises IdentifyError for a cut-off above Nyquist's."""
    if not 0.0 < 2.0 * cutoff_hz * period_s < 1.0:
        raise IdentifyError(
            "cut-off of the low-pass", found=f"{cutoff_hz:g} Hz", expected=f"below {0.5 / period_s:g} Hz",
            remedy="take a few times the highest frequency of the trajectory",
        )  # fmt: skip
    sections = butter(FILTER_ORDER, cutoff_hz, fs=1.0 / period_s, output="sos")
    filtered: Matrix = sosfiltfilt(sections, values, axis=0)
    return filtered


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
        raise _too_short(float(part.t[-1] - part.t[0]))
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


def _too_short(found_s: float) -> IdentifyError:
    return IdentifyError(
        "motion to identify from", found=f"{found_s:.1f} s", expected=f"at least {BLOCKS_MIN * BLOCK_S:g} s",
        remedy="record a longer motion",
    )  # fmt: skip
