"""The text of a cell file, with a comment where a number was chosen and not given."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pinocchio as pin

from agent.config.schema.simulation import Simulation
from agent.make.wish import ArmWish, MotionKind, MotionWish, ShapeKind, Vec3, Wish
from agent.verify.usual_gains import PLANAR, SPATIAL, UsualGains
from drivers.interface import Vector
from drivers.substeps import fewest_substeps

WAIT_S: Final = 1.0
SETTLE_S: Final = 2.0
READY_S: Final = 4.0
RAMP_S: Final = 3.0


@dataclass(frozen=True, slots=True)
class Placed:
    """One arm as it is to stand in the file."""

    wish: ArmWish
    controlled: tuple[str, ...]
    locked: tuple[str, ...]
    base: tuple[float, float, float, float]
    grasp: pin.SE3
    q_near: Vector
    share: float


def duration_s(motion: MotionWish) -> float:
    """Length of a run: the motion once, and at rest again; a sinusoid for two periods."""
    if motion.kind is MotionKind.SINUSOID:
        return 2.0 * motion.time_s + RAMP_S
    if motion.kind is MotionKind.WAYPOINTS:
        return motion.points[-1][0] + SETTLE_S
    return 2.0 * (WAIT_S + motion.time_s) + SETTLE_S


def cell_text(wish: Wish, height_m: float, arms: Sequence[Placed], *, spatial: bool) -> str:
    """The whole file."""
    gains = SPATIAL if spatial else PLANAR
    parts = [*_head(wish, height_m, spatial), *_control(wish, gains)]
    for mark, arm in enumerate(arms, start=1):
        parts += _arm(arm, gains, mark, wish.folder)
    return "\n".join(parts) + "\n"


def _head(wish: Wish, height_m: float, spatial: bool) -> Iterator[str]:
    what, (x, y, z) = wish.object, wish.object.size_m
    solid = {ShapeKind.BOX: "box", ShapeKind.BAR: "bar", ShapeKind.CYLINDER: "cylinder along x"}[what.shape]
    yield f"# Made by `coop new`: {len(wish.arms)} arms and an object of {what.mass_kg:g} kg."
    only = "" if spatial else "; arms move in x and z alone"
    yield f"# World: z up, the origin on the table below the object{only}."
    yield "format = 1"
    yield f'name = "{wish.name}"'
    yield 'driver = "sim"  # "dynamixel" for real arms, with [session] below'
    yield f"rate_hz = {wish.rate_hz!r}"
    yield f"duration_s = {duration_s(wish.motion)!r}"
    yield "\n[world]\ngravity_m_per_s2 = [0.0, 0.0, -9.81]"
    yield "\n[table]\nz_m = 0.0"
    yield f"\n[object]\nmass_kg = {what.mass_kg!r}\nsize_m = {_list((x, y, z))}"
    yield f"# solid {solid} of uniform density" if what.inertia_kg_m2 is None else "# as given"
    xx, yy, zz = (float(f"{moment:.5g}") for moment in what.moments())
    yield f"inertia_kg_m2 = {{ xx = {xx!r}, yy = {yy!r}, zz = {zz!r} }}"
    chosen = "  # proposed height" if wish.height_m is None else ""
    yield f"p_start_m = {_list((0.0, 0.0, height_m))}{chosen}\nquat_start = [1.0, 0.0, 0.0, 0.0]"
    yield "\n[trajectory]"
    yield from _motion(wish.motion, height_m)


def _motion(motion: MotionWish, height_m: float) -> Iterator[str]:
    start = (0.0, 0.0, height_m)
    if motion.kind is MotionKind.SINUSOID:
        yield f'kind = "sinusoid"\np_centre_m = {_list(start)}\np_amplitude_m = {_list(motion.by_m)}'
        yield "axis = [0.0, 1.0, 0.0]\nangle_rad = 0.0"
        yield f"period_s = {motion.time_s!r}\nramp_s = {RAMP_S!r}  # from rest"
    elif motion.kind is MotionKind.WAYPOINTS:
        yield 'kind = "waypoints"\npoints = ['
        yield f"  {{ t_s = 0.0, p_m = {_list(start)} }},"
        yield from (f"  {{ t_s = {t!r}, p_m = {_list(_plus(start, p))} }}," for t, p in motion.points)
        yield "]"
    else:
        yield f'kind = "rest_to_rest"\np_from_m = {_list(start)}\np_to_m = {_list(_plus(start, motion.by_m))}'
        yield f"move_s = {motion.time_s!r}\nwait_s = {WAIT_S!r}\nand_back = true"


def _control(wish: Wish, gains: UsualGains) -> Iterator[str]:
    yield '\n[controller]\nkind = "known"'
    yield "# stiffer is more exact and unstable sooner; `coop tune` searches, `coop check` judges"
    yield f"k_p_per_s = {gains.k_p!r}\nk_eps_rad_per_s = {gains.k_eps!r}"
    yield f"k_p_rate_per_s = {gains.k_p_rate!r}\nk_eps_rate_rad_per_s = {gains.k_eps_rate!r}"
    yield 'friction_feedforward = true\nvelocity = "observer"'
    yield f"\n[controller.observer]\nposition_gain = {gains.position_gain!r}\nvelocity_gain = {gains.velocity_gain!r}"
    yield f"velocity_from_position_per_s = {gains.velocity_from_position_per_s!r}"
    yield f"\n[simulation]\nready_s = {READY_S!r}  # the arms wait so long before the start"
    fewest = fewest_substeps(wish.rate_hz)
    if fewest > Simulation.default().substeps_per_cycle:
        yield f"substeps_per_cycle = {fewest}  # the least at this rate"
    transient = RAMP_S if wish.motion.kind is MotionKind.SINUSOID else SETTLE_S
    yield "\n# for real arms: from their rest to the object and back (docs/session.md); every key has a default"
    yield "# [session]\n# lift_m = 0.02  # the object stands so far below its start pose"
    yield f"\n[report]\ntransient_s = {transient!r}\nmax_position_error_m = 1e-3\nmax_attitude_error_rad = 3e-3"


def _arm(arm: Placed, gains: UsualGains, mark: int, folder: Path) -> Iterator[str]:
    wish, (x, y, z, yaw) = arm.wish, arm.base
    down = "" if wish.pose is not None else f", face {wish.face}"
    yield f'\n[[arms]]\nname = "{wish.name}"\nmodel = "{wish.model}"'
    if wish.arm_file is not None:
        beside = Path(os.path.relpath(wish.arm_file, folder)).as_posix()
        yield f"arm_file = {json.dumps(beside, ensure_ascii=False)}"
    yield "# " + ("proposed; measure it where the arm stands" if wish.base is None else "as given")
    turned = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, math.radians(yaw)))
    yield f"p_world_base_m = {_list((x, y, z))}\nquat_world_base = {_quat(turned)}"
    yield f"# end effector in object axes, x out of the gripper{down}"
    yield f"p_object_ee_m = {_list(arm.grasp.translation.tolist())}"
    yield f"quat_object_ee = {_quat(pin.Quaternion(arm.grasp.rotation))}"
    yield f"load_share = {arm.share!r}"
    yield f"k_v_N_s_per_m = {gains.k_v!r}\nk_v_Nm_s_per_rad = {gains.k_v_turn!r}"
    yield "controlled = [" + ", ".join(f'"{joint}"' for joint in arm.controlled) + "]"
    if arm.locked:
        yield "locked_rad = { " + ", ".join(f"{joint} = 0.0" for joint in arm.locked) + " }"
    yield f"q_near_rad = {_list([round(float(q), 3) for q in arm.q_near])}  # holds the object at the start"
    yield "# `coop motors mark` writes the mark into its servos, so that arms whose cables are swapped are refused"
    yield f'dynamixel = {{ port = "/dev/coop/{wish.name}", mark = {mark} }}'


def _plus(a: Vec3, b: Vec3) -> list[float]:
    return [round(x + y, 6) for x, y in zip(a, b, strict=True)]


def _list(values: Sequence[float]) -> str:
    return "[" + ", ".join(repr(round(float(x), 6) + 0.0) for x in values) + "]"


def _quat(q: pin.Quaternion) -> str:
    x, y, z, w = (float(v) for v in q.normalized().coeffs())
    sign = -1.0 if w < 0.0 else 1.0
    return "[" + ", ".join(repr(round(sign * v, 15) + 0.0) for v in (w, x, y, z)) + "]"
