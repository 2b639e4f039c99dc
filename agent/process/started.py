"""What each process of a cell does with its typed command, whoever started it; each loads what it needs and no more."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

from agent.config.schema.driver import DriverKind
from agent.host.aside import Aside
from agent.host.signals import begin
from agent.host.starting import ready
from agent.process.commands import (
    AgentCommand,
    AgentOptions,
    ChildCommand,
    EmulateCommand,
    GuardCommand,
    GuardOptions,
    PlantCommand,
    RecordCommand,
    TelemetryCommand,
)
from agent.process.loss import AfterLoss


@dataclass(frozen=True)
class Listener:
    """Who reads what a process says and answers its questions."""

    say: Callable[[str], None]
    agrees: Callable[[str], bool] = lambda _: False
    parent: Callable[[str], None] = lambda _: None  # shows a person what cannot wait for the end of the process

    def alert(self, text: str) -> None:
        """Say what somebody should know at once."""
        self.say(text)
        self.parent(text)


def run(command: ChildCommand, listener: Listener) -> int:
    """Be that process until its end; the exit code.  Raises Refusal, OSError."""
    match command:
        case AgentCommand():
            return agent(command, listener)
        case GuardCommand():
            return guard(command, listener)
        case PlantCommand():
            return plant(command, listener)
        case EmulateCommand():
            return emulate(command, listener)
        case TelemetryCommand():
            from agent.process.listening import telemetry

            return telemetry(command, listener)
        case RecordCommand():
            from agent.process.listening import record

            return record(command, listener)
    raise TypeError(type(command))


def agent(command: AgentCommand, listener: Listener) -> int:
    """One arm: read, step, limit, write."""
    from agent.config.cell import ConfigError, load_cell
    from agent.config.floating import spec_of
    from agent.guard.guarded import UNGUARDED
    from agent.host.paths import control_path, make_runtime_dir, plant_socket_path, ring_path
    from agent.process.agent import run_agent
    from agent.process.build import port_of
    from agent.process.floats import run_float
    from agent.process.rehearse import (
        driver_of,
        holds,
        in_the_loop,
        refuse_port_of_simulated,
        require_empty_gripper,
        require_one_host,
        require_wall_clock,
        taken,
    )

    requested = begin(command.with_parent)
    loaded, arm, emulated = load_cell(command.cell), command.arm, command.emulated
    kind = driver_of(loaded, arm, command.driver)
    refuse_port_of_simulated(kind, arm, command.port)
    name = loaded.file.name
    if not emulated:
        require_one_host(loaded)
    if in_the_loop(loaded, arm):
        port_of(loaded.arm(arm), command)
    if in_the_loop(loaded, arm) and not emulated:
        with requested.interrupting():  # or a stop at the question would be heard after the answer
            said = command.gripper_empty or taken(command.gripper_word)
            require_empty_gripper(arm, said or listener.agrees(f"Is the gripper of arm {arm} EMPTY?"))
    require_wall_clock(loaded, real_time=command.real_time or kind is DriverKind.DYNAMIXEL)
    options = AgentOptions(
        **vars(command)
        | {
            "driver": kind,
            "plant_socket": command.plant_socket or plant_socket_path(name),
            "ring": command.ring or ring_path(name, arm),
            "control": command.control or control_path(name, arm),
            "hold": command.whole or holds(loaded, kind, emulated=emulated, asked=command.hold),
        }
    )
    if options.guard is not None and options.lockstep:
        raise ConfigError(
            f"guard of arm {arm}", found="an agent in lockstep, for which time waits",
            expected="one at the wall clock's pace", remedy="give --real-time",
        )  # fmt: skip
    if command.ring is None or command.control is None:
        make_runtime_dir(name)
    floats = spec_of(loaded, loaded.arm(arm)) is not None
    warnings = list[str]()  # said with the first ready line: whoever is refused has nothing that could fall
    if options.hold and not floats:
        requested.heard = _stops_told(arm, guarded=options.guard is not None)
        if options.guard is None and kind is DriverKind.DYNAMIXEL:
            warnings.append(f"arm {arm}: {UNGUARDED}")

    def begun(text: str) -> None:
        ready(text)
        while warnings:
            listener.say(warnings.pop())

    summary = (run_float if floats else run_agent)(loaded, options, requested, begun)
    listener.say(
        f"arm {arm}: {summary.ticks} cycles, {summary.late_cycles} late, {summary.stale_cycles} without a state, "
        f"mode {summary.mode.name} {summary.reason}"
    )
    return 0


def _stops_told(arm: str, *, guarded: bool) -> Callable[[str], None]:
    """What a person reads at the terminal of an agent that holds when it is stopped."""
    aside, goes_on = Aside(), "its guard" if guarded else "this process"

    def told(why: str) -> None:
        aside(f"arm {arm}: {why}: stops; what has its torque on is held by {goes_on} until `coop release`")

    return told


def guard(command: GuardCommand, listener: Listener) -> int:
    """One arm's guard: lends its agent the port, and goes on in HOLD when that dies or hangs."""
    from agent.host.notify import Notifier

    with closing(Notifier()) as notifier:
        notifier.loading("loads")  # for a second from here on; its agent loads meanwhile, and waits for the socket
    from agent.atomic import make_folder
    from agent.config.cell import load_cell
    from agent.host.paths import control_path, guard_path, make_runtime_dir
    from agent.process.guard import run_guard
    from agent.process.rehearse import driver_of, holds, refuse_port_of_simulated

    requested = begin(command.with_parent)
    loaded, arm = load_cell(command.cell), command.arm
    kind = driver_of(loaded, arm, command.driver)
    refuse_port_of_simulated(kind, arm, command.port)
    name = loaded.file.name
    if command.socket is None or command.control is None:
        make_runtime_dir(name)
    options = GuardOptions(
        **vars(command)
        | {
            "driver": kind,
            "socket": command.socket or guard_path(name, arm),
            "control": command.control or control_path(name, arm),
            "hold": holds(loaded, kind, emulated=command.emulated, asked=command.hold),
        }
    )
    make_folder(command.post_mortem)  # while nothing is held yet
    summary = run_guard(loaded, options, requested, ready)
    if summary is not None:
        listener.say(
            f"arm {arm}: held; {summary.ticks} cycles with its agent's, mode {summary.mode.name} {summary.reason}"
        )
    return 0


