"""The range in which each value of a cell can be meant: its ends are in it, and what lies beyond is refused by key."""

from __future__ import annotations

import math
from typing import Any

import pytest
import tomli_w

import configs
from agent.config.cell import ConfigError
from agent.config.reading import override, parse, validate
from agent.config.schema.cell import CellFile

PAPER = configs.CELLS_DIR / "paper.toml"
IDENTIFY = configs.CELLS_DIR / "identify_wx200.toml"

# key, smallest, largest; None: no end, or one that is not in the range
RANGES: list[tuple[str, float | None, float | None]] = [
    ("rate_hz", 20.0, 2000.0),
    ("loop_delay_s", 0.0, 0.005),
    ("duration_s", None, 1e6),
    ("object.mass_kg", 1e-6, 100.0),
    ("object.size_m", 1e-6, 10.0),
    ("object.p_start_m", -100.0, 100.0),
    ("object.inertia_kg_m2.xx", 1e-12, None),
    ("object.inertia_kg_m2.xy", -100.0, 100.0),
    ("trajectory.p_amplitude_m", -100.0, 100.0),
    ("trajectory.angle_rad", -100.0, 100.0),
    ("trajectory.period_s", 0.01, 1e6),
    ("controller.k_p_per_s", None, 1e5),
    ("controller.k_eps_rad_per_s", None, 1e5),
    ("controller.friction_smooth_rad_per_s", 1e-4, 10.0),
    ("controller.observer.position_gain", 0.0, 1.0),
    ("controller.observer.velocity_gain", 0.0, 1.0),
    ("controller.observer.velocity_from_position_per_s", 0.0, 1e4),
    ("controller.adaptive.gamma", 0.0, 1e6),
    ("controller.adaptive.gamma_object", 0.0, 1e6),
    ("controller.adaptive.factor.coulomb", 0.0, 1e6),
    ("controller.adaptive.start_scale", 0.0, 100.0),
    ("controller.adaptive.bounds.slack_m", 0.0, 10.0),
    ("controller.adaptive.bounds.mass_max_kg", 1e-6, 100.0),
    ("controller.adaptive.bounds.viscous_max_Nm_s_per_rad", None, 100.0),
    ("safety.sigma_min", None, 1.0),
    ("safety.start_error_max_m", None, 1.0),
    ("safety.start_error_max_rad", None, math.pi),
    ("safety.tracking_error_max_m", None, 1.0),
    ("safety.tracking_error_max_rad", None, math.pi),
    ("simulation.effects.delay_s", 0.0, 0.5),
    ("simulation.observe_rate_hz", 0.01, 2000.0),
    ("simulation.friction_smooth_rad_per_s", 1e-4, 10.0),
    ("simulation.object_mass_error", -0.99, 10.0),
    ("simulation.ready_s", 0.0, 60.0),
    ("simulation.reality.seed", 0.0, None),
    ("simulation.reality.object", 0.05, 20.0),
    ("simulation.reality.object_centre_m", -0.1, 0.1),
    ("simulation.reality.pads_N_per_m", 10.0, 1e8),
    ("simulation.reality.arms.left.pads_N_per_m", 10.0, 1e8),
    ("simulation.reality.arms.left.pads_Nm_per_rad", 0.01, 1e6),
    ("simulation.reality.pads_Nm_per_rad", 0.01, 1e6),
    ("simulation.reality.pads_damping_ratio", 0.0, 10.0),
    ("simulation.reality.delay_s", 0.0, 0.5),
    ("simulation.reality.arms.left.base_m", -0.1, 0.1),
    ("simulation.reality.arms.left.base_rad", -0.3, 0.3),
    ("simulation.reality.arms.left.grasp_m", -0.1, 0.1),
    ("simulation.reality.arms.left.grasp_rad", -0.3, 0.3),
    ("simulation.reality.arms.left.zeros_rad", -0.3, 0.3),
    ("simulation.reality.arms.left.masses", 0.05, 20.0),
    ("simulation.reality.arms.left.friction", 0.0, 20.0),
    ("simulation.reality.arms.left.link_masses", 0.05, 20.0),
    ("simulation.reality.arms.left.joint_friction", 0.0, 20.0),
    ("simulation.reality.arms.left.breakaway_Nm", 0.0, 20.0),
    ("simulation.reality.arms.left.stribeck_rad_per_s", 1e-3, 100.0),
    ("simulation.reality.arms.left.load_friction", 0.0, 0.9),
    ("simulation.reality.arms.left.torque_constant", 0.05, 20.0),
    ("simulation.reality.arms.left.backlash_rad", 0.0, 0.1),
    ("simulation.reality.arms.left.skew_s", 0.0, 1.0),
    ("tolerance.base_m", 0.0, 0.1),
    ("tolerance.base_rad", 0.0, 0.2),
    ("tolerance.grasp_m", 0.0, 0.1),
    ("tolerance.grasp_rad", 0.0, 0.2),
    ("tolerance.zeros_rad", 0.0, 0.2),
    ("tolerance.masses", 0.0, 0.9),
    ("tolerance.object", 0.0, 0.9),
    ("tolerance.object_centre_m", 0.0, 0.1),
    ("tolerance.torque_constant", 0.0, 0.9),
    ("tolerance.pads_N_per_m", 10.0, 1e8),
    ("tolerance.pads_Nm_per_rad", 0.01, 1e6),
    ("tolerance.pads_damping_ratio", 0.0, 10.0),
    ("tolerance.skew_s", 0.0, 1.0),
    ("tolerance.backlash_rad", 0.0, 0.1),
    ("tolerance.breakaway", 0.0, 5.0),
    ("tolerance.load_friction", 0.0, 0.5),
    ("report.transient_s", 0.0, 1e6),
    ("report.max_position_error_m", None, 100.0),
    ("report.max_attitude_error_rad", None, math.pi),
    ("arms.left.q_near_rad", -100.0, 100.0),
    ("arms.left.p_world_base_m", -100.0, 100.0),
    ("arms.left.locked_rad.waist", -100.0, 100.0),
    ("arms.left.k_v_N_s_per_m", None, 1e5),
    ("arms.left.k_v_Nm_s_per_rad", None, 1e5),
    ("arms.left.internal_wrench_N_Nm", -1e4, 1e4),
    ("arms.left.grip_force_max_N", None, 1e4),
]
FOURIER: list[tuple[str, float | None, float | None]] = [
    ("trajectory.base_period_s", None, 1e6),
    ("trajectory.motion_s", None, 1e6),
    ("trajectory.excursion_max_m", None, 10.0),
    ("trajectory.excursion_max_rad", None, 1.2),
    ("trajectory.frequency_max_hz", None, 50.0),
]
LENGTHS = {"size_m": 3, "p_start_m": 3, "p_amplitude_m": 3, "q_near_rad": 3, "p_world_base_m": 3} | {
    "internal_wrench_N_Nm": 6,
    "tolerance.pads_N_per_m": 2,
    "tolerance.pads_Nm_per_rad": 2,
}
VECTORS = {
    "object_centre_m",
    "base_m",
    "base_rad",
    "grasp_m",
    "grasp_rad",
    "zeros_rad",
    "link_masses",
    "joint_friction",
    "breakaway_Nm",
    "load_friction",
    "torque_constant",
    "backlash_rad",
}


