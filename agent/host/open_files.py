"""How many files, sockets and pipes this process may have open at a time, and what to do about too few."""

from __future__ import annotations

import resource
from typing import Final

NEEDED: Final = 128  # by a process on the network, each of whose links is one
REMEDY: Final = "raise it with `ulimit -n 1024`, or LimitNOFILE= of a unit"


def raised() -> int:
    """The limit, raised to `NEEDED` where this user may; that much where there is none."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return NEEDED
    least = NEEDED if hard == resource.RLIM_INFINITY else min(NEEDED, hard)
    if soft < least:
        resource.setrlimit(resource.RLIMIT_NOFILE, (least, hard))
    return max(soft, least)


def found() -> str:
    """The limit in words."""
    return f"a limit of {resource.getrlimit(resource.RLIMIT_NOFILE)[0]} open files (`ulimit -n`)"
