"""What the torque would have been with a changed cell, at the recorded motion.

The recorded joints and modes are the input; what an agent carries from tick to tick (observer, rate limit, estimates)
is that of the changed law, from the first row of the window on.  The arm would then have moved otherwise: the figures
say what differs at the motion that was, not how the run would have gone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.config.agent import build_agent
from agent.config.cell import Arm, Cell
from agent.log.columns import Table
from agent.log.read import ColumnLog
from agent.loop import Agent
from agent.modes import mode_of
from agent.replay.chain import Chain
from agent.replay.rows import Readable, Window, arms_of, blocks
from agent.replay.source import ReplayError
from agent.replay.tick import Rows, is_fresh, state_at
from agent.safety import Flag
from agent.telemetry.row.sample import Layout

LIMITED: Final = Flag.SATURATED | Flag.RATE_LIMITED


@dataclass(frozen=True, slots=True)
class JointFigures:
    """One joint's torque after the limits, N·m."""

    joint: str
    rms_recorded_Nm: float
    rms_Nm: float  # with the change
    rms_difference_Nm: float
    max_difference_Nm: float
    at_s: float  # where that is


@dataclass(frozen=True)
class ArmTorques:
    """One arm's torque as it was and as it would have been; rows without a torque in either are left out."""

    arm: str
    t: NDArray[np.float64]  # (k,) s
    recorded: NDArray[np.float64]  # (k, n) N·m
    changed: NDArray[np.float64]
    limited_recorded: int  # rows that a limit of `agent.safety` cut
    limited: int
    without: int  # rows in which the changed law gave nothing
    joints: tuple[JointFigures, ...]


def what_if(
    log: ColumnLog,
    recorded: Cell,
    changed: Cell,
    window: Window,
    arm: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> tuple[ArmTorques, ...]:
    """Torques of both cells at the recorded rows.

    Raises ReplayError for a change that gives the rows another meaning (rate, joints), ConfigError for an arm less.
    """
    _refuse_other_rows(recorded, changed)
    found = []
    for name in arms_of(log, arm):
        tell(f"computing {name}")
        layout = log.layouts[name]
        own = changed.arm(name)
        _refuse_other_joints(recorded.arm(name), own)
        rows = window.of(log.agents[name])
        if not len(rows):
            raise ReplayError(f"nothing to replay of {name} in {log.path}", expected="some", **window.lacking)
        same_law = recorded.file.controller.kind is changed.file.controller.kind
        found.append(_torques(build_agent(changed, own), own, rows, layout, keep_estimate=not same_law))
    return tuple(found)


def _torques(agent: Agent, arm: Arm, table: Table, layout: Layout, *, keep_estimate: bool) -> ArmTorques:
    readable = Readable.of(layout, arm.name)
    n, chain = agent.model.n, Chain(agent)
    changed = np.full((len(table), n), np.nan)
    flags, at, expected = np.zeros(len(table), np.uint32), 0, None
    with np.errstate(all="ignore"):
        for rows in blocks(table, layout, readable):
            for i, sequence in enumerate(rows["sequence"].tolist()):
                if sequence != expected:
                    _begin(chain, sequence, rows, i, readable, keep_estimate=keep_estimate)
                expected = sequence + 1
                changed[at], flags[at] = _tick(chain, rows, i, n)
                at += 1
    seen = _is_seen(table)
    recorded = table.column("tau_limited", slice(0, n))
    usable = seen & np.isfinite(changed).all(axis=1) & np.isfinite(recorded).all(axis=1)
    t, cut = table["t"], np.uint32(LIMITED.value)
    return ArmTorques(
        arm.name, t[usable], recorded[usable], changed[usable],
        int(np.count_nonzero(table["flags"][usable] & cut)), int(np.count_nonzero(flags[usable] & cut)),
        int(np.count_nonzero(seen & ~usable)),
        _figures(arm.entry.controlled, t[usable], recorded[usable], changed[usable]),
    )  # fmt: skip


def _is_seen(table: Table) -> NDArray[np.bool_]:
    """Rows (k,) of cycles that had a fresh state."""
    return np.asarray(table["flags"] & np.uint32(Flag.STALE.value) == 0)


def _begin(chain: Chain, sequence: int, rows: Rows, i: int, readable: Readable, *, keep_estimate: bool) -> None:
    if sequence == 0:
        chain.start()
    elif readable.memory:
        chain.restore(rows[i], keep_estimate=keep_estimate)
    else:
        raise ReplayError(
            f"row {sequence} of a log of another release", found="a memory that this release cannot read",
            expected="all rows from number 0 on", remedy="replay from the first row of a log without gaps",
        )  # fmt: skip


def _tick(chain: Chain, rows: Rows, i: int, n: int) -> tuple[NDArray[np.float64], int]:
    """Torque (n,) of the changed law at one row, and its flags; NaN where it gives none."""
    row = rows[i]
    flags = int(row["flags"])
    mode = mode_of(int(row["mode"]))
    if mode is None:
        return np.full(n, np.nan), 0
    try:
        _, outcome = chain.pass_row(state_at(rows, i, n), float(row["t"]), mode, flags)
    except (ArithmeticError, ValueError):
        return np.full(n, np.nan), 0
    nothing = outcome.terms is None and is_fresh(flags)
    return (np.full(n, np.nan) if nothing else outcome.tau), int(outcome.flags)


def _figures(
    joints: list[str], t: NDArray[np.float64], recorded: NDArray[np.float64], changed: NDArray[np.float64]
) -> tuple[JointFigures, ...]:
    found = []
    for j, joint in enumerate(joints):
        apart = np.abs(changed[:, j] - recorded[:, j])
        worst = int(np.argmax(apart)) if len(apart) else None
        was, would, off = (_rms(x) for x in (recorded[:, j], changed[:, j], apart))
        largest, at = (float("nan"),) * 2 if worst is None else (float(apart[worst]), float(t[worst]))
        found.append(JointFigures(joint, was, would, off, largest, at))
    return tuple(found)


def _rms(x: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(x * x))) if len(x) else float("nan")


def _refuse_other_rows(recorded: Cell, changed: Cell) -> None:
    if changed.file.rate_hz != recorded.file.rate_hz:
        raise ReplayError(
            "rate_hz", found=f"{changed.file.rate_hz:g}", expected=f"{recorded.file.rate_hz:g}, at which the rows are",
            remedy="run the cell at that rate: `coop run`",
        )  # fmt: skip
    names: Mapping[str, Arm] = {arm.name: arm for arm in changed.arms}
    if set(names) != {arm.name for arm in recorded.arms}:
        raise ReplayError(
            "arms", found=", ".join(names), expected=", ".join(arm.name for arm in recorded.arms),
            remedy="replay changes values, not who is there",
        )  # fmt: skip


def _refuse_other_joints(recorded: Arm, changed: Arm) -> None:
    if changed.entry.controlled != recorded.entry.controlled:
        raise ReplayError(
            f"controlled joints of {changed.name}", found=", ".join(changed.entry.controlled),
            expected=f"{', '.join(recorded.entry.controlled)}, which the rows have",
            remedy="leave `controlled` as it is",
        )  # fmt: skip
