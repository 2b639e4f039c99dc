"""Whether the loop sees its arm: what a cycle does on the bus, the state that a read brings, an arm brought back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agent.cycles import Bus, Cycles
from agent.modes import WAY_BACK, Event, Mode
from drivers.interface import Driver, DriverError, JointState, Recovering, ServoFault, StaleStateError, WaitEnded

KEEPS = frozenset({Mode.HOLD, Mode.HALT, Mode.STAND})  # in which an arm stays until somebody says a word
_BROUGHT_BACK = KEEPS | {Mode.REST}  # where servos that have stopped are made to obey again: the arm stands still


class Sight:
    """One arm as its loop sees it.  unseen: what the last read, or attempt to bring the arm back, failed by; lost:
    the same as an error, where it was one.
    """

    def __init__(
        self, driver: Driver, cycles: Cycles, resumed: Callable[[], None], busy: Callable[[], None], *, lockstep: bool
    ) -> None:
        """busy: is called before the arm is brought back; resumed: once it was, and its torque begins at zero."""
        self.unseen = ""
        self.lost: DriverError | None = None
        self._driver = driver
        self._cycles = cycles
        self._resumed = resumed
        self._busy = busy
        self._lockstep = lockstep
        self._recovering = driver if isinstance(driver, Recovering) else None
        self._fault = ""  # of the servos, as last read
        self._blamed = ""  # why the arm stands, where that is something unseen

    def plan(self, deadline_ns: int, mode: Mode) -> Bus:
        """What this cycle does on the bus; an arm that lapsed and stands is brought back, by its driver."""
        arm = self._recovering
        lapsed = arm is not None and mode in _BROUGHT_BACK and arm.lapsed
        bus = self._cycles.plan(deadline_ns, lapsed=lapsed, recovers=arm is not None)
        if bus is not Bus.RECOVER or arm is None:
            return bus
        try:
            self._busy()
            resumed, back = arm.recover(), True
        except ServoFault as error:
            self.unseen, self.lost = str(error), error
            return Bus.GIVE_UP
        except DriverError as error:
            self.unseen, self.lost, resumed, back = str(error), error, False, False
        self._cycles.tried(deadline_ns, back=back)
        if resumed:
            self._resumed()
        return Bus.READ if back else Bus.QUIET

    def read(self, mode: Mode) -> tuple[JointState | None, Event]:
        """Fresh state or None, and whether anything is wrong with the arm, which `unseen` says then."""
        try:
            fresh, self._fault = self._driver.read(), ""
            return fresh, Event.NONE
        except WaitEnded as error:
            self.unseen = str(error)
            return None, Event.NONE
        except StaleStateError as error:
            self.unseen, self.lost = str(error), error
            return None, Event.SERVO_LOST if self._lockstep else Event.NONE
        except ServoFault as error:
            self.unseen, self.lost = str(error), error
            state = error.state
            if state is None:
                return None, Event.SERVO_LOST
            seen = bool(np.isfinite(state.q).all() and np.isfinite(state.dq).all())
            return state if seen else None, self._trouble_of(self.unseen, mode)

    def blamed(self) -> str:
        """What is unseen, for which the arm is to stand."""
        self._blamed = self.unseen
        return self.unseen

    def why(self, reason: str) -> str:
        """Why the arm is to stand, now that a servo has said what is wrong: `reason` where that is something else.

        A servo that was silent first, or seemed to be, tells more once it answers; but not that its watchdog has fired.
        """
        lapsed = self._recovering is not None and self._recovering.lapsed
        return self.blamed() if not reason or (reason == self._blamed and not lapsed) else reason

    def _trouble_of(self, fault: str, mode: Mode) -> Event:
        """What a servo's fault, which lasts, asks for: on the way back of a session the one of before asks no more."""
        borne = mode in WAY_BACK and fault == self._fault
        self._fault = fault
        return Event.NONE if borne else Event.TROUBLE
