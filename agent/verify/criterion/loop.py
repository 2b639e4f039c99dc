"""The laws of the arms near rest, closed around what they move: the map from one sample to the next.

With exact feed-forward, and x̂_i, ŵ_i what the observer of arm i makes of the object's displacement and its rate,

    u_i = −(M̂_i + c_i M̂_O) K' H ŵ_i − k_v (ŵ_i + K H x̃_i) − c_i H x̃_i − V̂_i K H x̃_i,     x̃_i = x̂_i − d_i

(`eq:control law` with `eq:reference signals` about rest), with K and K' the gains in v_r and v̇_r, H = I for position
and ½ I for attitude (e = −e_η e_ε is half the angle), V̂_i the viscous friction of the feed-forward, and d_i the shift
of an arm that aligns itself beyond its dead zone, d_i⁺ = d_i + T α x̃_i (agent.control.alignment).  u is held for one
period that begins the loop's delay after its sample: n − 1 whole periods and a part of one, during which u_{k−n} still
acts before u_{k−n+1} takes over.  The loop is stable when the spectral radius of the map is below one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.control.errors import HALF_ANGLE, Gains
from agent.control.estimator import Observer
from agent.control.models import Matrix
from agent.verify.criterion.bodies import Grip, Motion, Pose
from drivers.interface import Vector

# without an observer the law takes what is measured, which is an observer that corrects everything
_MEASURED = Observer(1.0, position_gain=1.0, velocity_from_position_per_s=0.0, velocity_gain=1.0, delay_periods=0.0)


class Laws(NamedTuple):
    """Of N arms: u_i = −S_i x̃_i − D_i ŵ_i, and a_i = −R ŵ_i, which the observer expects; S and D may be a stack."""

    S: Matrix  # (N, m, m) (k_v + V̂) K H + c H
    D: Matrix  # (N, m, m) k_v + (M̂ + c M̂_O) K' H
    R: Matrix  # (m, m) K' H

    def of(self, arms: Sequence[int]) -> Laws:
        """These arms alone."""
        return Laws(self.S[list(arms)], self.D[list(arms)], self.R)

    def together(self) -> Laws:
        """All as one arm, where all see the same."""
        return Laws(self.S.sum(axis=0, keepdims=True), self.D.sum(axis=0, keepdims=True), self.R)

    def anchor_and_followers(self, anchor: int) -> Laws:
        """One arm, and all others as one."""
        rest = self.of([i for i in range(len(self.S)) if i != anchor]).together()
        own = self.of([anchor])
        return Laws(np.concatenate([own.S, rest.S]), np.concatenate([own.D, rest.D]), self.R)

    def commands(self, x: Matrix, w: Matrix) -> tuple[Matrix, Matrix]:
        """Reference accelerations and wrenches (…, N m, s) of x̃ and ŵ (N m, s)."""
        rows, columns = x.shape
        x, w = (part.reshape(-1, len(self.R), columns) for part in (x, w))
        u = self.S @ x + self.D @ w
        return -(self.R @ w).reshape(rows, columns), -u.reshape(*u.shape[:-3], rows, columns)


def laws(at: Pose, gains: Sequence[Gains]) -> Laws:
    """The laws of all arms at a pose; k_p and k_ε, and their forms in v̇_r, are those of the first."""
    P, first = at.P, gains[0]
    H = P @ np.diag(HALF_ANGLE) @ P.T
    K = P @ np.diag([*first.k_p, *first.k_eps]) @ P.T
    K_rate = P @ np.diag([*first.k_p_rate, *first.k_eps_rate]) @ P.T
    S, D = [], []
    for grip, own in zip(at.grips, gains, strict=True):
        k_v = P @ np.diag(own.k_v) @ P.T
        S.append((k_v + _fed(grip)) @ K @ H + grip.share * H)
        D.append(k_v + (grip.inertia + grip.share * at.object_inertia) @ K_rate @ H)
    return Laws(np.array(S), np.array(D), K_rate @ H)


def _fed(grip: Grip) -> Matrix:
    """V̂ (m, m) of the feed-forward."""
    return grip.viscous if grip.feeds_friction else np.zeros_like(grip.viscous)


class Shifting(NamedTuple):
    """Arms that align themselves: rows of their displacement among those of all, and T α, its share per tick."""

    rows: slice
    per_tick: float


def one_period(motion: Motion, law: Laws, observer: Observer | None, shifting: Shifting | None = None) -> Matrix:
    """The map (…, s, s) of y, all x̂, ŵ, the acceleration expected and the torques of the ticks before, and d."""
    late, follow = motion.on_their_way, (observer or _MEASURED).follow
    begin, rows = motion.F.shape[-1], motion.sees_x.shape[-2]
    fixed = begin + rows * (3 + late)
    size = fixed if shifting is None else fixed + len(range(*shifting.rows.indices(rows)))
    # every quantity is a matrix (…, rows, states): how it follows from the states at the sample before
    states = np.eye(size)
    d, (x, w, a_before, *before) = states[fixed:], states[begin:fixed].reshape(-1, rows, size)
    off = x.copy()
    if shifting is not None:
        off[shifting.rows] -= d
        d = d + shifting.per_tick * off[shifting.rows]
    a, u = law.commands(off, w)
    torques = [u, *before]  # u_k, u_{k−1} … u_{k−n}
    y_next = motion.G_first @ torques[-1] + motion.G_rest @ torques[max(late - 1, 0)]
    y_next[..., :begin] += motion.F
    seen = follow(x, w, a_before, a, motion.sees_x @ y_next, motion.sees_w @ y_next)
    A = np.empty((*y_next.shape[:-2], size, size))
    end = 0
    for part in (y_next, *seen, a, *torques[:late], d):
        A[..., end : end + part.shape[-2], :] = part
        end += part.shape[-2]
    return A


def radii(A: Matrix) -> Vector:
    """Spectral radius (…,) of every map (…, s, s)."""
    found: Vector = np.abs(np.linalg.eigvals(A)).max(axis=-1)
    return found
