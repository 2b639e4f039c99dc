"""Whether an agent still works, judged from a count that it raises every cycle."""

from __future__ import annotations

from dataclasses import dataclass

LATE_LOOK = 2  # periods of looking; what is beyond was the watcher's own lateness, and counts as that much


@dataclass(slots=True)
class Vigil:
    """Stale when the count has stood still for stale_ns of looking every look_ns; at 0, for first_ns if that is more.

    A host that stalls stalls both: the time in which nobody looked is not held against the agent.
    """

    stale_ns: int
    look_ns: int
    first_ns: int = 0
    count: int = -1
    still_ns: int = 0  # for so long it has stood still
    looked_ns: int = 0
    excused_until_ns: int = 0

    def excuse(self, until_ns: int) -> None:
        """The agent has said that it will be busy until then."""
        self.excused_until_ns = until_ns

    def is_stale(self, now_ns: int, count: int) -> bool:
        """One look at the count."""
        passed_ns = min(now_ns - self.looked_ns, LATE_LOOK * self.look_ns)
        self.looked_ns = now_ns
        if count != self.count or now_ns < self.excused_until_ns:
            self.count, self.still_ns = count, 0
            return False
        self.still_ns += passed_ns
        return self.still_ns >= (self.stale_ns if count else max(self.stale_ns, self.first_ns))
