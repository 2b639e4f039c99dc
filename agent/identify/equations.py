"""The equations of a recording: its torque and the columns of its motion, filtered alike and thinned out.

Torque and every column go through the same zero-phase low-pass, so the equation still holds between them (parallel
filtering).  Positions are differentiated after one of their own.  What the model does not say is left out: around each
turn of a joint, where friction is neither its Coulomb value nor at rest, that joint's equation is not used.  The
low-pass is a weighted mean over a window that ends, so nothing of such a turn is in an equation that is used: the tail
of a recursive filter carries what a stuck joint does into its neighbours, where it passes for a delay of the loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.control.models import ArmModel
from agent.identify.columns import Base, all_columns, object_torque
from agent.identify.friction import Columns, Shape, raw_columns
from agent.identify.recording import IdentifyError, Recording
from agent.identify.solve import BLOCK_S, Part

Matrix = NDArray[np.float64]

EDGE_PERIODS: Final = 5.0  # of the cut-off, left out at both ends
STRETCH_S: Final = 20.0  # filtered at a time, so that a long recording takes little more memory than a short one
MARGIN_PERIODS: Final = 3.0  # of the cut-off, filtered with it on both sides: more than both windows reach
MOTION: Final = 8.0  # cut-off of the positions, relative to that of the equations: at 1 Hz all but 0.2 % is left
SAMPLES_PER_PERIOD: Final = 6  # of the cut-off, kept after filtering
NYQUIST: Final = 0.45  # of the rate, above which no motion is looked at
SMOOTH: Final = 0.1  # speed over which the sign of a speed changes, relative to the slowest used
BLOCKS_MIN: Final = 10


@dataclass(frozen=True, slots=True)
class Options:
    """How a recording is looked at."""

    cutoff_hz: float = 5.0
    slow_rad_per_s: float = 0.2  # slower than this a joint's friction is not the model's
    held_out: float = 1.0 / 3.0  # last part of the recording, for validation alone


@dataclass(frozen=True)
class Motion:
    """What columns beside the base's are made of, at the samples of the equations."""

    recording: Recording
    options: Options
    dq: Matrix  # of the whole recording, low-passed

    @classmethod
    def of(cls, recording: Recording, options: Options) -> Motion:
        """Of a recording."""
        T = recording.period_s
        return cls(recording, options, np.gradient(low_pass(recording.q, motion_hz(options, T), T), T, axis=0))

    def friction(self, shapes: Sequence[Shape]) -> Columns:
        """Columns of all friction that may be there, where it falls off with speed in these ways."""
        raw = raw_columns(self.dq, self.recording.tau, SMOOTH * self.options.slow_rad_per_s, shapes)
        return Columns({name: self._filtered(column) for name, column in raw})

    def acted(self) -> Matrix:
        """(k, n) the torque that acted, N·m."""
        return self._filtered(self.recording.tau)

    def later(self, delay_s: float) -> Matrix:
        """(k, n) by how much the torque is another one if this is the loop's delay, N·m."""
        believed = self.recording.delayed(self.recording.delay_s)
        return self._filtered(self.recording.delayed(delay_s).tau - believed.tau)

    def rate(self, delay_s: float) -> Matrix:
        """(k, n) what a second more of the loop's delay adds to the columns' side, N·m/s."""
        tau, T = self.recording.delayed(delay_s).tau, self.recording.period_s
        return self._filtered(np.gradient(tau, T, axis=0))

    def _filtered(self, values: Matrix) -> Matrix:
        kept = kept_samples(self.recording, self.options)
        filtered: Matrix = low_pass(values, self.options.cutoff_hz, self.recording.period_s)[kept]
        return filtered


def equations(recording: Recording, model: ArmModel, base: Base, options: Options) -> Part:
    """All equations of the recording, filtered and thinned out, a stretch of time after the other.

    Raises IdentifyError.
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
        _fill(stretch, some, recording, model, base, options)
    return part


def motion_hz(options: Options, period_s: float) -> float:
    """Cut-off of the low-pass of the positions."""
    return min(MOTION * options.cutoff_hz, NYQUIST / period_s)


def kept_samples(recording: Recording, options: Options) -> NDArray[np.intp]:
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
    q = low_pass(recording.q[near], motion_hz(options, T), T)
    dq = np.gradient(q, T, axis=0)
    columns = all_columns(model, q, dq, np.gradient(dq, T, axis=0), SMOOTH * options.slow_rad_per_s)
    part.tau[:] = low_pass(recording.tau[near] - object_torque(recording.cell, model, columns), cutoff_hz, T)[chosen]
    for joint in range(model.n):
        part.columns[:, joint] = low_pass(columns[:, joint, base.kept], cutoff_hz, T)[chosen]
    from scipy.ndimage import maximum_filter1d  # noqa: PLC0415 - half a second, which who names a fit does not need

    reach = math.ceil(1.0 / cutoff_hz / T)  # a turn is felt this far away, by the low-pass's window
    turning = maximum_filter1d((np.abs(dq) < options.slow_rad_per_s).astype(np.int8), 2 * reach + 1, axis=0) > 0
    part.used[:] = ~turning[chosen]


def low_pass(values: Matrix, cutoff_hz: float, period_s: float) -> Matrix:
    """Mean along the first axis, weighted by a raised cosine over 1 / cutoff_hz to both sides.

    No phase; half of an oscillation of half the cut-off is left, nothing of one of the cut-off.  Raises IdentifyError
    for a cut-off above Nyquist's.
    """
    if not 0.0 < 2.0 * cutoff_hz * period_s < 1.0:
        raise IdentifyError(
            "cut-off of the low-pass", found=f"{cutoff_hz:g} Hz", expected=f"below {0.5 / period_s:g} Hz",
            remedy="take a few times the highest frequency of the trajectory",
        )  # fmt: skip
    from scipy.ndimage import convolve1d  # noqa: PLC0415 - as above

    reach = math.ceil(1.0 / cutoff_hz / period_s) - 1
    weights = 1.0 + np.cos(np.pi * cutoff_hz * period_s * np.arange(-reach, reach + 1))
    filtered: Matrix = convolve1d(values, weights / weights.sum(), axis=0, mode="nearest")
    return filtered


def too_short(found_s: float) -> IdentifyError:
    """That a motion of this length is not enough."""
    return IdentifyError(
        "motion to identify from", found=f"{found_s:.1f} s", expected=f"at least {BLOCKS_MIN * BLOCK_S:g} s",
        remedy="record a longer motion",
    )  # fmt: skip
