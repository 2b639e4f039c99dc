"""How long a control cycle occupies the bus, computed from its bytes; and the highest rate that fits.

One cycle is a group read of the block at 126 from all servos, a group write per goal register, and, in the gap, one
health read.  The read is waited for; write and health read are sent and left alone, but the wire must be free again
when the next cycle begins.  10 bits per byte.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.dynamixel.arm_map import ArmMap, JointRole
from drivers.dynamixel.servo.codes import OperatingMode

CYCLE_BYTES = 10  # Present Current or Load, Velocity, Position
PLAIN_BYTES, PLAIN_BYTES_MAX = 14, 18  # the same without merged replies, where the length tells cycles apart
HEALTH_BYTES = 6  # the longest health read: torque flag, LED, errors, watchdog, goal
STEP_S = 0.3e-3  # control step and wake-up of the host between read and write
FAULT_WITHIN_S = 0.05
SLOW_EVERY = 8  # every eighth gap asks for temperature and voltage


@dataclass(frozen=True, slots=True)
class LinkTiming:
    """What the wire adds to its bytes.  No figure is published for the X series; MX-64 measure about 50 µs."""

    turnaround_s: float = 40e-6  # from the end of a request to the reply, and between replies
    fast_gap_s: float = 5e-6  # between the blocks of a merged reply
    return_delay_s: float = 0.0  # Return Delay Time of the servos, which bring-up sets to 0
    usb_latency_s: float = 1e-3  # latency timer of the USB adapter; 16 ms is the Linux default


@dataclass(frozen=True, slots=True)
class CycleBudget:
    """Durations of one cycle, s."""

    request_s: float
    reply_s: float  # on the wire, turnarounds included
    usb_worst_s: float  # the reply may wait this long in the adapter; half of it on average
    write_s: float
    health_s: float  # health read of one servo
    step_s: float

    @property
    def read_mean_s(self) -> float:
        """What a cycle's read takes on average."""
        return self.request_s + self.reply_s + 0.5 * self.usb_worst_s

    @property
    def read_worst_s(self) -> float:
        """What a cycle's read may take when nothing is wrong."""
        return self.request_s + self.reply_s + self.usb_worst_s

    @property
    def delay_mean_s(self) -> float:
        """From the instant at which the servos sample to the one at which the torque has reached them, on average."""
        return self.reply_s + 0.5 * self.usb_worst_s + self.step_s + self.write_s

    @property
    def cycle_s(self) -> float:
        """Shortest period the bus carries, health reads included."""
        return self.read_worst_s + self.step_s + self.write_s + self.health_s

    @property
    def rate_max_hz(self) -> float:
        """Highest rate the bus carries, rounded down."""
        return math.floor(1.0 / self.cycle_s)


def group_read_s(servos: int, length: int, baud: int, *, fast: bool, link: LinkTiming) -> tuple[float, float]:
    """Wire time of a group read: (request, reply), s."""
    byte_s = 10.0 / baud
    request = (14 + servos) * byte_s
    delay = link.turnaround_s + link.return_delay_s
    if fast:
        gaps = (servos - 1) * (link.fast_gap_s + link.return_delay_s)
        return request, delay + gaps + (8 + servos * (length + 4)) * byte_s
    return request, servos * (delay + (11 + length) * byte_s)


def cycle_budget(
    arm: ArmMap, *, fast: bool, link: LinkTiming | None = None, plain_bytes: int = PLAIN_BYTES
) -> CycleBudget:
    """Budget of one arm's cycle.  fast: all servos understand fast sync read; else they send plain_bytes each."""
    link = link or LinkTiming()
    byte_s = 10.0 / arm.baud
    request_s, reply_s = group_read_s(
        len(arm.slots), CYCLE_BYTES if fast else plain_bytes, arm.baud, fast=fast, link=link
    )
    modes = [joint.mode for joint in arm.joints if joint.role is JointRole.CONTROLLED]
    groups = [modes.count(OperatingMode.CURRENT), modes.count(OperatingMode.PWM)]
    write_s = sum((14 + 3 * count) * byte_s for count in groups if count)
    health_s = sum(group_read_s(1, HEALTH_BYTES, arm.baud, fast=fast, link=link))
    return CycleBudget(request_s, reply_s, link.usb_latency_s, write_s, health_s, STEP_S)


def health_servos_per_gap(arm: ArmMap, budget: CycleBudget, *, fast: bool, link: LinkTiming | None = None) -> int:
    """How many servos one health read may ask without reaching into the next cycle; 0 when the gap is too short."""
    link = link or LinkTiming()
    gap_s = 1.0 / arm.rate_hz - budget.read_worst_s - budget.step_s - budget.write_s
    count = 0
    while count < len(arm.slots):
        if sum(group_read_s(count + 1, HEALTH_BYTES, arm.baud, fast=fast, link=link)) > gap_s:
            break
        count += 1
    return count


def gaps_of(questions: int) -> int:
    """In which so many questions are asked beside those about temperature and voltage."""
    return -(-questions * SLOW_EVERY // (SLOW_EVERY - 1))


@dataclass(frozen=True, slots=True)
class Round:
    """How long it takes at most until a servo that restarted or lost its torque has been asked, and what is wanted."""

    seconds: float
    remedy: str

    @property
    def quick(self) -> bool:
        """Whether that is soon enough."""
        return self.seconds <= FAULT_WITHIN_S


def round_of(arm: ArmMap, *, fast: bool, link: LinkTiming | None = None) -> Round:
    """A round of questions, one a gap, with the gap before and the one in which the last answer is taken."""
    per_gap = health_servos_per_gap(arm, cycle_budget(arm, fast=fast, link=link), fast=fast, link=link)
    least_hz = (gaps_of(1) + 2) / FAULT_WITHIN_S
    remedy = "lower rate_hz, or raise the servos' Baud Rate and `baud`"
    if arm.rate_hz < least_hz:
        remedy = f"raise rate_hz to {least_hz:g} or more"
    gaps = gaps_of(-(-len(arm.slots) // max(1, per_gap))) + 2
    return Round(gaps / arm.rate_hz, remedy)
