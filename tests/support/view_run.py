"""A run of the paper's cell whose joint angles are those of its object poses, with the files that a picture needs."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell, load_cell
from agent.control import ik
from agent.host.info import attachments
from agent.log.read import RunLog
from agent.report.prepared import Prepared, prepare
from tests.support.telemetry.synthetic_run import paper_run

SECONDS = 2.0


@cache
def paper_cell() -> Cell:
    return load_cell(Path("paper"))


def view_log(seconds: float = SECONDS, *, plant: bool = True) -> RunLog:
    """Two arms that follow the paper's trajectory for a while, 200 rows a second."""
    log = paper_run(Path("run.mcap"), duration_s=seconds, plant=plant)
    for name, joints in _joints(seconds).items():
        log.agents[name]["q"][:, :3] = joints
    log.attachments.update(attachments(paper_cell(), log.attachments["run.json"]))
    return log


@cache
def _joints(seconds: float) -> dict[str, np.ndarray]:
    found = {}
    for arm in paper_cell().arms:
        rows = paper_run(Path("run.mcap"), duration_s=seconds).agents[arm.name]
        each = [joints_at(arm, row["p_object"], row["quat_object"]) for row in rows[::10]]
        found[arm.name] = np.repeat(each, 10, axis=0)[: len(rows)]
    return found


def view_run(seconds: float = SECONDS, *, plant: bool = True) -> Prepared:
    return prepare(view_log(seconds, plant=plant))


def joints_at(arm: Arm, p: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Joint angles of an arm that holds the object at this pose."""
    return ik.solve(paper_cell().model(arm), pin.SE3(pin.Quaternion(*quat), p), np.array(arm.entry.q_near_rad))
