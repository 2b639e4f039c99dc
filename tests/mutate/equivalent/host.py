"""Of the processes of an arm and what they know of each other."""

from __future__ import annotations

from tests.mutate.equivalent.entries import Entries

_A_LOOK_LATER = "how often somebody is told while a process ends"

HOST: Entries = {
    "agent.host.process_handle": {
        (
            "ProcessHandle.ended",
            "return _is_readable(self._fd, 0)",
            "return _is_readable(self._fd, 1)",
        ): "a millisecond, which no test measures",
        ("module", "KILL_LOOK_MS = 5", "KILL_LOOK_MS = 4"): _A_LOOK_LATER,
        ("module", "KILL_LOOK_MS = 5", "KILL_LOOK_MS = 6"): _A_LOOK_LATER,
    },
    "agent.process.hearing": {
        ("Hearing._first", "return None", "pass"): "the end of the function",
    },
}
