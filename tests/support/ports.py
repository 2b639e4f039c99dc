"""A TCP port of this host for a test that must know its number before anybody listens there."""

from __future__ import annotations

import random
import socket

_BELOW_THE_KERNELS = range(15_000, 32_000)  # it gives connections, and who asks for port 0, those from 32768 on


def free_port() -> int:
    """One that is free, and that nobody gets by chance before the test listens, or listens again."""
    chance = random.SystemRandom()  # test processes beside this one draw others
    while True:
        port = chance.choice(_BELOW_THE_KERNELS)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
