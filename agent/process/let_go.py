"""How an arm's process lets go of it: torque off, with everybody told who watches for the rows that come no more."""

from __future__ import annotations

from agent.guard.guarded import Guarded
from agent.host.notify import Notifier
from agent.host.realtime import leave_realtime
from drivers.interface import Driver


def let_go(driver: Driver, guard: Guarded | None, notifier: Notifier) -> None:
    """Switch the torque off and give everything back, in whatever state the driver is.

    The servos are asked whether they are off, which takes longer than the guard of a real arm waits for a row.
    """
    notifier.busy()
    if guard is not None:
        guard.busy()
    driver.disable()
    if guard is not None:
        guard.leave()
    driver.close()
    leave_realtime()
    notifier.stopping("torque off")
