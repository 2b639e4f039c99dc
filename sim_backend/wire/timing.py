"""When bytes reach the host: wire time, return delay, turnaround and the USB adapter's latency timer.

Pure functions of virtual nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

BITS_PER_BYTE = 10  # start, eight, stop
FT232H_PAYLOAD = 510  # bytes of a full high-speed USB packet (U2D2); two of 512 are status


@dataclass(frozen=True, slots=True)
class UsbTiming:
    """How a USB serial adapter hands over received bytes: in full packets, or when its latency timer fires."""

    latency_ns: int = 1_000_000  # 16_000_000 is the Linux default of an FTDI adapter
    payload_bytes: int = FT232H_PAYLOAD
    # the adapter's clock is not the host's: a loop whose period is a multiple of the latency would otherwise see one
    # and the same phase for ever; real drifts are smaller and take minutes to show all phases
    drift_ppm: int = 3000


@dataclass(frozen=True, slots=True)
class BusTiming:
    """Timing of one bus.

    Turnaround is what remains at Return Delay Time 0.  Measured elsewhere: MX-64 about 50 us, AX-12 22 us; no figure
    is known for the X series, so the default is an assumption between them.
    """

    turnaround_ns: int = 40_000
    fast_gap_ns: int = 5_000  # between the blocks of a fast read; assumption
    usb: UsbTiming | None = UsbTiming()


class Delivery(NamedTuple):
    """Bytes the host can read from `due_ns` on."""

    due_ns: int
    data: bytes


def byte_ns(baud: int) -> float:
    """Time of one byte on the wire, ns."""
    return BITS_PER_BYTE * 1e9 / baud


class UsbBuffer:
    """The adapter's receive buffer: bytes go in as they end on the wire and come out as USB packets."""

    def __init__(self, timing: UsbTiming | None) -> None:
        self._timing = timing
        self._period_ns = round(timing.latency_ns * (1.0 + timing.drift_ppm * 1e-6)) if timing else 0
        self._held = bytearray()
        self._held_due_ns = 0
        self._timer_start_ns = 0  # the timer restarts with every packet the host took, empty ones included

    def push(self, start_ns: int, byte_time_ns: float, data: bytes) -> list[Delivery]:
        """Take bytes that begin on the wire at `start_ns`, not before earlier ones; return the packets now settled."""
        timing = self._timing
        end_ns = start_ns + round(byte_time_ns * len(data))
        if timing is None:
            return [Delivery(end_ns, data)] if data else []
        out = self.settle(start_ns)
        done, cursor_ns = 0, start_ns
        while done < len(data):
            tick_ns = self._tick_after(cursor_ns)
            by_tick = len(data) if tick_ns >= end_ns else max(done, int((tick_ns - start_ns) / byte_time_ns))
            by_tick = min(by_tick, done + timing.payload_bytes - len(self._held))
            self._held += data[done:by_tick]
            done = by_tick
            if len(self._held) >= timing.payload_bytes:
                cursor_ns = start_ns + round(done * byte_time_ns)
                out.append(self._flush(cursor_ns))
            elif done < len(data):
                cursor_ns = tick_ns
                if self._held:
                    out.append(self._flush(tick_ns))
        if self._held:
            self._held_due_ns = self._tick_after(end_ns - 1)
        return out

    def settle(self, now_ns: int) -> list[Delivery]:
        """Return what the latency timer has pushed out by `now_ns`."""
        if self._held and self._held_due_ns <= now_ns:
            return [self._flush(self._held_due_ns)]
        return []

    def due_ns(self) -> int | None:
        """When the timer will push out what is held; None when nothing is."""
        return self._held_due_ns if self._held else None

    def clear(self) -> None:
        """Lose what is held, as when the adapter is unplugged."""
        self._held.clear()

    def _tick_after(self, time_ns: int) -> int:
        """First instant after `time_ns` at which the timer fires."""
        period_ns = self._period_ns
        return self._timer_start_ns + ((time_ns - self._timer_start_ns) // period_ns + 1) * period_ns

    def _flush(self, at_ns: int) -> Delivery:
        delivery = Delivery(at_ns, bytes(self._held))
        self._held.clear()
        self._timer_start_ns = at_ns
        return delivery


class Line:
    """The half-duplex wire: who occupies it until when."""

    def __init__(self, timing: BusTiming | None) -> None:
        self.timing = timing
        self.free_ns = 0  # end of the last byte of any sender
        self.reply_end_ns = 0  # end of the last byte a servo sent

    def request(self, now_ns: int, size: int, baud: int, *, queued: bool = False) -> bool:
        """Put an instruction of `size` bytes on the wire; False when it collides with a reply still being sent.

        A `queued` one came in one piece with the instruction before it and waits for its turn: written that closely,
        or read late by a host that was stalled, in which case the pause between the two is not known.
        """
        if self.timing is None:
            self.free_ns = now_ns
            return True
        if now_ns < self.reply_end_ns and not queued:
            return False
        self.free_ns = max(now_ns, self.free_ns) + round(byte_ns(baud) * size)
        return True

    def reply(self, size: int, baud: int, delay_ns: int) -> int:
        """Put a reply of `size` bytes on the wire, `delay_ns` after what was there; return when it starts."""
        if self.timing is None:
            return self.free_ns
        start_ns = self.free_ns + delay_ns
        self.free_ns = self.reply_end_ns = start_ns + round(byte_ns(baud) * size)
        return start_ns

    def wait(self, duration_ns: int) -> None:
        """Let the next sender wait for one that stays silent."""
        if self.timing is not None:
            self.free_ns += duration_ns
