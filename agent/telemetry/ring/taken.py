"""Who has a ring that a second writer is refused, as far as the ring says it."""

from __future__ import annotations

from pathlib import Path

PLANT = "plant"  # which nobody guards


def writer_of(name: str, pid: int) -> tuple[str, str]:
    """What is found, and what to do, of a locked ring that process `pid` made for this arm, or for the plant."""
    try:
        made = f"process {pid} ({Path(f'/proc/{pid}/comm').read_text().strip()})"
    except OSError:
        made = f"process {pid}, which has ended"
    guarded = "" if name == PLANT else "; a guard that holds the arm after its agent ends with `coop release`"
    return f"its lock held by another process; it was made by {made}", f"stop it first{guarded}"
