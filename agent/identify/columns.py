"""The torque of an arm as columns times parameters, and which combinations of them a torque can tell apart.

Not every parameter moves the torque in a way of its own: the mass of a distal link acts as a first moment of the one
before it, a rotor turns with the link behind it.  A column that is a combination of others is left out, and its
parameter is counted in theirs; what remains are the base parameters (Gautier, 1991).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from agent.config.cell import Arm, Cell
from agent.control.models import ArmModel
from agent.control.regressor import BODY_PARAMETERS, arm_parameters, object_parameters
from drivers.interface import Vector

Matrix = NDArray[np.float64]

BODY_NAMES: Final = ("m", "h_x", "h_y", "h_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
BODY_UNITS: Final = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)
JOINT_NAMES: Final = ("rotor", "viscous", "coulomb")
JOINT_UNITS: Final = ("kg·m²", "N·m·s/rad", "N·m")
FIRST_MOMENTS: Final = (1, 2, 3)
INDEPENDENT: Final = 1e-7  # share of a column that must be its own
_STATES: Final = 80  # random ones, at which the structure is found


@dataclass(frozen=True)
class Base:
    """Base parameters of an arm: base = combination @ all parameters."""

    joints: tuple[str, ...]
    kept: tuple[int, ...]  # the parameter that leads each of them
    combination: Matrix  # (b, p)

    @property
    def names(self) -> tuple[str, ...]:
        """Each combination in words, such as "h_x(elbow) + 0.2 m(wrist_angle)"."""
        return tuple(self._name(i) for i in range(len(self.kept)))

    @property
    def units(self) -> tuple[str, ...]:
        """Of each."""
        n = len(self.joints)
        return tuple(
            BODY_UNITS[k % BODY_PARAMETERS] if k < BODY_PARAMETERS * n else JOINT_UNITS[(k - BODY_PARAMETERS * n) // n]
            for k in self.kept
        )

    def rotor(self, joint: int) -> int:
        """Which base parameter the rotor inertia of a joint leads."""
        return self._joint_parameter(0, joint)

    def viscous(self, joint: int) -> int:
        """The same of viscous friction."""
        return self._joint_parameter(1, joint)

    def coulomb(self, joint: int) -> int:
        """The same of Coulomb friction."""
        return self._joint_parameter(2, joint)

    def gravity(self) -> tuple[int, ...]:
        """Base parameters that a first moment leads: what gravity acts on."""
        bodies = BODY_PARAMETERS * len(self.joints)
        return tuple(i for i, k in enumerate(self.kept) if k < bodies and k % BODY_PARAMETERS in FIRST_MOMENTS)

    def _joint_parameter(self, kind: int, joint: int) -> int:
        n = len(self.joints)
        return self.kept.index(BODY_PARAMETERS * n + kind * n + joint)

    def _name(self, i: int) -> str:
        lead = _parameter_name(self.kept[i], self.joints)
        row = self.combination[i]
        rest = [(k, row[k]) for k in np.flatnonzero(np.abs(row) > 1e-6).tolist() if k != self.kept[i]]
        return lead + "".join(
            f" {'−' if c < 0 else '+'} {_factor(c)}{_parameter_name(k, self.joints)}" for k, c in rest
        )


def all_columns(model: ArmModel, q: Matrix, dq: Matrix, ddq: Matrix, smooth_rad_per_s: float) -> Matrix:
    """(k, n, 13 n) columns at k states (k, n) each: bodies, then rotor inertia, viscous and Coulomb friction."""
    k, n = q.shape
    columns = np.zeros((k, n, (BODY_PARAMETERS + 3) * n))
    bodies = columns[:, :, : BODY_PARAMETERS * n]
    for i in range(k):
        bodies[i] = pin.computeJointTorqueRegressor(model.model, model.data, q[i], dq[i], ddq[i])
    sign = np.tanh(dq / smooth_rad_per_s)
    for joint, (kind, values) in itertools.product(range(n), enumerate((ddq, dq, sign))):
        columns[:, joint, BODY_PARAMETERS * n + kind * n + joint] = values[:, joint]
    return columns


def base_of(model: ArmModel) -> Base:
    """Base parameters of an arm.

    Columns are taken in the order in which their parameters are wanted: friction, rotor inertia, first moments,
    inertia, mass; one that depends on those before it is not kept.
    """
    n, random = model.n, np.random.default_rng(0)
    q, dq, ddq = random.uniform(-1.5, 1.5, (_STATES, n)), *random.normal(size=(2, _STATES, n))
    columns = all_columns(model, q, dq, ddq, 0.01)
    columns = columns.reshape(_STATES * n, -1)
    kept: list[int] = []
    directions: Matrix = np.zeros((len(columns), 0))
    for k in _wanted_first(model):
        column = columns[:, k]
        own = column - directions @ (directions.T @ column)
        own -= directions @ (directions.T @ own)  # once more, against rounding
        size = float(np.linalg.norm(own))
        if size > INDEPENDENT * max(float(np.linalg.norm(column)), INDEPENDENT):
            kept.append(k)
            directions = np.column_stack([directions, own / size])
    combination: Matrix = np.linalg.pinv(columns[:, kept]) @ columns
    combination[np.abs(combination) < 1e-9] = 0.0
    return Base(model.joints, tuple(kept), combination)


def described_parameters(arm: Arm, model: ArmModel) -> Vector:
    """(13 n,) parameters as URDF and arm file have them."""
    servos = arm.servos
    friction = [s.viscous_Nm_s_per_rad.value for s in servos], [s.coulomb_Nm.value for s in servos]
    return np.concatenate([arm_parameters(model), arm.rotor_inertia, *friction])


def object_torque(cell: Cell, model: ArmModel, columns: Matrix) -> Matrix:
    """(k, n) torque that the known object takes, from the columns of the body that carries it."""
    obj = cell.file.object
    carrier = model.model.frames[model.object_id]
    about_object = pin.Inertia.FromDynamicParameters(
        object_parameters(obj.mass_kg, np.array(obj.inertia_kg_m2.matrix()))
    )
    parameters = carrier.placement.act(about_object).toDynamicParameters()
    first = BODY_PARAMETERS * (carrier.parentJoint - 1)
    torque: Matrix = columns[:, :, first : first + BODY_PARAMETERS] @ parameters
    return torque


def _wanted_first(model: ArmModel) -> list[int]:
    """All parameters: friction, rotor inertia, first moments that the own joint swings, inertia, the rest.

    A first moment along the body's own axis, and its mass, act as parameters of the body before.
    """
    n = model.n
    pin.computeJointJacobians(model.model, model.data, pin.neutral(model.model))
    swung, carried, inertia = [], [], []
    for j in range(n):
        axis = pin.getJointJacobian(model.model, model.data, j + 1, pin.ReferenceFrame.LOCAL)[3:, j]
        along = 1 + int(np.argmax(np.abs(axis)))
        swung += [BODY_PARAMETERS * j + k for k in FIRST_MOMENTS if k != along]
        carried += [BODY_PARAMETERS * j + along, BODY_PARAMETERS * j]
        inertia += [BODY_PARAMETERS * j + k for k in range(4, BODY_PARAMETERS)]
    rotor = BODY_PARAMETERS * n
    return [*range(rotor + n, rotor + 3 * n), *range(rotor, rotor + n), *swung, *inertia, *carried]


def _parameter_name(k: int, joints: tuple[str, ...]) -> str:
    n = len(joints)
    if k < BODY_PARAMETERS * n:
        return f"{BODY_NAMES[k % BODY_PARAMETERS]}({joints[k // BODY_PARAMETERS]})"
    kind, joint = divmod(k - BODY_PARAMETERS * n, n)
    return f"{JOINT_NAMES[kind]}({joints[joint]})"


def _factor(c: float) -> str:
    return "" if abs(abs(c) - 1.0) < 1e-6 else f"{abs(c):.4g} "
