"""The figures of a report, worked out again from the MCAP file: its schemas, mcap and numpy, nothing of the product.

Formulas are those of docs/report.md.  A figure that both have wrong in the same way would have to be wrong in two
pieces of code that share no line.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from numpy.typing import NDArray

from tests.process.conftest import WAITING, RunOf

Array = NDArray[Any]
TYPES = {"uint64": "<u8", "int64": "<i8", "float64": "<f8", "uint32": "<u4"}
TRACK = 2  # the mode of a row that follows the trajectory
STALL_OF_SERVO_Nm = {"shoulder": 6.0, "elbow": 6.0, "wrist_angle": 2.5}  # of the Mark II, docs/arms.md
SPACE = ("three_wx250s", "--duration", 1.5, "--set", "report.transient_s=0.5", "--set", "simulation.ready_s=0.5")


@dataclass
class Read:
    """What a log has: rows by member, attachments, how many events."""

    rows: dict[str, Array] = field(default_factory=dict)
    joints: dict[str, list[str]] = field(default_factory=dict)
    run: dict[str, Any] = field(default_factory=dict)
    events: int = 0

    def in_run(self, member: str) -> Array:
        """The rows of the motion."""
        rows = self.rows[member]
        return rows[(rows["t"] > -1e-9) & (rows["t"] < self.run["duration_s"] - 1e-9)]


def row_type(definition: str) -> np.dtype[Any]:
    """Of a ros2msg definition whose fields are numbers and fixed arrays, as CDR lays them out behind its header."""
    fields: list[Any] = [("header", "<u4")]
    for kind, length, name in re.findall(r"(?m)^(\w+?64|uint32)(?:\[(\d+)\])? (\w+)", definition):
        fields.append((name, TYPES[kind], (int(length),)) if length else (name, TYPES[kind]))
    return np.dtype(fields)


def read(path: Path) -> Read:
    found, types, messages = Read(), dict[str, Any](), dict[str, list[bytes]]()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if schema.name.startswith("coop_msgs/"):
                member = channel.metadata["member"]
                types[member] = row_type(schema.data.decode())
                messages.setdefault(member, []).append(message.data)
                found.joints[member] = json.loads(channel.metadata.get("joints", "[]"))
            found.events += channel.topic.endswith("/event")
        attached = {a.name: a.data for a in reader.iter_attachments()}
    found.run = json.loads(attached["run.json"])
    found.rows = {member: np.frombuffer(b"".join(own), types[member]) for member, own in messages.items()}
    return found


def product(a: Array, b: Array) -> Array:
    w = a[:, 0] * b[:, 0] - np.einsum("ij,ij->i", a[:, 1:], b[:, 1:])
    return np.column_stack([w, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])])


def conjugate(q: Array) -> Array:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def turned(q: Array, v: Any) -> Array:
    pure = np.column_stack([np.zeros(len(q)), np.broadcast_to(v, (len(q), 3))])
    return product(product(q, pure), conjugate(q))[:, 1:]


def of_vector(rho: Array) -> Array:
    angle = np.linalg.norm(rho, axis=1)[:, None]
    axis = np.divide(rho, angle, out=np.zeros_like(rho), where=angle > 0.0)
    return np.hstack([np.cos(angle / 2.0), np.sin(angle / 2.0) * axis])


def angle(q: Array) -> Array:
    return 2.0 * np.arctan2(np.linalg.norm(q[:, 1:], axis=1), np.abs(q[:, 0]))


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def sizes(wrench: Array, name: str) -> dict[str, float]:
    force, moment = np.linalg.norm(wrench[:, :3], axis=1), np.linalg.norm(wrench[:, 3:], axis=1)
    return {
        f"{name}.max_force_N": force.max(), f"{name}.rms_force_N": rms(force),
        f"{name}.max_moment_Nm": moment.max(), f"{name}.rms_moment_Nm": rms(moment),
    }  # fmt: skip


def errors(place: str, t: Array, e_p: Array, e_xi: Array, transient_s: float) -> dict[str, float]:
    """Largest and rms after the transient, and how the start decays."""
    position, attitude = np.linalg.norm(e_p, axis=1), angle(e_xi)
    late = t >= transient_s - 1e-9
    above = np.flatnonzero(position > 0.1 * position[0])[-1]
    return {
        f"{place}.rows": late.sum(),
        f"{place}.max_position_error_m": position[late].max(), f"{place}.rms_position_error_m": rms(position[late]),
        f"{place}.max_attitude_error_rad": attitude[late].max(), f"{place}.rms_attitude_error_rad": rms(attitude[late]),
        f"{place}.t_max_position_s": t[late][position[late].argmax()],
        f"{place}.position.initial": position[0],
        f"{place}.position.tenth_s": t[above + 1] - t[0] if position[0] and above + 1 < len(t) else np.nan,
    }  # fmt: skip


def of_arm(log: Read, arm: str) -> dict[str, float]:
    rows, period_s, place = log.in_run(arm), 1.0 / log.run["rate_hz"], f"arms.{arm}"
    every = log.rows[arm]  # its wait for the start, too
    assert (rows["mode"] == TRACK).all()
    e_xi = product(rows["quat_object_des"], conjugate(rows["quat_object"]))
    found = errors(f"by_arm.{arm}", rows["t"], rows["p_object"] - rows["p_object_des"], e_xi, log.run["transient_s"])
    for j, joint in enumerate(log.joints[arm]):
        sent, peak_Nm = rows["tau_sent"][:, j], np.abs(every["tau_sent"][:, j]).max()
        cut = np.abs(every["tau_limited"][:, j] - every["tau_cmd"][:, j]) > 1e-9
        found |= {
            f"{place}.joints.{joint}.peak_torque_Nm": peak_Nm,
            f"{place}.joints.{joint}.rms_torque_Nm": rms(sent),
            f"{place}.joints.{joint}.chatter_Nm": np.abs(np.diff(sent)).mean(),
            f"{place}.joints.{joint}.limited_s": cut.sum() * period_s,
        }
        if log.run["cell"] == "paper":
            found[f"peak_torque_fraction.{arm}.{joint}"] = peak_Nm / STALL_OF_SERVO_Nm[joint]
    work = every["read_s"] + every["step_s"] + every["write_s"]
    after = rows[rows["t"] >= log.run["transient_s"] - 1e-9]
    v_error = after["v_object"] - after["v_object_des"]
    found |= {
        f"{place}.late_cycles": (every["late_s"] > period_s).sum(),
        f"{place}.overruns": (every["late_s"] + work > period_s).sum(),
        f"{place}.timing.step_s.p50_s": np.sort(every["step_s"])[int(np.ceil(0.5 * (len(every) - 1)))],
        f"{place}.timing.step_s.p99_s": np.sort(every["step_s"])[int(np.ceil(0.99 * (len(every) - 1)))],
        f"{place}.timing.step_s.max_s": every["step_s"].max(),
        f"{place}.shift_max_m": np.linalg.norm(every["shift"][:, :3], axis=1).max(),
        f"{place}.shift_max_rad": np.linalg.norm(every["shift"][:, 3:], axis=1).max(),
        f"{place}.sigma_min": rows["sigma_min"].min(),
        f"{place}.rms_velocity_error_m_per_s": rms(np.linalg.norm(v_error[:, :3], axis=1)),
        f"rows.{arm}.recorded": len(log.rows[arm]),
        f"rows.{arm}.lost": 0,
        **sizes(rows["wrench_cmd"], f"{place}.wrench_cmd"),
    }
    return found


def of_truth(log: Read, arms: list[str]) -> dict[str, float]:
    """The true pose against the motion of the cell file, and what the grasps carried."""
    first, transient_s = log.in_run(arms[0]), log.run["transient_s"]
    _, i, j = np.intersect1d(log.rows["plant"]["stamp_ns"], first["stamp_ns"], return_indices=True)
    true, wanted = log.rows["plant"][i], first[j]
    p_des = wanted["p_object_des"] - wanted["shift"][:, :3]
    quat_des = product(conjugate(of_vector(wanted["shift"][:, 3:])), wanted["quat_object_des"])
    e_xi = product(quat_des, conjugate(true["quat_object"]))
    found = errors("by_plant", wanted["t"], true["p_object"] - p_des, e_xi, transient_s)
    late = wanted["t"] >= transient_s - 1e-9
    wrench = true["grasp_wrench"][late][:, : 6 * len(arms)].reshape(-1, len(arms), 6)
    force, moment = wrench[:, :, :3], wrench[:, :, 3:]
    places = {arm["name"]: arm["p_object_ee_m"] for arm in log.run["arms"]}
    lever = np.stack([turned(true["quat_object"][late], places[arm]) for arm in arms], axis=1)
    total = force.sum(axis=1)
    total_moment = (moment + np.cross(lever, force)).sum(axis=1)
    assert rms(total_moment) < 0.05 * rms(moment), "levers are right: what all grasps do hardly turns the object"
    share = total[:, None] / len(arms)
    internal = np.concatenate(
        [force - share, moment - total_moment[:, None] / len(arms) + np.cross(lever, share)], axis=2
    )
    for n, arm in enumerate(arms):
        found |= sizes(internal[:, n], f"arms.{arm}.internal_realised")
        found[f"arms.{arm}.load_share_realised"] = (force[:, n] * total).sum() / (total**2).sum()
    return found


def apart(log: Read, arms: list[str]) -> dict[str, float]:
    most, left = [], []
    for one, other in combinations(arms, 2):
        a, b = log.in_run(one), log.in_run(other)
        assert np.array_equal(a["stamp_ns"], b["stamp_ns"])
        d = a["p_object"] - b["p_object"]
        most.append(np.linalg.norm(d[a["t"] >= log.run["transient_s"] - 1e-9], axis=1).max())
        left.append(np.linalg.norm(d[-1] - a["shift"][-1, :3] + b["shift"][-1, :3]))
    shifted = any(log.in_run(arm)["shift"][:, :3].any() for arm in arms)
    return {"arm_disagreement_m": max(most), "arm_disagreement_left_m": max(left) if shifted else np.nan}


def told(results: Any, name: str) -> float:
    for key in name.split("."):
        results = results[key]
    return np.nan if results is None else float(results)


@pytest.mark.parametrize("kind", ["two arms", "aligning", pytest.param("six joints", marks=pytest.mark.long)])
def test_every_figure_comes_out_of_the_file_a_second_time(
    kind: str, paper_runs: tuple[Path, Path], run_of: RunOf
) -> None:
    words = {"aligning": WAITING, "six joints": (*SPACE, "--no-report")}
    folder = run_of(*words[kind]) if kind in words else paper_runs[0]
    log, results = read(folder / "run.mcap"), json.loads((folder / "results.json").read_text())
    arms = [arm["name"] for arm in log.run["arms"]]
    found = of_truth(log, arms) | apart(log, arms)
    for arm in arms:
        found |= of_arm(log, arm)
    found |= {f"{name}_error_{unit}": found[f"by_plant.{name}_error_{unit}"] for name, unit in HEADLINE}
    found |= {"rows_recorded": sum(len(log.rows[arm]) for arm in arms), "events": log.events}
    other = {
        name: (float(own), told(results, name))
        for name, own in found.items()
        if not np.isclose(own, told(results, name), rtol=1e-6, atol=1e-12, equal_nan=True)
    }
    assert not other, "from the file, in results.json"
    assert np.isfinite(found["arm_disagreement_left_m"]) == (kind != "two arms"), "shifts are seen where there are any"


HEADLINE = [
    (f"{size}_{what}", unit) for size in ("max", "rms") for what, unit in (("position", "m"), ("attitude", "rad"))
]
