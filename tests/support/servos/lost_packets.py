"""Phases of an arm's life on its bus, each with one packet lost in every way, and what must hold of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache

from agent.modes import Mode
from drivers.dynamixel.errors import FaultCause
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import Instruction
from drivers.dynamixel.servo.units import watchdog_count
from drivers.interface import DriverError
from tests.support.servos.guarded_rig import Died
from tests.support.servos.lossy_line import Loss, Packet, What
from tests.support.servos.lossy_rig import MS, OneArm, Over, look, mapped

BEFORE, COUNTED, AFTER = 15, 8, 30  # cycles
STUCK_S, UNPLUGGED_S, AWAY_S = 0.26, 0.65, 0.3
FIRST_NS, LOST_NS = 20 * MS, 30 * MS  # from the agent's death to the guard's first torque, and with a loss more
WATCHDOG_S = 0.25  # within which servos that hear nothing have stopped: 0.2 s in steps of 20 ms
GRIP_M, GRIP_TICK = 0.03, 1802  # a width, and the goal of the gripper's servo for it
ARMED = watchdog_count(mapped().watchdog_s)


@dataclass
class Story:
    """What came of one case."""

    rig: OneArm
    loss: Loss | None
    packets: list[Packet] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    began_ns: int = 0
    took_ns: int = 0
    error: DriverError | None = None
    died: bool = False
    gave_up: bool = False  # the guard

    def require(self, holds: bool, text: str) -> None:
        if not holds:
            self.wrong.append(text)

    def begin(self) -> None:
        """The phase begins: packets count."""
        self.began_ns = self.rig.clock._ns
        self.rig.port.count(self.loss)

    def finish(self) -> None:
        """It is over."""
        self.took_ns = self.took_ns or self.rig.clock._ns - self.began_ns
        self.packets = self.packets or self.rig.port.packets
        self.rig.port.rest()


Play = Callable[[Story], None]


def acting(rig: OneArm) -> list[int]:
    """Servos that have torque and have not stopped by themselves."""
    return [s.id for s in rig.servos if s.firmware.body.drive.torque_on and not s.firmware.tripped]


def unwatched(rig: OneArm) -> list[int]:
    """Servos that have torque and nothing that would stop them."""
    looks = {s.id: look(s, rig.effort(s.id)) for s in rig.servos}
    return [i for i, seen in looks.items() if seen.torque and seen.watchdog == 0]


def orphaned(story: Story) -> None:
    """The process is dead and nobody takes over: the servos stop by themselves."""
    rig = story.rig
    story.died = True
    story.finish()
    rig.line.user = None  # the kernel closes what it had open
    rig.witness.see()
    story.require(not unwatched(rig), f"dead with torque and no watchdog: {unwatched(rig)}")
    rig.pass_time(WATCHDOG_S)
    story.require(not acting(rig), f"torque goes on behind the dead process: {acting(rig)}")


# --- bring-up ---------------------------------------------------------------------------------------------------------


def connected(story: Story) -> None:
    """Who is on the line is found out while somebody else has the arm: no register changes."""
    rig = story.rig
    rig.left_behind(torque=True)
    before = rig.registers()
    story.begin()
    try:
        rig.driver.connect()
        story.finish()
    except DriverError as error:
        story.error = error
    except Died:
        rig.line.user = None
        story.died = True
    story.finish()
    if not story.died:
        rig.driver.disable()  # as an agent does that has not enabled
        rig.driver.close()
    story.require(rig.registers() == before, "a register has changed")


def started(story: Story) -> None:
    """Bring-up as the agent does it, some cycles of a loop, and its end."""
    rig = story.rig
    before = rig.torques()
    try:
        rig.driver.connect()
        story.begin()
        try:
            rig.start()
            story.finish()
            story.require(rig.torques() == [1] * 7, f"started with torque {rig.torques()}")
            story.require(rig.watchdogs() == [ARMED] * 7, f"started with watchdogs {rig.watchdogs()}")
            cycles(rig, COUNTED)
            story.require(not rig.driver.faults, f"faults {rig.driver.faults}")
        except DriverError as error:
            story.error = error
        finally:
            story.finish()
            if not rig.port.dead:
                rig.end()
        after = [0] * 7 if story.error is None else before
        story.require(rig.torques() == after, f"torque {rig.torques()} behind the end, {after} before the start")
    except Died:
        orphaned(story)


def cycles(rig: OneArm, count: int) -> None:
    """The agent's loop for so many of its cycles."""

    def each(number: int) -> None:
        if number >= count:
            raise Over

    rig.carry(each)


