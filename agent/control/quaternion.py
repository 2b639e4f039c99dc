"""Unit quaternions, scalar first (η, ε), as tuples of floats; pure functions, never normalises in silence.

Tuples, because every product here is three or four numbers long: a numpy call costs more than the arithmetic.
"""

from __future__ import annotations

import math

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Mat3 = tuple[float, float, float, float, float, float, float, float, float]  # row by row


def cross(a: Vec3, b: Vec3) -> Vec3:
    """S(a) b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def multiply(a: Quat, b: Quat) -> Quat:
    """Hamilton product a ⊗ b."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (  # eq:quat_prod
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(a: Quat) -> Quat:
    """ξ* = (η, −ε)."""
    return (a[0], -a[1], -a[2], -a[3])


def from_axis_angle(axis: Vec3, angle_rad: float) -> Quat:
    """Rotation by `angle_rad` about the unit vector `axis`."""
    s = math.sin(0.5 * angle_rad)
    return (math.cos(0.5 * angle_rad), axis[0] * s, axis[1] * s, axis[2] * s)


def to_matrix(a: Quat) -> Mat3:
    """Rotation matrix of a unit quaternion, row by row."""
    w, x, y, z = a
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


def rotate(r: Mat3, v: Vec3) -> Vec3:
    """R v."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = r
    x, y, z = v
    return (r0 * x + r1 * y + r2 * z, r3 * x + r4 * y + r5 * z, r6 * x + r7 * y + r8 * z)


def rotate_back(r: Mat3, v: Vec3) -> Vec3:
    """Rᵀ v."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = r
    x, y, z = v
    return (r0 * x + r3 * y + r6 * z, r1 * x + r4 * y + r7 * z, r2 * x + r5 * y + r8 * z)


def rotate_through(r: Mat3, m: Mat3, v: Vec3) -> Vec3:
    """R M Rᵀ v: what M does to v, M given in axes turned by R; three products in one call."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = r
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m
    x, y, z = v
    a, b, c = r0 * x + r3 * y + r6 * z, r1 * x + r4 * y + r7 * z, r2 * x + r5 * y + r8 * z
    x, y, z = m0 * a + m1 * b + m2 * c, m3 * a + m4 * b + m5 * c, m6 * a + m7 * b + m8 * c
    return (r0 * x + r1 * y + r2 * z, r3 * x + r4 * y + r5 * z, r6 * x + r7 * y + r8 * z)


def angle_between(a: Quat, b: Quat) -> float:
    """Rotation angle between two attitudes in [0, π]; a and −a are the same attitude."""
    w, x, y, z = multiply(a, conjugate(b))
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))
