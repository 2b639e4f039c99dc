"""A run whose every row is a closed form: the oracle of the report's tests."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.log.read import RunLog
from agent.modes import Mode
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, PLANT_STATE

POSITION_0 = np.array([0.001, 0.003, 0.0])  # initial error of the paper's experiment, m
ATTITUDE_0 = 0.02  # rad about z
TAU_DECAY_S = 0.25
RIPPLE_M = 2e-4
OFFSETS = {"left": (-0.04, 0.0, 0.0), "right": (0.04, 0.0, 0.0)}
SQUEEZE_N = 1.5
WEIGHT_N = 0.062 * 9.81


def as_log(
    path: Path, agents: dict[str, NDArray[np.void]], plant: NDArray[np.void] | None, run: dict[str, Any]
) -> RunLog:
    """A complete log of these rows; unlike those of a file they can be written to."""
    attachments = {"run.json": json.dumps(run).encode()}
    members = [*agents, *(["plant"] if plant is not None else [])]
    return RunLog(path, run["cell"], agents, plant, [], attachments, {}, True, dict.fromkeys(members, ()))


def run_file(duration_s: float = 100.0, rate_hz: float = 200.0, **changes: Any) -> dict[str, Any]:
    arm = {
        "model": "widowx_mk2",
        "joints": ["shoulder", "elbow", "wrist_angle"],
        "tau_stall_Nm": [6.0, 6.0, 2.5],
        "tau_max_Nm": [3.0, 3.0, 1.25],
        "load_share": 0.5,
    }
    return {
        "cell": "paper",
        "fingerprint": "5f" * 32,
        "rate_hz": rate_hz,
        "duration_s": duration_s,
        "transient_s": 20.0,
        "plane_normal": [0, 0, 1],
        "controller": {"kind": "known", "k_p_per_s": 150.0},
        "driver": "sim",
        "versions": {"widowx-coop": "0.1.0", "python": "3.11"},
        "host": "bench",
        "arms": [arm | {"name": name, "p_object_ee_m": list(OFFSETS[name])} for name in OFFSETS],
        "bounds": {"max_position_error_m": 0.0005, "max_attitude_error_rad": 0.002},
    } | changes


def turn(axis: int, angle: Any) -> NDArray[np.float64]:
    quat = np.zeros((len(angle), 4))
    quat[:, 0], quat[:, 1 + axis] = np.cos(0.5 * angle), np.sin(0.5 * angle)
    return quat


def product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    w = a[:, :1] * b[:, :1] - np.sum(a[:, 1:] * b[:, 1:], axis=1, keepdims=True)
    return np.hstack([w, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])])


def agent_rows(ticks: int, rate_hz: float = 200.0, joints: int = 3, *, first: int = 0) -> NDArray[np.void]:
    """Rows of a run without any error or torque, from tick `first` on: identity attitude, everything else zero."""
    rows = np.zeros(ticks, dtype=AGENT_STATE.dtype)
    rows["encapsulation"] = CDR_LITTLE_ENDIAN
    rows["sequence"] = np.arange(first, first + ticks)
    rows["t"] = rows["sequence"] / rate_hz
    rows["stamp_ns"] = rows["t"] * 1e9
    rows["utc_ns"] = 1_800_000_000_000_000_000 + (rows["t"] * 0.5e9).astype(np.int64)  # twice real time
    rows["mode"] = Mode.TRACK
    rows["joint_count"] = joints
    rows["quat_object_des"][:, 0] = rows["quat_object"][:, 0] = rows["e_eta"] = 1.0
    rows["sigma_min"], rows["friction_factor"] = 0.05, 1.0
    return rows


def plant_rows(agent: NDArray[np.void], arms: int = 2) -> NDArray[np.void]:
    """Plant rows of the same ticks, with the object exactly where it is desired."""
    rows = np.zeros(len(agent), dtype=PLANT_STATE.dtype)
    rows["encapsulation"] = CDR_LITTLE_ENDIAN
    for name in ("sequence", "stamp_ns", "utc_ns", "t"):
        rows[name] = agent[name]
    rows["arm_count"] = arms
    rows["p_object"], rows["quat_object"] = agent["p_object_des"], agent["quat_object_des"]
    return rows


def _set_pose(rows: NDArray[np.void], e_p: NDArray[np.float64], e_angle: NDArray[np.float64]) -> None:
    t = rows["t"]
    swing = np.sin(2 * np.pi * t / 15.0)
    rows["p_object_des"] = np.stack([0.3 + 0.05 * swing, np.full_like(t, 0.12), np.zeros_like(t)], axis=1)
    rows["quat_object_des"] = turn(2, -np.pi / 30.0 * swing)
    rows["p_object"] = rows["p_object_des"] + e_p
    rows["quat_object"] = product(turn(2, e_angle), rows["quat_object_des"])
    rows["e_p"], rows["e_eta"] = e_p, np.cos(0.5 * e_angle)
    rows["e_eps"][:, 2] = -np.sin(0.5 * e_angle)


def _set_torques(rows: NDArray[np.void], side: float, noise: np.random.Generator) -> None:
    t, n = rows["t"], 3
    swing = np.sin(2 * np.pi * t / 15.0)
    for j, (level, size) in enumerate(((0.55, 0.12), (0.25, 0.08), (0.06, 0.02))):
        rows["tau_gravity"][:, j] = level + size * swing * side
        rows["tau_inertia"][:, j] = 0.05 * size * np.cos(2 * np.pi * t / 15.0)
        rows["tau_feedback"][:, j] = 2 * level * np.exp(-t / TAU_DECAY_S) + 0.02 * noise.standard_normal(len(t))
        rows["tau_object"][:, j] = 0.1 * level
        rows["tau_internal"][:, j] = 0.03 * side
        rows["tau_friction"][:, j] = 0.08 * np.tanh(20 * np.cos(2 * np.pi * t / 15.0))
    terms = ("tau_gravity", "tau_inertia", "tau_feedback", "tau_object", "tau_internal", "tau_friction")
    rows["tau_cmd"] = np.sum([rows[f] for f in terms], axis=0)
    rows["tau_limited"] = rows["tau_cmd"]
    rows["tau_sent"][:, :n] = np.round(rows["tau_limited"][:, :n] / 0.005) * 0.005
    squeeze = np.array([-side * SQUEEZE_N, 0.0, 0.0])
    rows["wrench_internal"][:, :3] = squeeze
    rows["wrench_cmd"][:, :3] = squeeze + np.stack([0.2 * swing, np.full_like(t, 2.0), 0 * t], axis=1)
    rows["wrench_cmd"][:, 5] = 0.05 * side + 0.01 * noise.standard_normal(len(t))
    rows["lyapunov"] = 0.5 * np.exp(-2 * t / TAU_DECAY_S) + 1e-7
    for f, scale in (("late_s", 2e-5), ("read_s", 1.2e-3), ("step_s", 9e-5), ("write_s", 6e-5)):
        rows[f] = scale * (1.0 + 0.2 * noise.standard_exponential(len(t)))


def paper_rows(side: float, ticks: int, noise: np.random.Generator, *, first: int = 0) -> NDArray[np.void]:
    """Rows of one planar arm (side −1 or +1) on the paper's trajectory, the start error decaying, a small ripple."""
    rows = agent_rows(ticks, first=first)
    t, decay = rows["t"], np.exp(-rows["t"] / TAU_DECAY_S)
    e_p = POSITION_0 * decay[:, None] + RIPPLE_M * np.sin(2 * np.pi * t)[:, None] * np.array([1.0, 0.0, 0.0])
    _set_pose(rows, e_p, ATTITUDE_0 * decay + 2e-4 * np.sin(3 * t))
    _set_torques(rows, side, noise)
    return rows