def used(story: Story) -> None:
    story.rig.left_behind(torque=False)
    started(story)


def taken(story: Story) -> None:
    """Somebody has given it torque: it is refused, and left as it is."""
    story.rig.left_behind(torque=True)
    started(story)
    story.require(story.died or story.error is not None, "an arm with torque was started")
    story.require(story.rig.torques() == [1] * 7, "its torque was touched")


# --- the loop ---------------------------------------------------------------------------------------------------------


def guarded(story: Story, act: Play) -> None:
    """What the agent does; a guard that holds the arm where the agent is killed, and then lets it go in order."""
    rig, loss = story.rig, story.loss
    try:
        act(story)
        story.finish()
        rig.end()
        story.require(rig.torques() == [0] * 7, f"torque {rig.torques()} behind the end")
    except Died:
        if loss is not None and loss.what is What.ALONE:
            orphaned(story)
            return
        story.died = True
        story.finish()
        held(story, None)


def held(story: Story, loss: Loss | None, late_ns: int | None = None, *, counted: bool = False) -> None:
    """The guard goes on, and ends in order; an arm that obeyed has a torque of it in time."""
    rig = story.rig
    began_ns, obeyed = rig.clock._ns, len(acting(rig)) == len(rig.servos) and not unwatched(rig)

    def each(number: int) -> None:
        if number == COUNTED and counted:
            story.finish()
        if number >= AFTER:
            raise Over

    try:
        more = {} if late_ns is None else {"late_ns": late_ns}
        try:
            rig.guard(loss, each, **more)
        finally:
            story.finish()
        obeys(story)
        first_ns = rig.port.first_ns - began_ns
        in_time = not obeyed or late_ns is not None or first_ns <= (FIRST_NS if loss is None else FIRST_NS + LOST_NS)
        story.require(in_time, f"the guard's first torque comes after {first_ns / MS:.1f} ms")
        rig.end()
        story.require(rig.torques() == [0] * 7, f"torque {rig.torques()} behind the guard's end")
    except Died:
        orphaned(story)
    except DriverError as error:
        story.error, story.gave_up = error, True
        rig.driver.close()
        rig.pass_time(WATCHDOG_S)
        story.require(not acting(rig), f"torque goes on behind a guard that gave up: {acting(rig)}")
    story.require(rig.clock._ns - began_ns < 2_000 * MS, "the guard does not come to its end")


def obeys(story: Story) -> None:
    """The arm has its torque, its watchdogs, and a loop whose goals it follows."""
    rig = story.rig
    story.require(rig.torques() == [1] * 7, f"torque {rig.torques()}")
    story.require(rig.watchdogs() == [ARMED] * 7, f"watchdogs {rig.watchdogs()}")
    faults = [fault for fault in rig.driver.faults if fault.cause is not FaultCause.SILENT]  # which they were
    story.require(not faults, f"faults {[str(fault) for fault in faults]}")
    idle = [s.id for s in rig.servos if not look(s, rig.effort(s.id)).acts]
    story.require(not idle, f"servos {idle} do nothing")


def grips(story: Story) -> None:
    """The gripper goes where it was last told."""
    gripper = story.rig.gripper
    goal, effort = gripper.firmware.memory.get(table.GOAL_POSITION), gripper.firmware.memory.get(table.GOAL_PWM)
    wanted = GRIP_TICK, story.rig.driver._running.grip.effort
    story.require((goal, effort) == wanted, f"the gripper goes to {goal} with {effort}, told {wanted}")


def first_cycles(story: Story) -> None:
    def act(story: Story) -> None:
        rig = story.rig
        rig.witness.steps = 2.0
        rig.start()
        story.begin()

        def each(number: int) -> None:
            if number == 2:
                rig.driver.grip(GRIP_M)
            if number == 2 * COUNTED:
                story.finish()
            if number >= 2 * COUNTED + 12:
                raise Over

        rig.carry(each)
        grips(story)
        story.require(not rig.told.modes, f"it became {rig.told.modes}: {rig.told.troubles}")
        obeys(story)

    guarded(story, act)


