"""What a guard does once the process of a floating arm is gone: the arm stands, sinks, and its torque goes off."""

from __future__ import annotations

from contextlib import ExitStack

from agent.around import RunSummary
from agent.config.cell import Arm, Cell
from agent.guard.takeover import clock_of, go_on
from agent.guard.watched import Watched
from agent.host.notify import Notifier
from agent.loop import Agent
from agent.process.agent import ArmLost
from agent.process.build import Standby
from agent.process.float_loop import FloatLoop, Floats
from agent.process.schedule import schedule_of
from agent.process.tellers import Teller
from agent.telemetry.row.event import Level
from drivers.dynamixel.standby import StandbyDriver
from drivers.interface import Refusal


class FloatSuccessor:
    """Whoever lets one arm down after the process that let it float."""

    def __init__(self, cell: Cell, arm: Arm, agent: Agent, notifier: Notifier, *, shared: bool) -> None:
        """shared: as of `schedule_of`."""
        self._floats = Floats.of(cell, arm.name)
        self._agent, self._notifier, self._shared = agent, notifier, shared
        self._tell: Teller | None = None

    def warn(self, text: str) -> None:
        """What the driver has to say, once there is somebody to tell."""
        if self._tell is not None:
            self._tell.warn(text)

    def hold(self, watched: Watched, driver: Standby, reason: str, *, session: bool) -> RunSummary:
        """Let the arm stand, then sink; its torque is off when this returns or raises.  Raises AdoptError, ArmLost.

        session: a floating arm has none.
        """
        assert isinstance(driver, StandbyDriver), "an arm that floats has servos"
        assert not session, "it is told no words"
        cell, arm = self._floats.cell, self._floats.arm
        rows = watched.last_rows()
        clock = clock_of(rows)
        tell = self._tell = Teller(arm.name, watched.texts)
        tell.clock = clock
        watched.inherit(tell.warn)
        with ExitStack() as stack:
            stack.callback(watched.texts.finish)
            stack.callback(watched.writer.finish)
            tell.event(Level.ERROR, f"{reason}: the guard lets the arm down")
            try:
                schedule = schedule_of(cell, hold=True, shared=self._shared)
                begun = go_on(self._agent, driver, clock, rows, schedule, reason)
            except Refusal as error:
                tell.event(Level.ERROR, str(error))
                raise
            stack.callback(driver.close)
            stack.callback(driver.disable)
            loop = FloatLoop(
                self._floats, driver, clock, watched.writer, _never, tell, watched.texts, self._notifier,
                shared=self._shared, agent=self._agent,
            )  # fmt: skip
            summary = loop.run(begun)
        self._notifier.stopping("torque off")
        return ArmLost.check(arm.name, summary)


def _never() -> bool:
    return False  # it stops already
