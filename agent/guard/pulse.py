"""The guard's pulse: a count in shared memory that it raises at each look at its agent, which watches it in turn."""

from __future__ import annotations

import fcntl
import mmap
import os
from typing import Self

from agent.guard.vigil import Vigil

STALE_NS = 200_000_000  # without a look, after which the guard hangs; a hundred of its looks
SHARED_S = 0.5  # for so long what shares a processor with everything else is borne: it stops with that for a while
SHARED_STALE_NS = round(SHARED_S * 1e9)
STALE_PERIODS = 3  # at least, of a slow loop
_BYTES = 8


def pulse_vigil(period_ns: int, *, shared: bool) -> Vigil:
    """How an agent with that period watches its guard; shared: servos or plant have their time of the same host."""
    return Vigil(max(SHARED_STALE_NS if shared else STALE_NS, STALE_PERIODS * period_ns), period_ns)


class Pulse:
    """The count, which only ever rises; a guard that comes back goes on where the one before it was."""

    def __init__(self, fd: int) -> None:
        """Of a descriptor, which is this one's from now on.  Raises ValueError for one that is too short."""
        self._fd = fd
        try:
            self._map = mmap.mmap(fd, _BYTES)
        except BaseException:
            os.close(fd)
            raise
        self._count = memoryview(self._map).cast("Q")

    @classmethod
    def made(cls) -> Self:
        """A new one, whose size nobody changes."""
        fd = os.memfd_create("guard-pulse", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(fd, _BYTES)
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        return cls(fd)

    @property
    def count(self) -> int:
        """How often the guard has looked."""
        return self._count[0]

    def beat(self) -> None:
        """The guard has looked."""
        self._count[0] += 1

    def fileno(self) -> int:
        """Descriptor, to be passed on."""
        return self._fd

    def close(self) -> None:
        """Give it back; twice is fine."""
        if not self._map.closed:
            self._count.release()
            self._map.close()
            os.close(self._fd)
