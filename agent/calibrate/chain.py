"""The closed chain: where each arm says the object is, and how that changes with base, grasp and joint zeros.

    T_world_object = B E(q − z) G⁻¹,   B = (exp β R_B, p_B + b),   G = (exp γ R_G, p_G + g)

with the end effector E by the arm's kinematics, base B in the world, grasp G in the object, and z what the joints
report less what they are.  b, β are in world axes and g, γ in object axes, as under [simulation.reality].  Arms that
move in a plane have the plane's part of base and grasp alone.

Parameters of a cell are one vector (p,): of each arm in turn its base (m), its grasp (m) and its zeros (n).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from agent.config.cell import Arm, Cell
from agent.config.schema.tolerance import Tolerance
from agent.control.models import ArmModel
from drivers.interface import Refusal, Vector

Matrix = NDArray[np.float64]
_UNIFORM: Final = 1.0 / math.sqrt(3.0)  # standard deviation of what lies anywhere within a bound of 1


class CalibrateError(Refusal):
    """This log does not calibrate this cell."""


class Seen(NamedTuple):
    """Where one arm sees the object at k poses, world axes."""

    p: Matrix  # (k, 3)
    R: Matrix  # (k, 3, 3)
    by_parameters: Matrix  # (k, 6, p_i) twist of the object per change of the arm's parameters
    by_joints: Matrix  # (k, 6, n) per change of its joints


@dataclass(frozen=True, eq=False)
class Link:
    """One arm of the chain."""

    arm: Arm
    model: ArmModel  # with base and grasp left out
    base: Matrix  # (6, m) base error per parameter, world axes
    grasp: Matrix  # (6, m) grasp error per parameter, object axes
    scale: Vector  # (p_i,) standard deviation of each parameter by the cell's tolerance

    @property
    def m(self) -> int:
        """Parameters of a pose: 3 in a plane, 6 otherwise."""
        return int(self.base.shape[1])

    @property
    def size(self) -> int:
        """Parameters of the arm."""
        return 2 * self.m + self.arm.n

    @property
    def zeros(self) -> slice:
        """Its zeros among its parameters."""
        return slice(2 * self.m, self.size)

    def placements(self, x: Vector) -> tuple[pin.SE3, pin.SE3]:
        """Base in the world and end effector in the object with parameters x (p_i,)."""
        base, grasp = self.base @ x[: self.m], self.grasp @ x[self.m : 2 * self.m]
        return _moved(self.arm.T_world_base, base), _moved(self.arm.T_object_ee, grasp)

    def see(self, x: Vector, q: Matrix) -> Seen:
        """The object by this arm with parameters x (p_i,) at reported joint angles q (k, n)."""
        B, G = self.placements(x)
        true = q - x[self.zeros]
        ends = [_end(self.model, angles) for angles in true]
        p_ee = B.translation + np.array([T.translation for T, _ in ends]) @ B.rotation.T
        R = B.rotation @ np.array([T.rotation for T, _ in ends]) @ G.rotation.T
        arm = R @ G.translation  # from object to end effector
        p = p_ee - arm
        J = np.array([J for _, J in ends])
        linear, angular = B.rotation @ J[:, :3], B.rotation @ J[:, 3:]
        J = np.concatenate([linear + np.cross(angular, -arm[:, :, None], axis=1), angular], axis=1)
        beta, gamma = self.base[3:] @ x[: self.m], self.grasp[3:] @ x[self.m : 2 * self.m]
        return Seen(
            p, R, np.concatenate([self._by_base(beta, p - B.translation), self._by_grasp(gamma, R, arm), -J], axis=2), J
        )

    def _by_base(self, beta: Vector, reach: Matrix) -> Matrix:
        turn = pin.Jexp3(-beta) @ self.base[3:]  # (3, m) world
        linear = self.base[:3] + np.cross(turn[None], reach[:, :, None], axis=1)
        return np.concatenate([linear, np.broadcast_to(turn, linear.shape)], axis=1)

    def _by_grasp(self, gamma: Vector, R: Matrix, arm: Matrix) -> Matrix:
        turn = -R @ (pin.Jexp3(-gamma) @ self.grasp[3:])  # (k, 3, m) world
        linear = -R @ self.grasp[:3] - np.cross(turn, arm[:, :, None], axis=1)
        return np.concatenate([linear, turn], axis=1)


@dataclass(frozen=True, eq=False)
class Chain:
    """All arms of a cell that hold its object."""

    links: tuple[Link, ...]
    basis: Matrix  # (m, 6) directions in which the arms can disagree, world axes

    @property
    def scale(self) -> Vector:
        """(p,) standard deviation of each parameter by the cell's tolerance; 0: known."""
        return np.concatenate([link.scale for link in self.links])

    @property
    def size(self) -> int:
        """Parameters of the cell."""
        return sum(link.size for link in self.links)

    def parts(self, x: Vector) -> list[Vector]:
        """Parameters of each arm."""
        return np.split(x, np.cumsum([link.size for link in self.links])[:-1])

    def see(self, x: Vector, q: Sequence[Matrix]) -> list[Seen]:
        """The object by each arm; q: reported joint angles (k, n) of each."""
        return [link.see(own, angles) for link, own, angles in zip(self.links, self.parts(x), q, strict=True)]


