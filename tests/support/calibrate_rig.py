"""Joint angles of arms that hold one object while it is moved, from kinematics alone, with the truth beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from agent.calibrate.chain import Chain, Link, Matrix, chain_of
from agent.calibrate.poses import Poses, held_out
from agent.config.cell import Cell, load_cell
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.interface import Vector
from tests.support.starts import start_joints

UNSURE = (  # ± 10 mm, ± 20 mrad of bases, ± 3 mm of grasps, ± 1° of zeros
    "tolerance.base_m=0.01",
    "tolerance.base_rad=0.02",
    "tolerance.grasp_m=0.003",
    f"tolerance.zeros_rad={math.radians(1.0)}",
)
POSES = 64
READINGS = 10  # in one pose
WAY = np.array([0.04, 0.04, 0.03, 0.2, 0.2, 0.25])  # m, rad


@dataclass(frozen=True, eq=False)
class Rig:
    """A cell, what is true of it, and what its joints report."""

    cell: Cell
    chain: Chain
    truth: Vector
    poses: Poses


@cache
def believed(name: str) -> tuple[Cell, Chain, tuple[Vector, ...]]:
    cell = load_cell(Path(name), UNSURE)
    return cell, chain_of(cell), tuple(start_joints(cell))


@cache
def rig(name: str, seed: int, noise_rad: float = 0.0, count: int = POSES, readings: int = READINGS) -> Rig:
    """A truth anywhere within the tolerance, and readings on the encoders' grid with white noise before it."""
    cell, chain, q_start = believed(name)
    rng = np.random.default_rng(seed)
    bound = math.sqrt(3.0) * chain.scale
    truth = rng.uniform(-bound, bound)
    phase, q = rng.uniform(0.0, 2.0 * math.pi, 6), list(q_start)
    seen: list[list[Vector]] = [[] for _ in chain.links]
    for k in range(count):
        way = chain.basis.T @ (
            chain.basis @ (WAY * np.sin(np.array([1, 2, 3, 2, 3, 1]) * k / count * math.tau + phase))
        )
        T = cell.T_world_object_start
        target = pin.SE3(pin.exp3(way[3:]) @ T.rotation, T.translation + way[:3])
        for i, (link, x) in enumerate(zip(chain.links, chain.parts(truth), strict=True)):
            q[i] = reach(link, x, q[i], target, chain.basis)
            noise = noise_rad * rng.normal(size=(readings, link.arm.n))
            read = TICK_RAD * np.rint((q[i] + x[link.zeros] + noise) / TICK_RAD)
            seen[i].append(read.mean(axis=0))
    angles = tuple(np.array(own) for own in seen)
    return Rig(cell, chain, truth, Poses(np.arange(count) * 0.1, angles, held_out(count)))


def reach(link: Link, x: Vector, q: Vector, target: pin.SE3, basis: Matrix) -> Vector:
    """True joint angles at which the arm holds the object at the target."""
    for _ in range(20):
        seen = link.see(x, (q + x[link.zeros])[None])
        away = basis @ np.concatenate([target.translation - seen.p[0], pin.log3(target.rotation @ seen.R[0].T)])
        if np.abs(away).max() < 1e-12:
            break
        q = q + np.linalg.lstsq(basis @ seen.by_joints[0], away, rcond=None)[0]
    assert np.abs(away).max() < 1e-9
    return q
