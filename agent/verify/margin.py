"""The sampled loop of a cell along its trajectory, with the arms' inertia off by a stated error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agent.config import observer
from agent.config.cell import Cell
from agent.control.errors import Gains
from agent.control.models import ArmModel, Matrix
from agent.control.stability import SampledLoop, coupled_inertia, modes
from drivers.interface import Vector

SLOW_RAD = 1e-9  # a mode that turns less than this from one sample to the next only creeps


@dataclass(frozen=True)
class Place:
    """Coupled inertia at one point of the trajectory, on the task rows (m, m)."""

    believed: Matrix
    true: Mapping[float, Matrix]  # by the relative error of the arms' inertia: 0, −e, +e


@dataclass(frozen=True, slots=True)
class Damping:
    """The worst over all places: how slowly a disturbance dies out, and how much it swings while it does."""

    radius: float  # largest modulus of all modes; below 1 the loop is stable
    ratio: float  # smallest damping ratio of the modes that swing; 1 when none does, negative when one grows

    def time_constant_s(self, period_s: float) -> float:
        """Time in which the slowest mode falls to 1/e; infinite when it does not."""
        return -period_s / math.log(self.radius) if self.radius < 1.0 else math.inf


def places(cell: Cell, models: Sequence[ArmModel], along: Sequence[Sequence[Vector]]) -> tuple[Place, ...]:
    """Coupled inertia where the arms (one model each) are at along[k][i], the joint angles (n,) of arm i at place k."""
    error, obj = cell.inertia_error, cell.file.object
    inertia_object = np.array(obj.inertia_kg_m2.matrix())
    found = []
    for q in along:
        R = models[0].object_pose(q[0]).rotation
        I_world = R @ inertia_object @ R.T
        true = {e: coupled_inertia(models, q, obj.mass_kg, I_world, 1.0 + e) for e in (0.0, -error, error)}
        found.append(Place(true[0.0], true))
    return tuple(found)


def sampled_loop(cell: Cell, gains: Sequence[Gains] | None = None, *, simulated: bool = False) -> SampledLoop:
    """The loop at the cell's rate, delay and observer; gains: of the arms, the cell's own when not given.

    simulated: with the delay of the simulated cell, whatever the observer believes.
    """
    file = cell.file
    return SampledLoop(
        1.0 / file.rate_hz,
        file.simulated_delay_s * file.rate_hz if simulated else file.delay_periods,
        [cell.offline(arm).gains for arm in cell.arms] if gains is None else gains,
        observer.build(file),
    )


def damping_at(true: Matrix, believed: Matrix, P: Matrix, loop: SampledLoop) -> Damping:
    """Damping at one place, for one true inertia.  true, believed: (m, m); P: (m, 6) task basis."""
    eigenvalues = modes(true, believed, P, loop)
    return Damping(float(np.abs(eigenvalues).max()), _ratio(eigenvalues))


def damping(where: Sequence[Place], P: Matrix, loop: SampledLoop) -> dict[float, Damping]:
    """Worst damping over all places, by the error of the arms' inertia.  P: (m, 6) task basis."""
    worst: dict[float, Damping] = {}
    for place in where:
        for error, true in place.true.items():
            here = damping_at(true, place.believed, P, loop)
            known = worst.get(error, here)
            worst[error] = Damping(max(here.radius, known.radius), min(here.ratio, known.ratio))
    return worst


def _ratio(eigenvalues: np.ndarray[tuple[int], np.dtype[np.complex128]]) -> float:
    """Smallest ζ = −ln|λ| / |ln λ| of the modes that swing: the damping ratio of the motion whose samples they are."""
    swinging = np.abs(np.angle(eigenvalues)) > SLOW_RAD
    alive = np.abs(eigenvalues) > 1e-12
    logarithm = np.log(eigenvalues[swinging & alive])
    return float((-logarithm.real / np.abs(logarithm)).min(initial=1.0))
