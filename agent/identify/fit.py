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
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, sosfiltfilt

from agent.control.models import ArmModel
from agent.identify.columns import Base, all_columns, base_of, described_parameters, object_torque
from agent.identify.recording import IdentifyError, Recording
from drivers.interface import Vector

Matrix = NDArray[np.float64]

FILTER_ORDER: Final = 4
EDGE_PERIODS: Final = 5.0  # of the cut-off, left out at both ends
BLOCK_ROWS: Final = 2048  # taken into the least squares at a time
STRETCH_S: Final = 20.0  # filtered at a time, so that a long recording takes little more memory than a short one
MARGIN_PERIODS: Final = 30.0  # of the cut-off, filtered with it on both sides: two filters forget what is beyond
SAMPLES_PER_PERIOD: Final = 6  # of the cut-off, kept after filtering
BLOCK_S: Final = 1.0
BLOCKS_MIN: Final = 10
OTHER_CUTOFF: Final = 0.6  # the second low-pass, relative to the first
CONDITION_MAX: Final = 500.0
USED_MIN: Final = 0.1  # share of the time that each joint moves fast enough, in each direction


@dataclass(frozen=True, slots=True)
class Options:
    """How a recording is looked at."""

    cutoff_hz: float = 5.0
    slow_rad_per_s: float = 0.2  # slower than this a joint's friction is not the model's
    held_out: float = 1.0 / 3.0  # last part of the recording, for validation alone


@dataclass(frozen=True)
class Part:
    """Equations of a stretch of time: columns @ parameters = tau where used."""

    t: Vector  # (k,) s
    columns: Matrix  # (k, n, b)
    tau: Matrix  # (k, n) N·m, the object's share taken out
    used: NDArray[np.bool_]  # (k, n)


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


def fit(recording: Recording, options: Options) -> Fit:
    """Identify the arm.  Raises IdentifyError when the motion excites it too little."""
    model = recording.cell.model(recording.arm)
    base = base_of(model)
    train, held_out = _split(_equations(recording, model, base, options), options.held_out)
    _refuse_too_little(train, base, recording, options)
    value, sigma, condition = least_squares(train)
    used = train.used.mean(axis=0)
    del train  # a long recording's are large
    slower = replace(options, cutoff_hz=OTHER_CUTOFF * options.cutoff_hz)
    other, _ = _split(_equations(recording, model, base, slower), options.held_out)
    moved = least_squares(other)[0] - value
    described = base.combination @ described_parameters(recording.arm, model)
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
    )


def least_squares(part: Part) -> tuple[Vector, Vector, float]:
    """Parameters (b,), their standard errors (b,), and the condition number of the scaled columns.

    Joints are weighted by how well they fit.  Raises IdentifyError when the motion leaves a parameter undetermined.
    """
    count, n, b = part.columns.shape
    weight = np.ones(n)
    for _ in range(3):
        triangle = _triangle(part, weight)
        scale = np.maximum(np.linalg.norm(triangle[:, :b], axis=0), 1e-300)
        condition = float(np.linalg.cond(triangle[:, :b] / scale))
        _refuse_condition(condition)
        value = np.linalg.lstsq(triangle[:, :b] / scale, triangle[:, b], rcond=None)[0] / scale
        residual = (part.tau - part.columns @ value) * part.used
        used_weight, weight = weight, np.sqrt(part.used.sum(axis=0) / np.maximum((residual**2).sum(axis=0), 1e-300))
    scores = np.empty((count, b))
    for some in _blocks(count):
        scores[some] = np.einsum("kjb,kj->kb", part.columns[some], residual[some] * used_weight * weight)
    inverse = np.linalg.inv(triangle[:, :b].T @ triangle[:, :b])
    return value, np.sqrt(np.diag(inverse @ _covariance(scores, part.t) @ inverse)), condition


def _triangle(part: Part, weight: Vector) -> Matrix:
    """R (b + 1, b + 1) of the equations [columns, tau], weighted by joint (n,): all that least squares needs."""
    found: Matrix = np.empty((0, part.columns.shape[2] + 1))
    for some in _blocks(len(part.t)):
        rows = np.concatenate([part.columns[some], part.tau[some, :, None]], axis=2)
        rows *= (part.used[some] * weight)[:, :, None]
        found = np.asarray(np.linalg.qr(np.concatenate([found, rows.reshape(-1, rows.shape[2])]), mode="r"))
    return found


def _blocks(count: int) -> list[slice]:
    return [slice(at, at + BLOCK_ROWS) for at in range(0, count, BLOCK_ROWS)]


def _covariance(scores: Matrix, t: Vector) -> Matrix:
    """Of the sum of all scores (k, b), from the sums over blocks of time, which are all but independent."""
    block = np.floor((t - t[0]) / BLOCK_S).astype(int)
    sums: Matrix = np.stack([np.bincount(block, column) for column in scores.T], axis=1)
    count = len(sums)
    covariance: Matrix = sums.T @ sums * (count / (count - 1))
    return covariance


def _equations(recording: Recording, model: ArmModel, base: Base, options: Options) -> Part:
    """All equations of the recording, filtered and thinned out, a stretch of time after the other."""
    T, count = recording.period_s, len(recording.q)
    edge = math.ceil(EDGE_PERIODS / options.cutoff_hz / T)
    kept = np.arange(edge, count - edge, max(1, int(1.0 / T / options.cutoff_hz / SAMPLES_PER_PERIOD)))
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


def _refuse_condition(condition: float) -> None:
    if not condition <= CONDITION_MAX:
        raise IdentifyError(
            "excitation",
            found=f"columns with a condition number of {condition:.3g}",
            expected=f"at most {CONDITION_MAX:g}",
            remedy='record a trajectory with more frequencies on more axes (kind = "fourier")',
        )
