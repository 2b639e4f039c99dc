"""A rehearsal on real arms by one command: what must hold before it, and who lets go of the arms after it.

A real arm is not let go by the program: at the end, at a stop and when a process fails it holds until a person says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Protocol

from agent.config.cell import Cell
from agent.host.child import Child, ChildFailed
from agent.host.paths import control_path, guard_path, make_runtime_dir
from agent.modes import TABLE, Mode
from agent.operator.ask import ask_arms
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.table import Verb
from agent.process.build import Connection, port_of
from agent.process.children import START_LOOP_IN_NS, STOP_TIMEOUT_S, Children
from agent.process.commands import AgentCommand, GuardCommand
from agent.process.folder import RunError
from agent.process.operated import NO_REAL_TIME_REMEDY
from agent.process.person import SILENT_S
from agent.process.progress import Progress
from agent.process.rehearse import require_empty_gripper, require_one_host

ASK_EVERY_S: Final = 0.1
HELD_WITHIN_S: Final = 0.1  # an agent that lives answers in a cycle; while others start it is asked again
SUPPORTED_S: Final = 1.0  # sooner nobody has read that an arm holds, and has it in his hands
GONE_AFTER: Final = 10  # times that no real arm answers: a guard that takes over needs less


class Bystander(Protocol):
    """A person beside the arms."""

    def says_empty(self, arm: str) -> bool:
        """Whether they have looked, and the gripper of this arm holds nothing."""
        ...

    @property
    def hears(self) -> bool:
        """Whether they can press a key here."""
        ...

    def lets_go(self) -> bool:
        """Whether they have pressed the key since the last call, by which they say that the arms are supported."""
        ...

    def tell(self, text: str) -> None:
        """A line for them."""
        ...


@dataclass(frozen=True)
class RealArms:
    """The arms of [hil] are those on the ports of the cell file, and somebody stands beside them."""

    beside: Bystander
    priority: int | None = None  # SCHED_FIFO of the loops of real arms
    no_realtime: bool = False  # a person accepts late torques
    emulated: bool = False  # the servos on those ports are emulated, by `coop emulate`: to try it all

    def require(self, cell: Cell, faults: Path | None) -> None:
        """Refuse what cannot be rehearsed on real arms, then ask for each gripper.  Raises Refusal."""
        if cell.file.hil is None:
            raise RunError(
                "--real-arms", found="no arm in the loop", expected="arms that are real",
                remedy="name them: --hil ARMS, or [hil] in the cell file",
            )  # fmt: skip
        if faults is not None:
            raise RunError("faults", found=f"{faults} for real arms", expected="emulated ones", remedy="leave one out")
        require_one_host(cell)
        if self.priority is None and not (self.no_realtime or self.emulated):
            raise RunError(
                "--real-arms", found="a normal priority", expected="SCHED_FIFO on a real arm",
                remedy=NO_REAL_TIME_REMEDY,
            )  # fmt: skip
        for name in cell.file.hil.arms:
            port_of(cell.arm(name), Connection())
        for name in cell.file.hil.arms:
            require_empty_gripper(name, self.beside.says_empty(name))


class Holding:
    """The arms of a run as a person beside them has them: told of when they hold, and let go when they say so."""

    def __init__(self, arms: Mapping[str, Path], real: Collection[str], cell: str, beside: Bystander) -> None:
        """arms: control sockets; cell: as it is named on the command line."""
        self._arms = {name: [path] for name, path in arms.items()}
        self._real = frozenset(real)
        self._cell, self._beside = cell, beside
        self._told: set[str] = set()
        self._told_s = 0.0  # when that was said of the last one
        self._silent = 0  # looks in a row without an answer of a real arm
        self._next_s = 0.0

    @property
    def over(self) -> bool:
        """Whether no real arm is held any more."""
        return self._silent >= GONE_AFTER

    def stop(self) -> None:
        """Let all arms hold."""
        ask_arms(self._arms, Request(Verb.STOP), SILENT_S)

    def held(self, arms: Collection[str], look: Callable[[], None]) -> dict[str, str]:
        """Those of these arms that hold, and why, told of if they are real; at most every ASK_EVERY_S, else nobody.

        For the time before the start: no key counts then, and a silence says nothing.  look: as of `ask_arms`.
        """
        now_s = time.monotonic()
        if now_s < self._next_s:
            return {}
        self._next_s = now_s + ASK_EVERY_S
        heard = ask_arms({arm: self._arms[arm] for arm in arms}, Request(Verb.STATUS), HELD_WITHIN_S, look)
        replies = {arm: one for arm, one in heard.items() if isinstance(one, Reply)}
        holding = {arm: one.reason for arm, one in replies.items() if Mode[one.mode] is Mode.HOLD}
        self._tell_new({arm: reason for arm, reason in holding.items() if arm in self._real})
        return holding

    def look(self) -> None:
        """Ask all arms how they are, tell who holds, and pass on a release; at most every ASK_EVERY_S."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + ASK_EVERY_S
        heard = ask_arms(self._arms, Request(Verb.STATUS), SILENT_S)
        replies = {arm: one for arm, one in heard.items() if isinstance(one, Reply) and TABLE[Mode[one.mode]].commands}
        real = {arm: one for arm, one in replies.items() if arm in self._real}
        self._silent = 0 if real else self._silent + 1
        holding = {arm: one.reason for arm, one in real.items() if Mode[one.mode] is Mode.HOLD}
        pressed = self._beside.lets_go()  # in every look: a key from before an arm held says nothing of that arm
        self._tell_new(holding)
        if (holding and pressed and self._is_meant()) or (self.over and replies):
            told = [arm for arm in replies if arm in holding or arm not in self._real]  # not who holds since just now
            ask_arms({arm: self._arms[arm] for arm in told}, Request(Verb.RELEASE), SILENT_S)

    def see_off(self, may_begin: Callable[[], bool]) -> None:
        """Stop all arms, and return when no real one is held any more, however long that takes.

        may_begin: whether one that has no torque may still get some.
        """
        self.stop()
        while True:
            if may_begin():
                self._silent = 0
            elif self.over:
                return
            self.look()
            time.sleep(ASK_EVERY_S)

    def _is_meant(self) -> bool:
        """Whether a key that is pressed now can be about every arm that holds: nobody supports one at once."""
        if time.monotonic() - self._told_s >= SUPPORTED_S:
            return True
        self._beside.tell("Enter came before that arm can have been supported: press it again once all of them are")
        return False

    def _tell_new(self, holding: Mapping[str, str]) -> None:
        for arm in sorted(set(holding) - self._told):
            self._tell(arm, holding[arm])

    def _tell(self, arm: str, reason: str) -> None:
        self._told.add(arm)
        self._told_s = time.monotonic()
        key = "press Enter here, or " if self._beside.hears else ""
        self._beside.tell(f"arm {arm} HOLDS ({reason}): support it, then {key}say `coop release {self._cell}`")


