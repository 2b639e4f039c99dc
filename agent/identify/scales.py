"""How many times what the links ask of it each joint's torque is, beside that of the joint that bears most.

A torque constant is that of one servo, and links are shared by all joints: where constants are off by different
factors no links explain all joints at once, and friction and breakaway are made up for it.  So the factors are found
first, from the torque of links and object alone, and the torque of each joint is taken in the unit of one of them.  The
figures of a joint (rotor, friction) go back into its own unit afterwards, which is the one that its commands have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.control.regressor import BODY_PARAMETERS
from agent.identify.columns import Base
from agent.identify.equations import Motion
from agent.identify.friction import BREAKAWAY, Term
from agent.identify.joint import CONDITION_MAX
from agent.identify.recording import IdentifyError, Recording
from agent.identify.solve import Part, least_squares
from drivers.interface import Vector

Matrix = NDArray[np.float64]

ROUNDS: Final = 8
CLOSE: Final = 1e-4
CERTAIN_SIGMAS: Final = 3.0
LEAST: Final = 0.005  # of a factor, from 1 on: less is within what figures are good to


@dataclass(frozen=True)
class Scales:
    """Factors of the joints; where the motion does not tell them they are ones, with infinite errors."""

    value: Vector  # (n,) 1 of the joint that bears most
    sigma: Vector  # (n,) standard errors; 0 of that joint

    @property
    def most(self) -> int:
        """The joint that bears most."""
        return int(np.argmin(self.sigma))

    @property
    def taken(self) -> Vector:
        """(n,) factors that are beyond doubt, 1 of the others."""
        off = np.abs(self.value - 1.0)
        return np.where((off > CERTAIN_SIGMAS * self.sigma) & (off > LEAST), self.value, 1.0)


def one_unit(recording: Recording, taken: Vector) -> Recording:
    """The recording with the torque of each joint divided by its factor."""
    return replace(recording, tau=recording.tau / taken, sent=recording.sent / taken)


def in_one_unit(part: Part, motion: Motion, taken: Vector) -> Part:
    """The same of its equations, from the first one on; what the object takes is in no servo's unit."""
    if np.all(taken == 1.0):
        return part
    acted = motion.acted()[: len(part.t)]
    return replace(part, tau=part.tau + acted / taken - acted)


def scales_of(part: Part, motion: Motion, base: Base) -> Scales:
    """Factors of a recording's joints, from its equations from the first one on."""
    n = part.tau.shape[1]
    value, sigma, unknown = np.ones(n), np.zeros(n), Scales(np.ones(n), np.full(n, np.inf))
    shared = [i for i, k in enumerate(base.kept) if k < BODY_PARAMETERS * n]
    of_object = motion.acted()[: len(part.t)] - part.tau
    rate = motion.rate(motion.recording.delay_s)[: len(part.t), :, None]
    late = replace(part, columns=np.concatenate([part.columns, rate], axis=2))
    try:
        for _ in range(ROUNDS):
            scaled = in_one_unit(late, motion, value)
            links = part.columns[:, :, shared] @ least_squares(scaled, CONDITION_MAX)[0][shared] + of_object
            most = int(np.argmax((links**2).mean(axis=0)))
            others = np.flatnonzero(np.arange(n) != most)
            own = links[:, :, None] * np.eye(n)[:, others]
            wide = replace(scaled, columns=np.concatenate([scaled.columns, own], axis=2))
            found, errors, _ = least_squares(wide, CONDITION_MAX)
            off = found[-len(others) :]
            value[others] *= 1.0 + off
            value /= value[most]
            sigma[others], sigma[most] = value[others] * errors[-len(others) :], 0.0
            if not np.all(value > 0.0):
                return unknown
            if np.abs(off).max() < CLOSE:
                break
    except IdentifyError:
        return unknown
    return Scales(value, sigma)


def in_own_units(taken: Vector, base: Base, sticking: Sequence[Term]) -> Vector:
    """(b + s,) what parameters in the common unit are multiplied by: those of one joint alone by its factor.

    Those of the links keep that unit, and parts of a load are no torque.
    """
    by = np.ones(len(base.kept) + len(sticking))
    for j, factor in enumerate(taken.tolist()):
        by[[base.rotor(j), base.viscous(j), base.coulomb(j)]] = factor
    for i, (key, j) in enumerate(sticking, start=len(base.kept)):
        by[i] = taken[j] if key == BREAKAWAY else 1.0
    return by


def of_own_units(part: Part, taken: Vector, by: Vector) -> Part:
    """Equations in the common unit as those of each joint's own, for parameters that were multiplied by `by`."""
    return replace(part, tau=part.tau * taken, columns=part.columns * taken[:, None] / by)