def chain_of(cell: Cell) -> Chain:
    """The closed chain of a cell.  Raises CalibrateError for a single arm, or arms of which some are planar."""
    models = [cell.model(arm) for arm in cell.arms]
    if len(models) < 2 or len({model.task_dimension for model in models}) > 1:
        found = "one arm" if len(models) < 2 else "planar arms and others"
        raise CalibrateError(
            f"arms of cell {cell.file.name}", found=found, expected="two or more arms of one kind that hold one object",
            remedy="take a log of the whole cell",
        )  # fmt: skip
    basis = models[0].task_basis
    turned = np.kron(np.eye(2), cell.T_world_object_start.rotation.T)  # world to object axes
    links = []
    for arm in cell.arms:
        bare = ArmModel(
            arm.urdf_xml, arm.entry.controlled, arm.entry.locked_rad, pin.SE3.Identity(), arm.file.ee_frame,
            pin.SE3.Identity(), arm.rotor_inertia, cell.gravity,
        )  # fmt: skip
        links.append(Link(arm, bare, basis.T, turned @ basis.T, _scale(cell.tolerance, basis, arm.n)))
    return Chain(tuple(links), basis)


def as_exact(chain: Chain) -> Chain:
    """The chain with every parameter taken as exact."""
    return replace(chain, links=tuple(replace(link, scale=np.zeros(link.size)) for link in chain.links))


def as_loose_as_told(cell: Cell) -> Chain:
    """The chain with all that the cell's own [tolerance] allows: pads, too, that give under the object's weight.

    A pad that gives shifts and turns the grasp.  Raises as `chain_of`.
    """
    chain, pads = chain_of(cell), cell.file.tolerance
    weight_N = cell.file.object.mass_kg * float(np.linalg.norm(cell.gravity))
    links = []
    for link in chain.links:
        moment_Nm = weight_N * float(np.linalg.norm(link.arm.T_object_ee.translation))
        linear = np.linalg.norm(link.grasp[:3], axis=0) > 0.5
        give = np.where(linear, weight_N / pads.pads_N_per_m[0], moment_Nm / pads.pads_Nm_per_rad[0])
        scale, grasp = link.scale.copy(), slice(link.m, 2 * link.m)
        scale[grasp] = np.hypot(scale[grasp], give)
        links.append(replace(link, scale=scale))
    return replace(chain, links=tuple(links))


def _scale(tolerance: Tolerance, basis: Matrix, n: int) -> Vector:
    linear = np.linalg.norm(basis[:, :3], axis=1) > 0.5
    base = np.where(linear, tolerance.base_m, tolerance.base_rad)
    grasp = np.where(linear, tolerance.grasp_m, tolerance.grasp_rad)
    scale: Vector = _UNIFORM * np.concatenate([base, grasp, np.full(n, tolerance.zeros_of(n))])
    return scale


def _moved(T: pin.SE3, error: Vector) -> pin.SE3:
    return pin.SE3(pin.exp3(error[3:]) @ T.rotation, T.translation + error[:3])


def _end(arm: ArmModel, q: Vector) -> tuple[pin.SE3, Matrix]:
    """End effector and its Jacobian (6, n) in axes of the base."""
    pin.computeJointJacobians(arm.model, arm.data, q)
    T = pin.SE3(pin.updateFramePlacement(arm.model, arm.data, arm.ee_id))
    return T, pin.getFrameJacobian(arm.model, arm.data, arm.ee_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED).copy()