class RealChildren(Children):
    """The processes of a rehearsal on real arms; each of those has a guard."""

    _copied = False  # as services are: a copy would fetch its memory piece by piece while an arm moves

    def __init__(self, cell: Cell, *given: Any, real: RealArms, cell_path: Path, **more: Any) -> None:
        """given, more: of `Children`; cell_path: as on the command line.  Raises PlaceError."""
        super().__init__(cell, *given, **more)
        make_runtime_dir(cell.file.name)
        self._real = real
        self._names = cell.file.looped
        self._guards: dict[str, Child] = {}
        controls = {arm.name: self._control(arm.name) for arm in cell.arms}
        self._holding = Holding(controls, self._names, str(cell_path), real.beside)

    def _control(self, arm: str) -> Path:
        return control_path(self._cell.file.name, arm)  # where `coop stop` and `coop release` look

    def _start_servos(self) -> None:
        """They are there; a guard for each arm of theirs."""
        for name in self._names:
            command = GuardCommand(
                cell=self._cell_path, arm=name, socket=guard_path(self._cell.file.name, name),
                control=self._control(name), post_mortem=self._log.parent, hold=True,
                emulated=self._real.emulated, priority=self._real.priority,
            )  # fmt: skip
            self._guards[name] = self._child(f"guard-{name}", command)
        for child in self._guards.values():
            self._wait_ready(child)

    def _agent_command(self, arm: str) -> AgentCommand:
        common = replace(super()._agent_command(arm), emulated=self._real.emulated, hold=True)
        if arm not in self._names:
            return common
        return replace(
            common, port=None, gripper_empty=True, guard=guard_path(self._cell.file.name, arm),
            priority=self._real.priority, allow_no_realtime=self._real.no_realtime,
        )  # fmt: skip

    def _start_together(self, progress: Progress) -> None:
        self._real.beside.tell(
            f"arms {', '.join(self._names)} MOVE {START_LOOP_IN_NS * 1e-9:g} s after torque comes on; Ctrl-C holds them"
        )
        try:
            super()._start_together(progress)
        except ControlError:  # nobody is started; an arm that holds since the last look is why
            time.sleep(ASK_EVERY_S)
            self._heed()
            raise

    def _heed(self) -> None:
        """Raise ChildFailed, too, where an arm that has torque holds by itself, or a process has ended: none starts."""
        super()._heed()
        for child in (*self._agents.values(), *self._guards.values()):
            if child.process.poll() is not None:
                raise child.failed("ended before all arms were started")
        begun = [arm for arm, child in self._agents.items() if child.has_said("torque")]
        for arm, reason in self._holding.held(begun, super()._heed).items():
            raise ChildFailed(
                f"arm {arm}", found=f"it holds ({reason}) before all arms were started", expected="every arm READY",
                remedy=f"no arm is started; its log is {self._agents[arm].log}",
            )  # fmt: skip

    def _stop_agents(self) -> bool:
        self._holding.stop()
        return False

    def _require_alive(self) -> None:
        self._holding.look()
        super()._require_alive()
        for child in self._guards.values():
            if child.process.poll() not in (None, 0):
                raise child.failed("ended during the run")

    def end(self, progress: Progress) -> None:
        """End everything in the order in which nothing is lost; no arm has torque any more."""
        self._end_guards()
        super().end(progress)

    def abandon(self) -> None:
        """Make sure that everything has ended, once no real arm is held any more."""
        if self._guards:
            for child in self._unbegun():
                child.terminate()  # it may not listen at its socket yet
            due_s = time.monotonic() + STOP_TIMEOUT_S
            self._holding.see_off(lambda: self._may_begin(due_s))
        self._end_guards()
        super().abandon()

    def _unbegun(self) -> list[Child]:
        """Agents of real arms that run and have no torque yet."""
        agents = [self._agents[name] for name in self._names if name in self._agents]
        return [child for child in agents if child.process.poll() is None and not child.has_said("torque")]

    def _may_begin(self, due_s: float) -> bool:
        """Whether one of them has not ended yet, as it was told to; from that instant on it is killed."""
        unbegun = self._unbegun()
        if time.monotonic() >= due_s:
            for child in unbegun:
                child.kill()
        return bool(unbegun)

    def _end_guards(self) -> None:
        for child in self._guards.values():
            child.terminate()
        for child in self._guards.values():
            child.wait(STOP_TIMEOUT_S)
            child.kill()
