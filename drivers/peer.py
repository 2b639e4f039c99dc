"""Who is at the other end of a Unix socket; the one home of it, for the agents' sockets and the plant's."""

from __future__ import annotations

import socket
import struct
from typing import Final

_CREDENTIALS: Final = struct.Struct("=iII")  # pid, uid, gid


def peer_uid(connected: socket.socket) -> int:
    """The user of the process at the other end, as the kernel says.  Raises OSError."""
    credentials = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    uid: int = _CREDENTIALS.unpack(credentials)[1]
    return uid
