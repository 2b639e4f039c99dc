"""Who is at the other end of a socket is asked of the kernel."""

from __future__ import annotations

import os
import socket
import struct
from typing import Any

import pytest

from drivers.peer import peer_uid


def test_the_user_of_a_peer_is_the_one_that_it_runs_as() -> None:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with here, there:
        assert peer_uid(here) == os.geteuid()


@pytest.mark.parametrize("uid", [0, 1000, 2**31 + 5, 2**32 - 2])
def test_of_what_the_kernel_says_the_second_number_is_the_user_however_large(uid: int) -> None:
    class Connected:
        def getsockopt(self, level: int, option: int, size: int) -> bytes:
            assert (level, option, size) == (socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
            return struct.pack("=iII", 4242, uid, 77)

    connected: Any = Connected()
    assert peer_uid(connected) == uid
