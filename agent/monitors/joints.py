"""Monitors of the joints' motion: speed, power, position, and a reading that does not move."""

from __future__ import annotations

from agent.modes import Mode
from agent.monitors.bounds import Bounds
from agent.monitors.tick import Tick, digits, sentence
from agent.phases import ALONE

FROZEN_S = 0.05  # a reading that stays the same for less says nothing


class Speed:
    """No joint turns faster than its bound."""

    def __init__(self, bounds: Bounds) -> None:
        self._joints, self._bounds = bounds.joints, bounds.speed_rad_per_s
        self._alone = bounds.speed_alone_rad_per_s

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        bounds = self._alone if at.mode in ALONE else self._bounds
        for joint, dq, bound in zip(self._joints, at.dq, bounds, strict=True):
            if not -bound <= dq <= bound:
                n = digits(2, abs(dq), bound)
                return sentence(
                    f"speed of {joint}", f"{dq:.{n}f} rad/s", f"at most {bound:.{n}f} rad/s",
                    "look for a gain that is too high, a broken grasp or a slipped load before the next start",
                )  # fmt: skip
        return ""


class Power:
    """No joint's torque works faster than its bound, in either direction."""

    def __init__(self, bounds: Bounds) -> None:
        self._joints, self._bounds = bounds.joints, bounds.power_W

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        for joint, tau, dq, bound in zip(self._joints, at.tau, at.dq, self._bounds, strict=True):
            if not -bound <= tau * dq <= bound:
                n = digits(2, abs(tau * dq), bound)
                return sentence(
                    f"power of {joint}", f"{tau * dq:.{n}f} W ({tau:.2f} N·m at {dq:.2f} rad/s)",
                    f"at most {bound:.{n}f} W", "look for a gain that is too high, or somebody who pushes the arm",
                )  # fmt: skip
        return ""


class Position:
    """Every joint stays away from its end stops; an arm that holds nothing may also be as near to them as it rests."""

    def __init__(self, bounds: Bounds) -> None:
        self._joints, self._bounds = bounds.joints, bounds.position_rad
        self._alone = bounds.position_alone_rad

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        bounds = self._alone if at.mode in ALONE else self._bounds
        for joint, q, (low, high) in zip(self._joints, at.q, bounds, strict=True):
            if not low <= q <= high:
                n = digits(3, q, low, high)
                return sentence(
                    f"position of {joint}", f"{q:.{n}f} rad", f"{low:.{n}f} to {high:.{n}f} rad",
                    "start from the pose that `coop check` shows; move the base or the motion if it ends there",
                )  # fmt: skip
        return ""


class Frozen:
    """A joint that the motion moves does not read the same for ever.

    A reading that stays the same to the bit while the motion asks the joint to turn by more than `frozen_rad`, and the
    feedback pushes harder than friction could resist, is that of a dead encoder or of a joint that is held fast.
    """

    def __init__(self, bounds: Bounds) -> None:
        self._joints, self._rad, self._Nm = bounds.joints, bounds.frozen_rad, bounds.frozen_Nm
        self._period_s, self._least = bounds.period_s, round(FROZEN_S / bounds.period_s)
        self._last = [float("nan")] * len(bounds.joints)
        self._same = [0] * len(bounds.joints)  # ticks in a row
        self._asked_rad = [0.0] * len(bounds.joints)  # since the reading last changed

    def check(self, at: Tick) -> str:
        """See `agent.monitors.tick.Monitor`."""
        terms = at.outcome.terms
        if at.mode is not Mode.TRACK or terms is None or terms.J_inv_P is None:
            return ""
        wanted = terms.J_inv_P.dot(terms.desired.v).tolist()
        last, same, asked, period_s = self._last, self._same, self._asked_rad, self._period_s
        for j, (q, dq_des) in enumerate(zip(at.q, wanted, strict=True)):
            if q != last[j]:
                last[j], same[j], asked[j] = q, 0, 0.0
                continue
            same[j] += 1
            asked[j] += dq_des * period_s
            if same[j] >= self._least and abs(asked[j]) > self._rad:
                pushed = float(terms.tau_feedback[j])
                if abs(pushed) > self._Nm[j]:
                    return self._said(j, pushed)
        return ""

    def _said(self, j: int, pushed_Nm: float) -> str:
        return sentence(
            f"reading of {self._joints[j]}",
            f"{self._last[j]:.4f} rad for {self._same[j]} cycles against {pushed_Nm:.2f} N·m of feedback",
            f"a turn of about {self._asked_rad[j]:.3f} rad",
            "free the joint; if it turns freely, its encoder is dead: change the servo",
        )
