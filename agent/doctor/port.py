"""Can the serial port of an arm be used, who has it, and is its adapter set up?"""

from __future__ import annotations

from pathlib import Path

from agent.verify.finding import Finding, Verdict, from_refusal, judged, refused, warning
from drivers.dynamixel.errors import PortError
from drivers.dynamixel.line.ports import CANDIDATES, require_usable
from drivers.dynamixel.pace import MAX_LATENCY_TIMER_MS

_SHIFTING = ("/dev/ttyUSB", "/dev/ttyACM")
UDEV = "install the udev rule shipped in systemd/udev, then unplug and plug the adapter"


def before_opening(path: str, where: str) -> list[Finding]:
    """Is it there, may it be opened, does anyone have it?  A problem among them: it must not be opened."""
    try:
        require_usable(path)
    except PortError as error:
        return [from_refusal(error, where)]
    found = [Finding(f"port {path}", where, _device(path), "readable and writable, used by nobody")]
    if path.startswith(_SHIFTING):
        remedy = f"use a lasting name: /dev/{CANDIDATES[0]}, or {UDEV}"
        found.append(warning("port name", where, path, "one that stays with the adapter", remedy))
    return found


def latency_timer(before_ms: int | None, opened_ms: int | None, where: str) -> Finding:
    """Latency timer of the USB adapter before and after the port was opened, which asks for a short one."""
    if opened_ms is None:
        return Finding("USB latency timer", where, "none: not an FTDI adapter", "1 ms")
    if opened_ms > MAX_LATENCY_TIMER_MS:
        return refused("USB latency timer", where, f"{opened_ms} ms", "1 ms", UDEV)
    lasting = before_ms is None or before_ms <= MAX_LATENCY_TIMER_MS
    found = f"{opened_ms} ms" if lasting else f"{before_ms} ms until a program asks for {opened_ms} ms"
    return judged(
        "USB latency timer", where, found, "1 ms from the start", holds=lasting, otherwise=Verdict.WARNING, remedy=UDEV
    )


def _device(path: str) -> str:
    real = Path(path).resolve()
    try:
        group = real.group()
    except KeyError:
        group = str(real.stat().st_gid)
    return f"{real}, group {group}"
