"""The equations of a recording: its torque and the columns of its motion, filtered alike and thinned out.

Torque and every column go through the same zero-phase low-pass, so the equation still holds between them (parallel
filtering).  Positions are differentiated after one of their own.  What the model does not say is left out: around each
turn of a joint, where friction is neither its Coulomb value nor at rest, that joint's equation is not used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.control.models import ArmModel
from agent.identify.columns import Base, all_columns, object_torque
from agent.identify.friction import Columns, raw_columns
from agent.identify.recording import IdentifyError, Recording
from agent.identify.solve import BLOCK_S, Part

Matrix = NDArray[np.float64]

FILTER_ORDER: Final = 4
EDGE_PERIODS: Final = 5.0  # of the cut-off, left out at both ends
STRETCH_S: Final = 20.0  # filtered at a time, so that a long recording takes little more memory than a short one
MARGIN_PERIODS: Final = 30.0  # of the cut-off, filtered with it on both sides: two filters forget what is beyond
SAMPLES_PER_PERIOD: Final = 6  # of the cut-off, kept after filtering
BLOCKS_MIN: Final = 10


@dataclass(frozen=True, slots=True)
class Options:
    """How a recording is looked at."""

    cutoff_hz: float = 5.0
    slow_rad_per_s: float = 0.2  # slower than this a joint's friction is not the model's
    held_out: float = 1.0 / 3.0  # last part of the recording, for validation alone


def equations(
    recording: Recording, model: ArmModel, base: Base, options: Options, motion_hz: float | None = None
) -> Part:
    """All equations of the recording, filtered and thinned out, a stretch of time after the other.

    motion_hz: low-pass of the positions, by default that of the equations.  Raises IdentifyError.
    """
    T, kept = recording.period_s, kept_samples(recording, options)
    if not len(kept):
        raise too_short(0.0)
    columns, tau = np.empty((len(kept), model.n, len(base.kept))), np.empty((len(kept), model.n))
    part = Part(T * kept.astype(np.float64), columns, tau, np.empty((len(kept), model.n), dtype=bool))
    at = 0
    for some in np.split(kept, np.flatnonzero(np.diff(kept // round(STRETCH_S / T))) + 1):
        of = slice(at, at := at + len(some))
        stretch = Part(part.t[of], part.columns[of], part.tau[of], part.used[of])
        _fill(stretch, some, recording, model, base, options, motion_hz or options.cutoff_hz)
    return part


def kept_samples(recording: Recording, options: Options) -> NDArray[np.intp]:
    """Samples of the recording that have an equation."""
    T, count = recording.period_s, len(recording.q)
    edge = math.ceil(EDGE_PERIODS / options.cutoff_hz / T)
    return np.arange(edge, count - edge, max(1, int(1.0 / T / options.cutoff_hz / SAMPLES_PER_PERIOD)))


def _fill(
    part: Part, samples: NDArray[np.intp], recording: Recording, model: ArmModel, base: Base, options: Options,
    motion_hz: float,
) -> None:  # fmt: skip
    """Fill in the equations of these samples (k,) of the recording."""
    T, cutoff_hz = recording.period_s, options.cutoff_hz
    margin = math.ceil(MARGIN_PERIODS / cutoff_hz / T)
    near = slice(max(0, int(samples[0]) - margin), int(samples[-1]) + margin + 1)
    chosen = samples - near.start
    q = low_pass(recording.q[near], motion_hz, T)
    dq = np.gradient(q, T, axis=0)
    columns = all_columns(model, q, dq, np.gradient(dq, T, axis=0), 0.1 * options.slow_rad_per_s)
    part.tau[:] = low_pass(recording.tau[near] - object_torque(recording.cell, model, columns), cutoff_hz, T)[chosen]
    for joint in range(model.n):
        part.columns[:, joint] = low_pass(columns[:, joint, base.kept], cutoff_hz, T)[chosen]
    from scipy.ndimage import maximum_filter1d  # noqa: PLC0415 - as below

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
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415 - half a second, which who names a fit does not need

    sections = butter(FILTER_ORDER, cutoff_hz, fs=1.0 / period_s, output="sos")
    filtered: Matrix = sosfiltfilt(sections, values, axis=0)
    return filtered


def friction_columns(recording: Recording, options: Options, motion_hz: float | None = None) -> Columns:
    """Columns of all friction that may be there, at the samples of the equations."""
    T, cutoff_hz = recording.period_s, options.cutoff_hz
    kept = kept_samples(recording, options)
    dq = np.gradient(low_pass(recording.q, motion_hz or cutoff_hz, T), T, axis=0)
    raw = raw_columns(dq, recording.tau, 0.1 * options.slow_rad_per_s)
    return Columns({name: low_pass(column, cutoff_hz, T)[kept] for name, column in raw})


def too_short(found_s: float) -> IdentifyError:
    """That a motion of this length is not enough."""
    return IdentifyError(
        "motion to identify from", found=f"{found_s:.1f} s", expected=f"at least {BLOCKS_MIN * BLOCK_S:g} s",
        remedy="record a longer motion",
    )  # fmt: skip