def coming_back(happens: Callable[[Story], None]) -> Play:
    """A loop to which something happens for which its servos stop, and that brings them back."""

    def act(story: Story) -> None:
        rig = story.rig
        rig.witness.steps = 2.0
        rig.start()
        since = 0

        def each(number: int) -> None:
            nonlocal since
            if number == 2:
                rig.driver.grip(GRIP_M)
            if number == BEFORE:
                happens(story)
            back = number > BEFORE and story.began_ns and "REARMED" in [event.kind.name for event in rig.events]
            since += bool(back)
            if since == COUNTED:
                story.finish()
            if since >= AFTER:
                raise Over
            if number > BEFORE + 600:
                story.wrong.append("it does not come back")
                raise Over

        rig.carry(each)
        story.require(rig.told.modes[-1:] == [Mode.HOLD], f"it is in {rig.told.modes}")
        grips(story)
        obeys(story)

    return lambda story: guarded(story, act)


def stuck(story: Story) -> None:
    """The process stood still."""
    story.rig.pass_time(STUCK_S)
    story.begin()


def unplugged(seconds: float, *ids: int) -> Callable[[Story], None]:
    """These servos hear nothing for a while."""

    def happens(story: Story) -> None:
        rig = story.rig
        end_ns = rig.clock._ns + round(seconds * 1e9)
        deaf = [servo for servo in rig.servos if servo.id in ids]
        for servo in deaf:
            servo.deaf = True
        see = rig.witness.see

        def passed() -> None:
            if rig.clock._ns >= end_ns and deaf[0].deaf:
                for servo in deaf:
                    servo.deaf = False
                story.begin()
            see()

        rig.clock.passed = passed

    return happens


def gone(story: Story) -> None:
    """The adapter is away for a while."""
    rig = story.rig
    end_ns = rig.clock._ns + round(AWAY_S * 1e9)
    rig.port.gone = True
    see = rig.witness.see

    def passed() -> None:
        if rig.clock._ns >= end_ns and rig.port.gone:
            rig.port.gone = False
            story.begin()
        see()

    rig.clock.passed = passed


# --- switching off ----------------------------------------------------------------------------------------------------


def switched_off(*, fired: bool) -> Play:
    """Torque off of an arm that a loop has commanded; fired: so long ago that its watchdogs have."""

    def act(story: Story) -> None:
        rig = story.rig
        rig.witness.steps = 2.0
        rig.start()
        cycles(rig, BEFORE)
        if fired:
            rig.pass_time(STUCK_S)
        story.begin()
        rig.driver.disable()
        story.finish()
        story.require(rig.torques() == [0] * 7, f"torque {rig.torques()} behind disable")
        rig.driver.close()
        story.require(rig.line.user is None, "the port is not given back")
        rig.put_back()
        rig.start()
        obeys(story)

    return lambda story: guarded(story, act)


# --- the guard --------------------------------------------------------------------------------------------------------


def taken_over(*, late_ns: int | None = None, amid_arming: bool = False) -> Play:
    """An agent dies, and its guard takes over; late_ns: so much later.

    amid_arming: it dies in a recovery, once it has cleared the watchdogs, and what was to arm them got lost.
    """

    def play(story: Story) -> None:
        rig = story.rig
        rig.witness.steps = 2.0
        rig.start()
        cycles(rig, BEFORE)
        if amid_arming:
            rig.pass_time(STUCK_S)
            rig.witness.unarmed_max_ns = 400 * MS
            rig.driver._bus.write_blind(table.BUS_WATCHDOG, {joint.ids[0]: 0 for joint in rig.arm.joints})
            rig.rest_goals()
        story.began_ns = rig.clock._ns
        held(story, story.loss, late_ns, counted=True)

    return play