BESIDE = {  # what else the ends of a range need
    "rate_hz": ("simulation.substeps_per_cycle=9",),
    "simulation.reality.pads_N_per_m": ("simulation.reality.pads_Nm_per_rad=50.0",),
    "simulation.reality.pads_Nm_per_rad": ("simulation.reality.pads_N_per_m=1e4",),
    **dict.fromkeys(
        (f"simulation.reality.arms.left.{key}" for key in ("pads_N_per_m", "pads_Nm_per_rad")),
        ("simulation.reality.pads_N_per_m=1e4", "simulation.reality.pads_Nm_per_rad=50.0"),
    ),
    "simulation.reality.pads_damping_ratio": ("simulation.grasp={stiffness_N_per_m=1e4, stiffness_Nm_per_rad=50.0}",),
}


def count_of(key: str) -> int | None:
    """How many numbers the key's value holds; None: one that stands by itself."""
    last = key.rsplit(".", maxsplit=1)[-1]
    if key.startswith("simulation.reality") and last in VECTORS:
        return 3
    return LENGTHS.get(key, LENGTHS.get(last))


def read(path: Any, key: str, value: float) -> CellFile:
    document, count = parse(path.read_bytes(), path), count_of(key)
    value = int(value) if key.endswith(".seed") and value == int(value) else value
    written = value if count is None else [value] * count
    for other in BESIDE.get(key, ()):
        override(document, other)
    override(document, f"{key}={tomli_w.dumps({'v': written}).partition('=')[2].strip()}")
    return validate(CellFile, document, "cell.toml")


def refused(path: Any, key: str, value: float) -> None:
    with pytest.raises(ConfigError, match=key.replace(".", r"\.") + r".* in cell\.toml"):
        read(path, key, value)


@pytest.mark.parametrize(
    ("path", "key", "low", "high"), [(PAPER, *r) for r in RANGES] + [(IDENTIFY, *r) for r in FOURIER]
)
def test_the_ends_of_a_range_are_in_it_and_what_lies_beyond_is_refused(
    path: Any, key: str, low: float | None, high: float | None
) -> None:
    if key != "object.inertia_kg_m2.xy":  # no tensor with such products is physical
        for end in (low, high):
            assert end is None or read(path, key, end)
    refused(path, key, -1e-9 if low is None else low - 1e-6 * (abs(low) or 1.0))
    if low is None:
        refused(path, key, 0.0)
    if high is not None:
        refused(path, key, high + 1e-5 * abs(high))
