"""Pose errors and the reference velocity of the paper; pure, no state.

Two printed signs do not hold and are not used: the middle row of `eq:reference signals` (the reference is
v_d − K e, so the attitude part is ω_d + k_ε e_η e_ε) and the Lyapunov functions (the attitude part is
1 − e_η², not e_η² − 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from agent.control.quaternion import Quat, Vec3
from agent.control.trajectory import Desired, Vec6

HALF_ANGLE: Vec6 = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5)  # H: near zero, `Errors.e` of a small displacement and turn


@dataclass(frozen=True, slots=True)
class Gains:
    """Controller gains in world axes; the paper's scalars are the special case of equal entries."""

    k_p: Vec3  # 1/s
    k_eps: Vec3  # rad/s
    k_p_rate: Vec3  # the same in the derivative of the reference velocity (the paper: equal to k_p)
    k_eps_rate: Vec3
    k_v: Vec6  # N·s/m, N·m·s/rad


class Errors(NamedTuple):
    """All errors of one tick, world axes, linear first."""

    e_p: Vec3
    e_eta: float
    e_eps: Vec3
    e: Vec6  # [e_p; −e_η e_ε]
    v_ref: Vec6
    dv_ref: Vec6
    e_v: Vec6


def attitude_error(quat: Quat, quat_des: Quat) -> tuple[float, Vec3]:
    """Attitude error (e_η, e_ε) of e_ξ = ξ_d ⊗ ξ*."""
    n, x, y, z = quat
    nd, xd, yd, zd = quat_des
    e_eta = n * nd + x * xd + y * yd + z * zd  # eq:quat_error
    e_eps = (  # eq:quat_error
        n * xd - nd * x + y * zd - z * yd,
        n * yd - nd * y + z * xd - x * zd,
        n * zd - nd * z + x * yd - y * xd,
    )
    return e_eta, e_eps


def attitude_angle(e_eta: float, e_eps: Vec3) -> float:
    """Angle of that error, rad in [0, π]."""
    return 2.0 * math.atan2(math.hypot(*e_eps), abs(e_eta))


def evaluate(p: Vec3, quat: Quat, v: Vec6, des: Desired, gains: Gains) -> Errors:
    """Errors, reference twist v_r = v_d − K e and its analytic derivative.

    p, quat, v: object pose and twist (world axes, linear first) by this arm's own kinematics.
    """
    (px, py, pz), (vx, vy, vz, ox, oy, oz), (pdx, pdy, pdz) = p, v, des.p
    vdx, vdy, vdz, odx, ody, odz = des.v
    adx, ady, adz, bdx, bdy, bdz = des.a
    (kpx, kpy, kpz), (kex, key, kez) = gains.k_p, gains.k_eps
    (kprx, kpry, kprz), (kerx, kery, kerz) = gains.k_p_rate, gains.k_eps_rate
    e_p = (px - pdx, py - pdy, pz - pdz)  # eq:position error
    x, y, z = e_p
    e_eta, e_eps = attitude_error(quat, des.quat)
    ex, ey, ez = e_eps
    dpx, dpy, dpz = vx - vdx, vy - vdy, vz - vdz  # eq:position error dynamics
    wx, wy, wz = ox - odx, oy - ody, oz - odz
    # ė_η = ½ e_εᵀ e_ω;  ė_ε = −½ (e_η I + S(e_ε)) e_ω − S(e_ε) ω_d
    de_eta = 0.5 * (ex * wx + ey * wy + ez * wz)  # eq:eta_error dynamics
    dex = -0.5 * (e_eta * wx + (ey * wz - ez * wy)) - (ey * odz - ez * ody)  # eq:epsilon error dynamics
    dey = -0.5 * (e_eta * wy + (ez * wx - ex * wz)) - (ez * odx - ex * odz)  # eq:epsilon error dynamics
    dez = -0.5 * (e_eta * wz + (ex * wy - ey * wx)) - (ex * ody - ey * odx)  # eq:epsilon error dynamics
    rx, ry, rz = -e_eta * ex, -e_eta * ey, -e_eta * ez
    v_ref = (  # v_r = v_d − K e, eq:reference signals
        vdx - kpx * x,
        vdy - kpy * y,
        vdz - kpz * z,
        odx - kex * rx,
        ody - key * ry,
        odz - kez * rz,
    )
    dv_ref = (  # v̇_r = v̇_d − K ė,  ė = [ė_p; −ė_η e_ε − e_η ė_ε] with eq:error_dynamics
        adx - kprx * dpx,
        ady - kpry * dpy,
        adz - kprz * dpz,
        bdx + kerx * (de_eta * ex + e_eta * dex),
        bdy + kery * (de_eta * ey + e_eta * dey),
        bdz + kerz * (de_eta * ez + e_eta * dez),
    )
    ux, uy, uz, ua, ub, uc = v_ref
    e_v = (vx - ux, vy - uy, vz - uz, ox - ua, oy - ub, oz - uc)  # eq:reference error
    return Errors(e_p, e_eta, e_eps, (x, y, z, rx, ry, rz), v_ref, dv_ref, e_v)
