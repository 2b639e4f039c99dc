"""`coop float`: arms of a cell that a hand guides, as processes of one machine, with a log; none of them outlives it.

Arms that move while others float do so from one instant on, and end as they do: at a stop, and where the motion ends.
A stop, one arm that stops by itself and one that fails let all of them stand and sink; nobody kills one that sinks.
Each arm has a guard: where its process is killed or hangs, that lets it stand and sink.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from agent.config.cell import Cell
from agent.host.child import Child, wait_all
from agent.modes import Mode
from agent.operator.error import ControlError
from agent.operator.words import start_patiently
from agent.process.children import READY_TIMEOUT_S, STOP_TIMEOUT_S
from agent.process.commands import ChildCommand
from agent.process.float_loop import SINK_MAX_S, STAND_S
from agent.process.floating_cell import FloatOptions, moving, names_of
from agent.process.floating_commands import FloatCommands
from agent.process.folder import LOG_NAME, output_folder, words_folder, words_of
from agent.process.glance import Glance, Screen, Window
from agent.process.run_folder import run_folder
from agent.process.unbegun import StoppedEarly
from drivers.interface import Refusal

END_TIMEOUT_S = STAND_S + SINK_MAX_S + 10.0
START_IN_NS = 3_000_000_000  # grippers have closed by then, and the torque at rest has been looked at
LOOK_EVERY_S = 0.1
RING, TORQUE, MEMBER = "ring", "torque", "member"  # keys of ready lines: of an agent, twice, and of telemetry
_TOLD_EARLY = (StoppedEarly.exit_code, -signal.SIGTERM)  # of an arm's process that was told to end before it had torque
_STOPPED = frozenset({Mode.STAND, Mode.SINK, Mode.FAULT})


def float_arms(cell: Cell, options: FloatOptions, stop: Callable[[], bool], screen: Screen) -> Path:
    """Let the arms float until a stop, or until one of them stops; returns the log.

    Raises Refusal; every torque is off and the log is closed by then.
    """
    words = words_of(arm.name for arm in cell.arms)
    with (
        output_folder(options.out, f"{cell.file.name}-float", own=words, has_force=False) as out,
        run_folder() as runtime,
    ):
        arms = FloatingArms(cell, options, out, runtime, stop)
        try:
            arms.start(screen)
            arms.watch(screen)
            arms.end(screen)
        finally:
            arms.abandon()
    return out / LOG_NAME


class FloatingArms:
    """The processes; what they share lies in `runtime`, their words in a folder `logs` beside the log."""

    def __init__(self, cell: Cell, options: FloatOptions, out: Path, runtime: Path, stop: Callable[[], bool]) -> None:
        self._cell, self._emulate, self._stop = cell, options.emulate, stop
        self._commands = FloatCommands(cell, options, out, runtime)
        self._words = words_folder(out)
        self._recorder: Child | None = None
        self._endpoint = ""  # of the recorder, once it is ready
        self._servos: Child | None = None
        self._agents: dict[str, Child] = {}
        self._guards: dict[str, Child] = {}
        self._telemetry: dict[str, Child] = {}
        self._windows: dict[str, Window] = {}
        self._due: dict[Child, tuple[str, float]] = {}  # what it is still to say, and until when
        self._killed_s: dict[str, float] = {}
        self._begun = False  # those that move have been told when to
        self._told = False  # all have been told to end
        self._failure: Refusal | None = None

    def start(self, screen: Screen) -> None:
        """Start everything, recorder first, but what `watch` does: from the arms' processes on somebody looks.

        Raises ChildFailed, StoppedEarly.
        """
        screen.phase("starting")
        self._recorder = self._child("recorder", self._commands.record())
        if self._emulate:
            self._servos = self._child("servos", self._commands.emulate())
            self._servos.wait_ready(READY_TIMEOUT_S, self._heed)
        for name in names_of(self._cell):
            self._guards[name] = self._child(f"guard-{name}", self._commands.guard(name))
        for guard in self._guards.values():
            guard.wait_ready(READY_TIMEOUT_S, self._heed)
        self._endpoint = self._recorder.wait_ready(READY_TIMEOUT_S, self._heed)["endpoint"]
        self._heed()
        for name in self._guards:
            self._agents[name] = self._awaited(TORQUE, f"arm-{name}", self._commands.agent(name))

    def watch(self, screen: Screen) -> None:
        """Show the arms, the first of which may float before others are ready, until every one of them has ended.

        Raises ChildFailed, ControlError, StoppedEarly.
        """
        assert self._recorder is not None
        try:
            while living := self._living():
                self._take_in(screen)
                glances = self._show(living, screen)
                for text in self._recorder.told():
                    screen.note(text)
                self._end_late()
                if not self._told and (self._stop() or self._failure is not None or self._one_stopped(glances)):
                    self._end_all()
                elif not self._told and not self._begun and self._all_ready():
                    self._begin(screen)
                time.sleep(LOOK_EVERY_S)
            self._show(living, screen)
        finally:
            for window in self._windows.values():
                window.close()
        self._judge()

    def _awaited(self, key: str, name: str, command: ChildCommand) -> Child:
        """Start a process that is to say this key in a ready line, in time."""
        child = self._child(name, command)
        self._due[child] = key, time.monotonic() + READY_TIMEOUT_S
        return child

    def _take_in(self, screen: Screen) -> None:
        """Look at the arms that have a ring by now, and have their telemetry read it."""
        for name, child in self._agents.items():
            if name in self._windows or not child.has_said(RING):
                continue
            if not self._windows:
                screen.phase("torque on")
            self._windows[name] = Window(self._cell, self._cell.arm(name), self._commands.ring(name))
            command = self._commands.telemetry(name, self._endpoint)
            self._telemetry[name] = self._awaited(MEMBER, f"telemetry-{name}", command)
            if not self._told:
                self._due[child] = TORQUE, time.monotonic() + READY_TIMEOUT_S

    def _show(self, living: Collection[str], screen: Screen) -> list[Glance]:
        """How all arms are, on the screen once one of them has torque, or had it."""
        glances = []
        for name in self._agents:
            seen = self._windows[name].look() if name in self._windows else Glance(name, Mode.OFF)
            glances.append(seen if name in living else seen.off())
        if any(child.has_said(TORQUE) for child in self._agents.values()):
            screen.show(glances)
        return glances

    def _all_ready(self) -> bool:
        told = len(self._telemetry) == len(self._agents) and all(c.has_said(MEMBER) for c in self._telemetry.values())
        return told and all(child.has_said(TORQUE) for child in self._agents.values())

    def _begin(self, screen: Screen) -> None:
        """Tell the arms that move when to, unless somebody, or an arm that stops by itself, has an end come first."""

        def look() -> None:
            if self._stop() or self._one_stopped(self._show(self._living(), screen)):
                raise self._stopped()

        self._begun = True
        moved = {arm.name: [self._commands.control(arm.name)] for arm in moving(self._cell)}
        try:
            if moved:
                start_patiently(moved, self._cell.fingerprint, START_IN_NS, look)
        except StoppedEarly:
            pass  # the next look sees to it
        except ControlError as error:
            self._failure = error

    def _end_all(self) -> None:
        """Have every arm end: one that has torque stands and sinks, the others get none."""
        self._told = True
        for child in self._agents.values():
            if child in self._due:
                self._due[child] = TORQUE, time.monotonic() + STOP_TIMEOUT_S
        self._stop_all()

    def _end_late(self) -> None:
        """Kill who is not ready in time, or has not ended in time: an arm's process without torque, or telemetry."""
        for child, (key, due_s) in list(self._due.items()):
            if child.has_said(key) or child.process.poll() is not None:
                del self._due[child]
            elif time.monotonic() >= due_s:
                self._failure = self._failure or child.failed("neither ready nor ended in time")
                child.process.kill()

    def _judge(self) -> None:
        """Raise what went wrong, when every arm has ended: what all were told to end for comes first."""
        if self._failure is not None:
            raise self._failure
        unbegun = [name for name, child in self._agents.items() if not child.has_said(TORQUE)]
        for name, child in self._agents.items():
            code = child.process.poll()
            if code != 0 and not (self._told and name in unbegun and code in _TOLD_EARLY):
                raise child.failed(self._ended(name))
        if len(unbegun) == len(self._agents):
            for one in self._lost():
                if one.process.poll() != 0:
                    raise one.failed("ended before an arm had torque")
            raise self._stopped()

    def _heed(self) -> None:
        """Raise StoppedEarly where somebody has asked for an end."""
        if self._stop():
            raise self._stopped()

    def _stopped(self) -> StoppedEarly:
        return StoppedEarly.of(f"floating of cell {self._cell.file.name}")

    def end(self, screen: Screen) -> None:
        """End the rest in the order in which nothing is lost.  Raises ChildFailed."""
        screen.phase("closing the log")
        assert self._recorder is not None
        self._hear_out()
        self._recorder.terminate()
        if self._recorder.wait(STOP_TIMEOUT_S) != 0:
            raise self._recorder.failed("did not close the log")
        for child in self._telemetry.values():
            if child.process.poll() not in (None, 0):
                raise child.failed("ended early; the log lacks rows of its arm")

    def abandon(self) -> None:
        """Make sure that everything has ended: arms first, which take their time to sink, then the rest."""
        self._stop_all()
        wait_all(self._agents.values(), END_TIMEOUT_S)
        self._note_deaths()
        wait_all([guard for name, guard in self._guards.items() if self._in_its_place(name)], END_TIMEOUT_S)
        for guard in self._guards.values():
            guard.terminate()
        wait_all(self._guards.values(), STOP_TIMEOUT_S)
        others = [c for c in (*self._telemetry.values(), self._servos, self._recorder) if c is not None]
        self._hear_out()
        for child in others:
            child.terminate()
        wait_all(others, STOP_TIMEOUT_S)
        for child in (*self._agents.values(), *self._guards.values(), *others):
            child.kill()

    def _hear_out(self) -> None:
        """Give telemetry the time until the recorder has its last row, where there is one."""
        if self._recorder is not None and self._recorder.process.poll() is None:
            wait_all(self._telemetry.values(), STOP_TIMEOUT_S)

    def _living(self) -> set[str]:
        """The arms that may have torque: their process runs, or their guard lets them down in its place."""
        codes = self._note_deaths()
        return {name for name, code in codes.items() if code is None or self._in_its_place(name)}

    def _note_deaths(self) -> dict[str, int | None]:
        """How each arm's process has ended, None: not yet; keeps since when it is known to be killed."""
        codes = {name: child.process.poll() for name, child in self._agents.items()}
        for name, code in codes.items():
            if code is not None and code < 0 and self._agents[name].has_said(TORQUE):
                self._killed_s.setdefault(name, time.monotonic())
        return codes

    def _in_its_place(self, name: str) -> bool:
        """Whether the arm's process was killed, and its guard may still be letting the arm down."""
        if name not in self._killed_s or self._guards[name].process.poll() is not None:
            return False
        return time.monotonic() - self._killed_s[name] < END_TIMEOUT_S  # longer: it has nothing to let down

    def _ended(self, name: str) -> str:
        if not self._agents[name].has_said(TORQUE):
            return "ended before it was ready"
        let_down = self._guards[name].process.poll() == 0
        how = "its guard has let the arm down" if let_down else "the arm has no torque any more"
        return f"ended while it floated; {how}"

    def _one_stopped(self, glances: Sequence[Glance]) -> bool:
        """Whether an arm has stopped by itself, or is gone: the others must not go on floating with the object."""
        ended = any(child.process.poll() is not None for child in self._agents.values())
        return ended or bool(self._lost()) or any(glance.mode in _STOPPED for glance in glances)

    def _lost(self) -> list[Child]:
        """What has ended and should not before the arms do: what writes the log, what emulates them."""
        needed = (self._recorder, self._servos, *self._telemetry.values())
        return [child for child in needed if child is not None and child.process.poll() is not None]

    def _stop_all(self) -> None:
        for child in self._agents.values():
            child.terminate()

    def _child(self, name: str, command: ChildCommand) -> Child:
        return Child(name, command.argv(), self._words)
