"""What a person sees of an arm while a hand guides it: read from its ring and texts, which wait for nobody."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell
from agent.modes import Mode
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextReader
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.health import Health
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import Kind
from drivers.interface import Vector

SAID = 4  # last warnings that are shown
OFF = "torque off"
LAST = 20  # rows, of which the newest with a state is shown


@dataclass(frozen=True, slots=True)
class JointGlance:
    """One controlled joint."""

    name: str
    q_rad: float
    dq_rad_per_s: float
    room_rad: float  # to the nearer limit
    load: float  # torque as a share of stall
    temperature_C: float  # of its hottest servo; NaN while nothing is known


@dataclass(frozen=True, slots=True)
class Glance:
    """One arm at one instant; before its first row, and without torque, there are no joints."""

    arm: str
    mode: Mode
    t: float = 0.0  # s since it floats, or moves with those that do
    joints: tuple[JointGlance, ...] = ()
    p_m: tuple[float, float, float] = (math.nan,) * 3  # of the end effector, world
    rpy_rad: tuple[float, float, float] = (math.nan,) * 3  # roll, pitch, yaw of the same
    said: tuple[str, ...] = ()  # what the arm had to say, oldest first

    def off(self) -> Glance:
        """The same arm once it has no torque any more: nobody reads its joints."""
        return Glance(self.arm, Mode.OFF, self.t, said=(*self.said, OFF))

    def document(self) -> dict[str, Any]:
        """For scripts; None where there is no number."""

        def known(x: float) -> float | None:
            return round(x, 6) if math.isfinite(x) else None

        return {
            "arm": self.arm,
            "mode": self.mode.name,
            "t_s": known(self.t),
            "p_m": [known(x) for x in self.p_m],
            "rpy_rad": [known(x) for x in self.rpy_rad],
            "joints": [
                {
                    "name": j.name, "q_rad": known(j.q_rad), "dq_rad_per_s": known(j.dq_rad_per_s),
                    "room_rad": known(j.room_rad), "load": known(j.load), "temperature_C": known(j.temperature_C),
                }
                for j in self.joints
            ],
            "said": list(self.said),
        }  # fmt: skip


class Screen(Protocol):
    """Somebody who watches."""

    def phase(self, what: str) -> None:
        """What is being done."""
        ...

    def note(self, text: str) -> None:
        """Something that stays to be read."""
        ...

    def show(self, glances: Sequence[Glance]) -> None:
        """How the arms are."""
        ...


class Window:
    """Looks at one arm."""

    def __init__(self, cell: Cell, arm: Arm, ring: Path) -> None:
        """Its rings are there.  Raises RingError."""
        self._arm, self._model = arm, cell.model(arm)
        self._T_object_ee = arm.T_object_ee
        self._rows, self._texts = RingReader(ring, AGENT_STATE), TextReader(ring)
        self._heat: dict[str, float] = {}
        self._said: deque[str] = deque(maxlen=SAID)

    def close(self) -> None:
        """Give the rings back."""
        self._rows.close()
        self._texts.close()

    def look(self) -> Glance:
        """How it is now."""
        self._listen()
        block = self._rows.read_last(LAST)
        if not block.count:
            return Glance(self._arm.name, Mode.OFF, said=tuple(self._said))
        rows = AGENT_STATE.decode(block.payload)
        seen = np.flatnonzero(np.isfinite(rows["q"]).all(axis=1))
        return self._glance(rows[seen[-1]] if len(seen) else rows[-1])

    def _listen(self) -> None:
        for kind, payload in self._texts.read_new():
            with contextlib.suppress(ValueError):
                if kind is Kind.HEALTH:
                    self._feel(Health.from_json(payload))
                elif (event := Event.from_json(payload)).level is not Level.INFO:
                    self._said.append(event.text)

    def _feel(self, health: Health) -> None:
        heat: dict[str, float] = {}
        for joint, celsius in zip(health.joint, health.temperature_C, strict=True):
            heat[joint] = max(heat.get(joint, -math.inf), celsius)
        self._heat = heat

    def _glance(self, row: np.void) -> Glance:
        n, names = self._arm.n, self._arm.entry.controlled
        q, dq, tau = (np.array(row[field][:n]) for field in ("q", "dq", "tau_limited"))
        low, high = self._model.model.lowerPositionLimit, self._model.model.upperPositionLimit
        room, load = np.minimum(q - low, high - q), np.abs(tau) / self._arm.tau_stall_Nm
        columns = (values.tolist() for values in (q, dq, room, load))
        joints = tuple(
            JointGlance(name, angle, speed, left, share, self._heat.get(name, math.nan))
            for name, angle, speed, left, share in zip(names, *columns, strict=True)
        )
        p, rpy = self._pose(q)
        mode = Mode(int(row["mode"]))
        t = 0.0 if mode is Mode.READY else float(row["t"])
        return Glance(self._arm.name, mode, t, joints, p, rpy, tuple(self._said))

    def _pose(self, q: Vector) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        if not np.isfinite(q).all():
            return (math.nan,) * 3, (math.nan,) * 3
        T = self._model.object_pose(q) * self._T_object_ee
        x, y, z = T.translation.tolist()
        a, b, c = pin.rpy.matrixToRpy(T.rotation).tolist()
        return (x, y, z), (a, b, c)