def plant(command: PlantCommand, listener: Listener) -> int:
    """The simulated cell that the agents' simulated drivers connect to."""
    from agent.config.cell import load_cell
    from agent.host.paths import make_runtime_dir, plant_socket_path, ring_path
    from agent.process.pauses import Pauses, instants_of
    from agent.process.plant import run_plant
    from agent.telemetry.row.topics import PLANT
    from sim_backend.served.options import LostArm

    requested = begin(command.with_parent)
    loaded = load_cell(command.cell)
    name = loaded.file.name
    if command.ring is None or command.socket is None:
        make_runtime_dir(name)
    where = command.socket or plant_socket_path(name), command.ring or ring_path(name, PLANT)
    loss = LostArm.GO_LIMP if command.lost_arm is AfterLoss.LIMP else LostArm.END_RUN
    pauses = None
    if command.pauses is not None:
        pauses = Pauses(instants_of(command.pauses, lockstep=not command.real_time), listener.parent, requested)
    summary = run_plant(
        loaded, *where, lockstep=not command.real_time, lost_arm=loss, stop=requested, ready=ready, pauses=pauses,
        common_start=command.common_start, utc_offset_ns=command.utc_offset_ns, stops=command.stops,
    )  # fmt: skip
    listener.say(summary)
    return 0


def emulate(command: EmulateCommand, listener: Listener) -> int:
    """Emulated servos of the cell's arms on pseudo terminals."""
    from agent.atomic import make_folder
    from agent.config.cell import load_cell
    from agent.host.paths import emulated_port_in, make_runtime_dir, ring_path
    from agent.process.befallen import require_done
    from agent.process.emulate import about_the_object, gripping, run_emulate, run_emulate_alone
    from agent.process.whole import at_rest
    from agent.telemetry.row.topics import PLANT
    from sim_backend.wire.serve import ServeOptions

    requested, timing = begin(command.with_parent), not command.no_timing
    loaded = load_cell(command.cell)
    make_folder(command.ports)
    name = loaded.file.name
    floating = loaded.file.floating
    require_done(loaded, stops=True, whole=command.whole)
    alone = loaded.file.hil is not None or (floating is not None and not floating.holding)
    if command.ring is None and not alone:
        make_runtime_dir(name)
    places = {arm.name: emulated_port_in(command.ports, arm.name) for arm in loaded.arms}
    options = ServeOptions(places, command.faults, command.control, command.seed)
    if alone:
        listener.say(run_emulate_alone(loaded, options, timing=timing, stop=requested, ready=ready))
        return 0
    where = command.ring or ring_path(name, PLANT)
    begins = at_rest if command.whole else gripping if floating is None else about_the_object
    summary = run_emulate(
        loaded, options, where, timing=timing, stop=requested, ready=ready, begin=begins,
        common_start=command.common_start, utc_offset_ns=command.utc_offset_ns, stops=command.stops,
    )  # fmt: skip
    listener.say(summary)
    return 0
