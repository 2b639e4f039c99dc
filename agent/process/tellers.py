"""What a loop tells of itself: where its rows go, events, its servos' slow quantities, and that it lives."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from agent.around import RunSummary
from agent.config.cell import Arm
from agent.host.notify import Notifier
from agent.modes import TABLE, Mode
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import HOLDS, Level
from agent.telemetry.row.event import Event as TextEvent
from agent.telemetry.row.health import grip_values, health_values
from agent.telemetry.row.sample import AGENT_STATE
from drivers.interface import Clock, Driver, Gripper, Refusal

HEARTBEAT_S = 0.02
HEALTH_S = 1.0
SET_S = 1e-3  # a clock that is read between two of a stalled process' instructions is off by far less


def opened(stack: ExitStack, path: Path, arm: Arm) -> tuple[TextWriter, RingWriter]:
    """Texts and rows of an arm's loop, in the ring at `path`; finished when the stack ends.  Raises Refusal."""
    texts = stack.enter_context(closing(TextWriter(path, arm.name)))
    ring = stack.enter_context(RingWriter(path, AGENT_STATE, arm.name, tuple(arm.entry.controlled)))
    stack.callback(ring.finish)
    stack.callback(texts.finish)
    return texts, ring


class Teller:
    """Writes the agent's own events; mode changes and flags are told from the rows by telemetry.

    With the clock of the rows an event has their time: the same UTC for the same instant, and `stamp_ns` as they do.
    """

    def __init__(self, arm: str, texts: TextWriter) -> None:
        self.clock: Clock | None = None  # none before the arm is connected: the wall's time, then
        self._arm = arm
        self._texts = texts

    def event(self, level: Level, text: str, **data: float | str) -> None:
        """Something happened now."""
        utc_ns = time.time_ns()
        if self.clock is not None:
            stamp_ns = self.clock.now_ns()
            utc_ns, data = self.clock.utc_offset_ns + stamp_ns, {"stamp_ns": stamp_ns, **data}
        self._texts.event(TextEvent(utc_ns, self._arm, level, text, data))

    def warn(self, text: str) -> None:
        """The driver has something to say."""
        self.event(Level.WARN, text)

    def trouble(self, reason: str) -> None:
        """The arm holds by itself."""
        self.event(Level.WARN, f"{HOLDS}{reason}")

    @contextmanager
    def refusals(self) -> Iterator[None]:
        """Tell of the one that ends the block."""
        try:
            yield
        except Refusal as error:
            self.event(Level.ERROR, str(error))
            raise

    def end(self, summary: RunSummary, cpu_s: float) -> None:
        """The run is over; wall_s is what the report's real-time factor is made of."""
        level = Level.ERROR if summary.mode is Mode.FAULT else Level.INFO
        text = f"run ended in {summary.mode.name} {summary.reason}".strip()
        self.event(
            level,
            text,
            ticks=summary.ticks,
            late_cycles=summary.late_cycles,
            wall_s=round(summary.tracked_s, 4),
            cpu_s=round(cpu_s, 4),
        )


class Every:
    """Asked once a cycle, says yes in every so many: once in `seconds`, of cycles at rate_hz."""

    def __init__(self, seconds: float, rate_hz: float) -> None:
        self._cycles = max(1, round(seconds * rate_hz))
        self._count = 0

    def __call__(self) -> bool:
        """Whether it is time."""
        self._count += 1
        return self._count % self._cycles == 0


class ServoTeller:
    """Tells the servos' slow quantities once a second, after the cycle's torque has gone out.

    The driver has read them in its gaps, and the ring waits for nobody; a driver without servos tells nothing.
    """

    def __init__(self, driver: Driver, texts: TextWriter, utc_offset_ns: int, rate_hz: float) -> None:
        self._driver = driver
        self._gripper = driver if isinstance(driver, Gripper) else None
        self._texts = texts
        self._utc_offset_ns = utc_offset_ns
        self._due = Every(HEALTH_S, rate_hz)

    def beat(self) -> None:
        """A cycle has passed, with a state or without."""
        if not self._due():
            return
        health = self._driver.health()
        if health.servo_ids:
            values = {**health_values(health), **grip_values(self._gripper.grip_state() if self._gripper else None)}
            self._texts.health(self._utc_offset_ns + health.stamp_ns, values)


class SetClock:
    """Tells when somebody sets the wall clock, looking once a second; rows and motion keep the time of before."""

    def __init__(self, tell: Teller, clock: Clock, rate_hz: float, offset_ns: Callable[[], int]) -> None:
        """offset_ns: UTC minus `clock`, now."""
        self._tell = tell
        self._offset_ns = offset_ns
        self._known_ns = clock.utc_offset_ns
        self._due = Every(HEALTH_S, rate_hz)

    def beat(self) -> None:
        """A cycle has passed, with a state or without."""
        if not self._due():
            return
        found_ns = self._offset_ns()
        step_s = (found_ns - self._known_ns) * 1e-9
        if abs(step_s) > SET_S:  # what corrects the clock slowly moves CLOCK_MONOTONIC with it
            self._known_ns = found_ns
            self._tell.event(Level.WARN, f"the wall clock was set by {step_s:+.3g} s", step_s=step_s)


class Heart:
    """Strokes the service manager's watchdog from the loop, every 20 ms."""

    def __init__(self, notifier: Notifier, rate_hz: float) -> None:
        self._notifier = notifier
        self._due = Every(HEARTBEAT_S, rate_hz)

    def mode(self, mode: Mode) -> None:
        """Tell what the arm is doing."""
        self._notifier.send(f"STATUS={TABLE[mode].says}")

    def beat(self) -> None:
        """A cycle has passed, with a state or without."""
        if self._due():
            self._notifier.alive()

    def busy(self) -> None:
        """The next beat will be late."""
        self._notifier.busy()
