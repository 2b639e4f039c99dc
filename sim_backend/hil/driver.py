"""The bridge: a driver made of a real arm that holds nothing and of its twin in the simulated cell.

Its caller sees the real arm, pulled at as the twin's grasp is; while somebody touches the arm, its twin.  What it adds
never waits for the plant: with a twin that has not started, is stale or has gone the real arm moves by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.interface import (
    ArmInfo,
    BusCounters,
    Clock,
    Driver,
    JointState,
    ServoFault,
    ServoHealth,
    StaleStateError,
    Vector,
)
from sim_backend.hil.coupling import Coupling, Here, Settings, TwinState
from sim_backend.hil.errors import HilFault
from sim_backend.hil.gripper import GripperCheck
from sim_backend.hil.guest import Twin

START_S: Final = 60.0  # that the plant may take until all arms are there
_REMEDY: Final = "see the log of the plant; the rehearsal begins anew with all agents"


@dataclass(frozen=True)
class Patience:
    """How long the bridge waits before it gives the twin up."""

    stale_s: float  # without a state of the twin: a fault
    watchdog_s: float  # without a state of the real arm: its servos let go of it, and the twin goes limp
    start_s: float = START_S


_SLACK_S = 0.003  # of the instants of cycles: the loop asks no more once the watchdog's time has passed


class BridgeDriver:
    """`drivers.interface.Driver` of the real arm `real` with its `twin`.

    here: what is known of the arm on its own at q (n,); gripper: looked at before the twin takes part, if given.
    Of the last cycle: `sent` (n,) and what of it was `added`, `q_twin` and `age_s`; sent is NaN where the bus did not
    take it.
    """

    def __init__(
        self,
        real: Driver,
        twin: Twin,
        clock: Clock,
        settings: Settings,
        patience: Patience,
        here: Callable[[Vector], Here],
        gripper: GripperCheck | None = None,
    ) -> None:
        self.coupling = Coupling(settings)
        self._real, self._twin, self._clock = real, twin, clock
        self._patience, self._here, self._gripper = patience, here, gripper
        self._joined = False  # the twin's torque is on
        self._nothing: Vector = np.full(len(settings.clamp_Nm), np.nan)
        self.sent, self.added = self._nothing, self.coupling.addition
        self._wrote = False  # since `taken` was asked
        self._newest: TwinState | None = None
        self._other: Vector = self._nothing
        self._fault: HilFault | None = None
        self._asked: Vector = np.zeros_like(settings.clamp_Nm)  # τ of the last cycle in which the real arm was heard
        self._heard = False  # the real arm, in this cycle
        self._heard_ns = 0  # and last
        self._enabled_ns = 0
        self._arm = ""

    @property
    def counters(self) -> BusCounters:
        """Of the real arm's bus."""
        return self._real.counters

    @property
    def q_twin(self) -> Vector:
        """The twin's joints at the real arm's last instant, (n,) rad; the arm's while the caller sees its twin.

        NaN before there is a twin.
        """
        return self._other if self._newest is not None else self._nothing

    @property
    def touches(self) -> int:
        """How often somebody has touched the arm."""
        return self.coupling.touch.count

    @property
    def age_s(self) -> float:
        """Of the twin's state at the last cycle; infinite before there is one."""
        return self.coupling.age_s if self._newest is not None else np.inf

    def connect(self) -> ArmInfo:
        """The plant first, which refuses what cannot be; then the real arm."""
        plant = self._twin.connect()
        try:
            info = self._real.connect()
        except BaseException:
            self._twin.close()
            raise
        self._arm = info.arm
        text = f"{info.description}; IN THE LOOP of {plant}"
        return ArmInfo(info.arm, info.joints, info.tau_max_Nm, text)

    def enable(self) -> None:
        """Torque on: the real arm's, and the twin's once the gripper is found empty.  Raises DriverError.

        The plant starts with the last arm of the cell.
        """
        self._real.enable()
        self._enabled_ns = self._heard_ns = self._clock.now_ns()
        if self._gripper is None:
            self._join()

    def read(self) -> JointState:
        """State of the real arm, or of its twin while somebody touches it.

        Raises what its driver raises, and HilFault once the twin is lost.
        """
        try:
            state = self._real.read()
        except StaleStateError:
            self._silent()
            raise
        except ServoFault as error:
            whole = error.state is not None and np.isfinite(error.state.q + error.state.dq).all()
            if whole and error.state is not None:
                self._couple(error.state)
                self.coupling.touch.over()  # the caller goes by this state
            else:  # a joint that cannot tell where it is cannot lead its twin
                self._silent()
            raise
        self._couple(state)
        if self._fault is not None:
            raise self._fault.with_state(state)
        q, dq, self._other = self.coupling.seen(state.q, state.dq)
        return JointState(state.stamp_ns, q, dq, state.tau)

    def write(self, tau_Nm: Vector) -> Vector:
        """Command τ and the addition to the real arm, τ and the coupling to the twin; what the servos were told.

        Without a state of the real arm in this cycle the twin keeps the last τ, as servos that hear nothing do.
        """
        self.added, self.sent, self._wrote = self.coupling.addition, self._nothing, True
        if self._heard:
            self._asked[:] = tau_Nm
        try:
            self.sent = self._real.write(tau_Nm + self.added)
        finally:  # also where the bus takes nothing
            self._twin.command(self._asked + self.coupling.on_twin, self._asked + self.coupling.lasting)
        return self.sent

    def taken(self) -> tuple[Vector, Vector]:
        """`sent` and `added` of this cycle; NaN and zeros of one in which nothing was written."""
        wrote, self._wrote = self._wrote, False
        return (self.sent, self.added) if wrote else (self._nothing, np.zeros_like(self.added))

    @property
    def real(self) -> Driver:
        """The real arm's own driver."""
        return self._real

    @property
    def lapsed(self) -> bool:
        """Whether the real arm has stopped listening by itself, where its driver can tell."""
        return bool(getattr(self._real, "lapsed", False))

    def recover(self) -> bool:
        """Let the real arm obey again, where its driver can; once its twin has been given up it moves by itself.

        True when it obeys anew.  Raises DriverError.
        """
        if self._clock.now_ns() - self._heard_ns >= self._patience.watchdog_s * 1e9:  # a loop that asks no more
            self._give_up_twin()
        recover = getattr(self._real, "recover", None)
        return recover is not None and bool(recover())

    def health(self) -> ServoHealth:
        """Of the real arm."""
        return self._real.health()

    def disable(self) -> None:
        """Torque off, the real arm's first."""
        self._real.disable()
        self._twin.limp()

    def close(self) -> None:
        """Give the port back and take leave of the plant."""
        self._real.close()
        self._twin.close()

    # --- the cycle ------------------------------------------------------------------------------------------------

    def _join(self) -> None:
        self._joined, self._gripper = True, None
        self._enabled_ns = self._clock.now_ns()
        self._twin.enable()

    def _look(self, gripper: GripperCheck, state: JointState) -> HilFault | None:
        """Before anything is coupled: is there an object in the gripper that the rehearsal does not know of?"""
        gripper.look(state.stamp_ns, state.q, state.dq, self.sent)
        if gripper.loaded:
            return HilFault(
                f"gripper of arm {self._arm}", found=f"{gripper.share:.0%} of the object's weight in it",
                expected="an empty one: the object of a rehearsal is simulated", remedy="take it out, then start anew",
            )  # fmt: skip
        if gripper.done:
            self._join()
        return None

    def _couple(self, state: JointState) -> None:
        """The cycle of a fresh state of the real arm."""
        self._heard, self._heard_ns = True, self._clock.now_ns()
        self._newest = self._twin.newest() or self._newest
        if self._fault is not None or self._newest is None:
            self.coupling.alone(state.stamp_ns)
        else:
            self.coupling.step(state.stamp_ns, state.q, state.dq, self._newest, self._here(state.q))
            self._other = self.coupling.q_twin
        if self._fault is None:
            self._fault = self._trouble(state) if self._gripper is None else self._look(self._gripper, state)
            if self._fault is not None:
                self._twin.limp()

    def _silent(self) -> None:
        """The cycle had no state: like the servos' watchdog, the twin lets go when that lasts."""
        now_ns = self._clock.now_ns()
        self._heard = False
        if now_ns - self._heard_ns < (self._patience.watchdog_s - _SLACK_S) * 1e9 and self._fault is None:
            self.coupling.unheard()
            return
        self.coupling.alone(now_ns)
        self._give_up_twin()

    def _give_up_twin(self) -> None:
        if self._fault is None:
            self._twin.limp()
            self._fault = HilFault(
                f"twin of arm {self._arm}", found=f"a real arm without a state for {self._patience.watchdog_s:g} s",
                expected="one in every cycle", remedy=_REMEDY,
            )  # fmt: skip

    def _trouble(self, state: JointState) -> HilFault | None:
        """Why arm and twin are no pair any more."""
        what, ended, coupling = f"twin of arm {self._arm}", self._twin.ended, self.coupling
        if ended is not None:
            return HilFault(what, found=f"a plant that is gone ({ended.found})", expected="its state", remedy=_REMEDY)
        if self._newest is None:
            waited_s = (self._clock.now_ns() - self._enabled_ns) * 1e-9
            if waited_s <= self._patience.start_s:
                return None
            return HilFault(
                what, found=f"no state for {waited_s:.0f} s", expected="a plant that all arms of the cell share",
                remedy="run the plant and every agent of the cell on one host",
            )  # fmt: skip
        if coupling.age_s > self._patience.stale_s:
            found = f"a state {coupling.age_s * 1e3:.0f} ms old"
            return HilFault(what, found=found, expected=f"≤ {self._patience.stale_s * 1e3:.0f} ms", remedy=_REMEDY)
        apart_rad, bound_rad = coupling.apart_rad(state.q), coupling.settings.apart_max_rad
        if apart_rad > bound_rad:
            return HilFault(
                what, found=f"{apart_rad:.2f} rad from the arm", expected=f"≤ {bound_rad:g} rad",
                remedy="see what holds the real arm, or gives it another torque than its model says",
            )  # fmt: skip
        return None