PHASES: dict[str, Play] = {
    "connect": connected,
    "new servos": started,
    "used servos": used,
    "servos with torque": taken,
    "first cycles": first_cycles,
    "stuck host": coming_back(stuck),
    "unplugged servos": coming_back(unplugged(UNPLUGGED_S, 1, 2, 3, 4, 5, 6, 7)),
    "unplugged shadow": coming_back(unplugged(AWAY_S, 3)),
    "port away": coming_back(gone),
    "torque off": switched_off(fired=False),
    "torque off, stopped": switched_off(fired=True),
    "guard": taken_over(),
    "guard, late": taken_over(late_ns=round(STUCK_S * 1e9)),
    "guard, amid arming": taken_over(amid_arming=True),
}
IMMORTAL = {"guard, amid arming"}  # its agent is dead, and a packet lost: with the guard dead too it is the third
UNGUARDED = {"connect", "new servos", "used servos", "servos with torque", "guard", "guard, late"}
LONGER_NS = 500 * MS


def told(phase: str, loss: Loss | None) -> Story:
    """One case from its beginning to its end."""
    story = Story(OneArm(), loss)
    PHASES[phase](story)
    story.wrong += story.rig.witness.broken
    story.require(story.rig.line.user is None, "the port is not given back")
    story.require(not story.gave_up or phase.startswith("torque off"), f"the guard gives up: {story.error}")
    if loss is None:
        story.require(story.error is None or phase == "servos with torque", f"refused: {story.error}")
        return story
    story.require(story.rig.port.struck or story.died, "nothing was lost")
    longest_ns = healthy(phase).took_ns + LONGER_NS
    story.require(story.took_ns <= longest_ns, f"it took {story.took_ns / MS:.0f} ms")
    refusable = healthy(phase).error is not None or loss.kills or loss.what is What.MISSED
    refusable = refusable or not healthy(phase).packets[loss.number].answered
    story.require(story.error is None or refusable, f"what could be asked again was refused: {story.error}")
    return story


def told_of_two(phase: str, loss: Loss) -> list[str]:
    """What does not hold of one with a loss and a second one: it may take longer, and be refused."""
    story = Story(OneArm(), loss)
    PHASES[phase](story)
    story.require(story.rig.port.struck, "nothing was lost")
    return story.wrong + story.rig.witness.broken


@cache
def healthy(phase: str) -> Story:
    """The same without any loss."""
    return told(phase, None)


def losses(phase: str) -> Iterator[Loss]:
    """All of them: each packet in each way; of reads that repeat each other, single servos of the first alone."""
    seen: set[bytes] = set()
    packets = healthy(phase).packets
    for number, packet in enumerate(packets):
        first = packet.data not in seen or not packet.answered
        seen.add(packet.data)
        some: tuple[int | None, ...] = packet.servos if first and len(packet.servos) > 1 else ()
        yield Loss(What.LOST, number)
        yield from (Loss(What.MISSED, number, servo) for servo in some)
        if packet.answered:
            yield Loss(What.UNANSWERED, number)
            each = (None, *(some if packet.data[7] != Instruction.WRITE else ()))
            yield from (Loss(What.UNREADABLE, number, servo) for servo in each)
        last = number + 1 == len(packets) or packets[number + 1].write != packet.write
        if last and phase not in IMMORTAL:
            if phase not in UNGUARDED:
                yield Loss(What.LAST, number)
            yield Loss(What.ALONE, number)


def arming(packet: Packet) -> bool:
    """Whether it is one of those that arm watchdogs."""
    writes = packet.data[7] in (Instruction.SYNC_WRITE, Instruction.WRITE)
    return writes and packet.data[8] == table.BUS_WATCHDOG.address and packet.data[-3] == ARMED


def losses_of_two(phase: str) -> Iterator[Loss]:
    """Of what arms watchdogs, for all its servos or for one, and of a later packet for all or for the same one.

    Behind what is not answered the later one is of the same write: each of these arms them by itself.
    """
    packets = healthy(phase).packets
    for first, packet in enumerate(packets):
        if not arming(packet):
            continue
        later = [n for n in range(first + 1, len(packets)) if packet.answered or packets[n].write == packet.write]
        for servo in (None, *(packet.servos if len(packet.servos) > 1 else ())):
            what = What.LOST if servo is None else What.MISSED
            for second in later:
                yield Loss(what, first, servo, Loss(What.LOST, second))
                if servo in packets[second].servos and not packets[second].answered:
                    yield Loss(what, first, servo, Loss(What.MISSED, second, servo))
