"""Each single packet of a phase of an arm's life is lost once, in every way, and the servos are looked at past the bus.

Real driver, loop and guard's steps on emulated servos in virtual time (`tests/support/servos/lost_packets.py`).
Phases, with their names there: a connection to an arm that somebody else moves ("connect"); bring-up of servos that
have other modes ("new servos"), old goals and fired watchdogs ("used servos"), or torque ("servos with torque"); the
loop's first cycles; the way back of an arm whose process stood still, whose servos, or shadow alone, heard nothing for
a while, or whose adapter was away; torque off, also of an arm whose watchdogs have fired; and a guard that takes over
at once, late, or where the agent died amid a recovery and the watchdogs are cleared.

Packet k is lost on its way, for all its servos or for one of several; or its answer is lost, or has a wrong checksum,
that of all or of one; or the process is killed once the write is out that k is the last of, and its guard goes on,
where it watches by then, or nobody.  What must hold, whichever it is:

1. Torque comes on in the mode of the map, with the goals of rest: no effort of what is controlled, the present place
   of what is held.
2. No servo has torque and a cleared watchdog, but where a guard finds it so: 0.4 s. Once the process is killed where
   nobody takes over, all servos with torque have stopped by themselves 0.25 s later.
3. The goal by which a controlled servo moves changes, but to zero, by no more than two torque steps of the loop (one
   write may be lost), and begins within that where torque comes on or back.
4. A start that is refused leaves torque as it was, a connection every register; a start that is not leaves all servos
   with torque, armed watchdogs, and a loop without faults.  Neither is refused for a packet that is answered, but where
   one servo of several misses it: it is asked again.
5. One packet lost in the first cycles is no reason to hold; a lapsed arm comes back in HOLD without faults but those of
   the silence, with torque, armed watchdogs and goals that it follows.  The gripper goes where it was told before.
6. Behind `disable` no servo has torque, and the arm can be started again.
7. The guard's first torque comes within 20 ms of the death of an agent whose arm obeyed, 50 ms with a packet lost; the
   guard has the arm as 5. says, or gives up one whose torque was being switched off.
8. What is raised is a DriverError, the port is given back, and the phase takes at most 0.5 s longer than without loss.

Of what arms watchdogs, in bring-up and on the way back, two packets are lost as well: 1 to 3 hold then, too, and what
4 and 5 say of an arm that is not refused.

What is assumed: a kill does not cut one write; a servo whose watchdog has fired stays stopped until its next goal, as
emulated ones do; a packet that one servo misses has fed its watchdog all the same.
"""

from __future__ import annotations

import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import Instruction
from tests.support.few import long
from tests.support.servos.lossy_line import Loss, What
from tests.support.servos.lost_packets import PHASES, healthy, losses, losses_of_two, told, told_of_two

TORQUE, WATCHDOG, CURRENT, POSITION = (
    register.address for register in (table.TORQUE_ENABLE, table.BUS_WATCHDOG, table.GOAL_CURRENT, table.GOAL_POSITION)
)


def writes_of(phase: str, address: int) -> list[int]:
    """Numbers of the packets that write that register."""
    return [
        number
        for number, packet in enumerate(healthy(phase).packets)
        if packet.data[7] in (Instruction.SYNC_WRITE, Instruction.WRITE) and packet.data[8] == address
    ]


def wrong(phase: str, loss: Loss) -> list[str]:
    """What does not hold of one case."""
    servo = "" if loss.servo is None else f", servo {loss.servo}"
    return [f"packet {loss.number}{servo}: {text}" for text in told(phase, loss).wrong]


@pytest.mark.long
@pytest.mark.parametrize("what", What)
@pytest.mark.parametrize("phase", PHASES)
def test_no_single_packet_leaves_an_arm_as_it_must_not_be(phase: str, what: What) -> None:
    assert healthy(phase).wrong == []
    assert [text for loss in losses(phase) if loss.what is what for text in wrong(phase, loss)] == []


SOME = [
    ("used servos", What.MISSED, CURRENT, 1, 3),
    long(("used servos", What.LOST, TORQUE, 0, None)),
    ("used servos", What.ALONE, TORQUE, 0, None),
    ("torque off", What.MISSED, TORQUE, 1, 3),
    ("stuck host", What.ALONE, WATCHDOG, 0, None),
    long(("unplugged shadow", What.LOST, WATCHDOG, -1, None)),
    ("unplugged shadow", What.MISSED, WATCHDOG, -1, 5),
    long(("unplugged shadow", What.MISSED, CURRENT, -9, 4)),
    ("guard, amid arming", What.LOST, CURRENT, 0, None),
    ("first cycles", What.LAST, CURRENT, 4, None),
    long(("first cycles", What.LOST, CURRENT, 4, None)),
    long(("first cycles", What.LOST, POSITION, 0, None)),
]


@pytest.mark.parametrize(("phase", "what", "address", "place", "servo"), SOME)
@pytest.mark.fault("B1", "P1", "P8", "S6")
def test_of_these_packets_none_does(phase: str, what: What, address: int, place: int, servo: int | None) -> None:
    number = writes_of(phase, address)[place]
    assert healthy(phase).wrong == []
    assert wrong(phase, Loss(what, number, servo)) == []


@pytest.mark.long
@pytest.mark.parametrize("phase", ["used servos", "stuck host", "unplugged shadow"])
def test_two_packets_of_those_that_arm_leave_no_torque_without_a_watchdog(phase: str) -> None:
    assert [text for loss in losses_of_two(phase) for text in told_of_two(phase, loss)] == []


@pytest.mark.fault("P8")
def test_a_shadow_that_has_missed_its_watchdog_gets_no_torque_and_is_named() -> None:
    armed = writes_of("used servos", WATCHDOG)[-5]
    assert healthy("used servos").packets[armed].servos == (2, 3)
    story = told("used servos", Loss(What.MISSED, armed, 3))
    assert "servo 3" in str(story.error)
    assert "Bus Watchdog 0" in str(story.error)
    assert story.wrong == []


@pytest.mark.parametrize(("first", "second"), [(-2, -1), (-3, -1), (-3, -2)])
@pytest.mark.parametrize("servo", [None, 3])
@pytest.mark.fault("P8", "S6")
def test_watchdogs_are_armed_again_with_two_packets_of_that_lost(first: int, second: int, servo: int | None) -> None:
    what = What.LOST if servo is None else What.MISSED
    one, other = (writes_of("stuck host", WATCHDOG)[place] for place in (first, second))
    assert told_of_two("stuck host", Loss(what, one, servo, Loss(what, other, servo))) == []