def paper_run(path: Path, *, duration_s: float = 100.0, plant: bool = True, adaptive: bool = False) -> RunLog:
    """Two planar arms on the paper's trajectory; its rows are the caller's to change."""
    agents = {name: rows.copy() for name, rows in _paper_agents(duration_s, adaptive).items()}
    controller = {"kind": "adaptive"} if adaptive else {"kind": "known", "k_p_per_s": 150.0}
    content = run_file(duration_s, controller=controller)
    return as_log(path, agents, true_rows(agents["left"]) if plant else None, content)


@lru_cache(maxsize=1)  # a run of 100 s is large
def _paper_agents(duration_s: float, adaptive: bool) -> dict[str, NDArray[np.void]]:
    noise = np.random.default_rng(7)
    ticks = round(duration_s * 200.0)
    agents = {}
    for side, name in ((-1.0, "left"), (1.0, "right")):
        rows = paper_rows(side, ticks, noise)
        t = rows["t"]
        if adaptive:
            rows["theta_arm"][:, :48] = (1 - np.exp(-t / 8.0))[:, None] * np.linspace(0.01, 0.5, 48)
            rows["theta_object"][:, 0] = 0.062 * (1 - np.exp(-t / 5.0))
        agents[name] = rows
    return agents


def true_rows(one: NDArray[np.void]) -> NDArray[np.void]:
    """Rows of the plant for rows of an arm: the object is where the arm sees it, squeezed and carried by both arms."""
    rows = plant_rows(one)
    rows["p_object"], rows["quat_object"] = one["p_object"], one["quat_object"]
    wrench = rows["grasp_wrench"].reshape(len(rows), -1, 6)
    for i, side in enumerate((-1.0, 1.0)):
        wrench[:, i, 0] = -side * SQUEEZE_N * (1 + 0.05 * np.sin(5 * one["t"]))
        wrench[:, i, 1] = 0.5 * WEIGHT_N
        # a moment that undoes the one of its own lift about the object's centre, so that the weight alone is left
        wrench[:, i, 5] = -OFFSETS["left" if i == 0 else "right"][0] * 0.5 * WEIGHT_N
    return rows


def spatial_run(path: Path, *, duration_s: float = 40.0, arms: int = 3) -> RunLog:
    """Six-joint arms and a motion about all axes, without a plant."""
    ticks, noise = round(duration_s * 200.0), np.random.default_rng(3)
    agents, described = {}, []
    for i in range(arms):
        rows = agent_rows(ticks, joints=6)
        _set_pose(rows, 1e-3 * np.exp(-rows["t"])[:, None] * np.ones(3), 0.01 * np.exp(-rows["t"]))
        rows["p_object_des"][:, 2] = rows["p_object"][:, 2] = 0.2 + 0.03 * np.cos(rows["t"])
        _set_torques(rows, 1.0 - i, noise)
        rows["tau_cmd"][:, 3:6] = 0.1 * np.sin(rows["t"])[:, None] * np.arange(1, 4)
        agents[f"arm{i}"] = rows
        described.append(
            {
                "name": f"arm{i}",
                "model": "wx250s",
                "joints": ["waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"],
                "tau_stall_Nm": [2.5] * 6,
                "tau_max_Nm": [2.0] * 6,
                "load_share": 1 / arms,
            }
        )
    content = run_file(duration_s, cell="three_wx250s", plane_normal=None, arms=described, bounds={})
    return as_log(path, agents, None, content)
