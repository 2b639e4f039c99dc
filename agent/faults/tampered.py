"""Faults of an agent's own process and of what it sends: its clock, its driver and its gains, made to fail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from agent.faults.plan import Injection, Kind, Target
from agent.faults.virtual import UTC_OFFSET_NS, SharedClock
from agent.loop import Agent
from drivers.dynamixel.driver import DynamixelDriver
from drivers.interface import JointState, Vector

NS: Final = 1e-9


class AgentGone(Exception):
    """The process of an agent is gone: nothing of it runs any more, not even its end."""


class AgentClock:
    """The clock of one agent whose process may be gone, stand still or be slow; it sees the time of all."""

    utc_offset_ns = UTC_OFFSET_NS

    def __init__(
        self, shared: SharedClock, faults: Sequence[Injection], period_ns: int, zero_ns: Callable[[], int | None]
    ) -> None:
        self._shared = shared
        self._faults = [fault for fault in faults if fault.target is Target.AGENT]
        self._period_ns = period_ns
        self._zero_ns = zero_ns

    def now_ns(self) -> int:
        """Virtual now."""
        return self._shared.now_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at or after the deadline, as the process gets to run.  Raises AgentGone."""
        self._shared.sleep_until(deadline_ns)
        zero_ns = self._zero_ns()
        if zero_ns is None:
            return
        for fault in self._faults:
            begin_ns = zero_ns + round(fault.at_s * 1e9)
            now_ns = self._shared.now_ns()
            if not begin_ns <= now_ns < begin_ns + fault.for_s * 1e9:
                continue
            if fault.kind is Kind.OFF or (fault.kind is Kind.STUCK and fault.for_s == np.inf):
                raise AgentGone
            if fault.kind is Kind.STUCK:
                self._shared.sleep_until(begin_ns + round(fault.for_s * 1e9))
            elif fault.kind is Kind.SLOW:
                self._shared.sleep_until(now_ns + round(fault.amount * self._period_ns))


@dataclass(frozen=True)
class Tampering:
    """What is done to the values between an agent and its arm."""

    faults: Sequence[Injection]
    t: Callable[[], float]  # on the trajectory's clock

    def state(self, state: JointState) -> JointState:
        """What the agent gets."""
        if self._now(Target.AGENT, Kind.GARBAGE) is None:
            return state
        return replace(state, dq=np.full_like(state.dq, np.nan))

    def torque(self, tau_Nm: Vector, tau_max_Nm: Vector) -> Vector:
        """What the arm gets."""
        fault = self._now(Target.ARM, Kind.WRONG)
        if fault is None:
            return tau_Nm
        return np.clip(tau_Nm + fault.amount * tau_max_Nm, -tau_max_Nm, tau_max_Nm)

    def _now(self, target: Target, kind: Kind) -> Injection | None:
        t = self.t()
        some = (f for f in self.faults if (f.target, f.kind) == (target, kind) and f.at_s <= t < f.at_s + f.for_s)
        return next(some, None)


class TamperedDriver(DynamixelDriver):
    """The real driver, with what goes in and out of it changed on the way."""

    tampering: Tampering

    def read(self) -> JointState:
        """As the real one, and then changed."""
        return self.tampering.state(super().read())

    def write(self, tau_Nm: Vector) -> Vector:
        """As the real one, of a changed torque; what the agent is told is what it asked for."""
        tau_max = np.array([joint.tau_max_Nm for joint in self.arm.controlled])
        return super().write(self.tampering.torque(tau_Nm, tau_max))


def with_gains(agent: Agent, times: float) -> Agent:
    """The agent with its velocity gains so many times as large."""
    gains = agent.offline.gains
    k_v: tuple[float, ...] = tuple(times * k for k in gains.k_v)
    return replace(agent, offline=replace(agent.offline, gains=replace(gains, k_v=k_v)))  # type: ignore[arg-type]
