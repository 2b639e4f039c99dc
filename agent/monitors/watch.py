"""All monitors of one arm, asked once after every tick with a fresh state.

They compute no torque: what they find is a HOLD, a HALT of an arm that holds nothing, or a STAND of one that floats,
which the rows of the log show as their mode, and from which a replay learns of it.  Where nothing more can be done, in
HOLD, HALT, REST, STAND and SINK, each tells once what it finds; on the way back of a session (LOWER, RELEASE, PARK) so
do all but those of the joints' motion, for whoever is too hot is to be set down and brought home.
"""

from __future__ import annotations

from collections.abc import Callable

from agent.loop import Outcome
from agent.modes import WAY_BACK, Mode
from agent.monitors.body import Limited, Load, Start, Workspace
from agent.monitors.bounds import Bounds, Name
from agent.monitors.gravity import Gravity
from agent.monitors.joints import Frozen, Position, Power, Speed
from agent.monitors.servos import Servos
from agent.monitors.tick import Monitor, Tick
from agent.safety import Flag
from drivers.interface import JointState, ServoHealth

HEALTH_S = 0.25
_STOPS = frozenset({Mode.READY, Mode.TRACK, Mode.APPROACH, Mode.GRASP, Mode.FLOAT})  # everything is a reason to stop
_OF_MOTION = frozenset({Name.SPEED, Name.POWER})  # for which an arm stops on its way back, too


class Watch:
    """The monitors of one arm; tell: is told what they find while the arm holds already."""

    def __init__(self, bounds: Bounds, tell: Callable[[str], None] = lambda _: None) -> None:
        every: dict[Name, Monitor] = {
            Name.SPEED: Speed(bounds),
            Name.POWER: Power(bounds),
            Name.POSITION: Position(bounds),
            Name.START: Start(bounds),
            Name.WORKSPACE: Workspace(bounds),
            Name.SATURATED: Limited(bounds, Flag.SATURATED, "torque at its limit"),
            Name.RATE_LIMITED: Limited(bounds, Flag.RATE_LIMITED, "torque step at its limit"),
            Name.FROZEN: Frozen(bounds),
            Name.LOAD: Load(bounds),
            Name.GRAVITY: Gravity(bounds),
        }
        watched = (name for name in Name if name in every and name in bounds.watched)
        self._checks = [(name, every[name].check) for name in watched]  # finding them anew takes 1 % of a cycle
        self._servos = Servos(bounds)
        self._tell = tell
        self._told: set[Name] = set()
        self._health_ticks = max(1, round(HEALTH_S / bounds.period_s))
        self._tick = 0

    def after(self, state: JointState, outcome: Outcome, mode: Mode, health: Callable[[], ServoHealth]) -> str:
        """Why the arm must stop, with the monitor's name; empty while it need not, and while it stands.

        health: the driver's, which never waits; asked for four times a second.
        """
        at = Tick(mode, state, outcome, state.q.tolist(), outcome.dq.tolist(), outcome.tau.tolist())
        reason = ""
        for name, check in self._checks:
            if said := check(at):
                reason = reason or self._found(name, said, mode)
        self._tick += 1
        if self._tick % self._health_ticks == 0:
            for name, said in self._servos.judge(health()):
                reason = reason or self._found(name, said, mode)
        return reason

    def _found(self, name: Name, said: str, mode: Mode) -> str:
        text = f"monitor {name}: {said}"
        if mode in _STOPS or (mode in WAY_BACK and name in _OF_MOTION):
            self._told.add(name)
            return text
        if name not in self._told:
            self._told.add(name)
            self._tell(text)
        return ""
