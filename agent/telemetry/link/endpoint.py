"""Where somebody may listen, without what listens there: who names a place need not load the network."""

from __future__ import annotations

import re
from typing import Final

from drivers.interface import Refusal

LOOPBACK: Final = "tcp/127.0.0.1"
FREE_PORT: Final = f"{LOOPBACK}:0"
PORT_MAX: Final = 65535
_PLACE: Final = re.compile(r"(tcp|udp|ws)/(\[[^]]+]|[^]/:?#[]+):(?P<port>[0-9]{1,5})([?#].*)?|unixsock-stream/.+")


class NetworkError(Refusal):
    """The network cannot be used as it is configured."""

    exit_code = 4


class EndpointError(NetworkError):
    """No place to listen at or to connect to; nothing was opened."""

    exit_code = 2


def require_endpoint(listen: str) -> None:
    """Raise EndpointError for what is no place to listen at, whether it is free or not."""
    found = _PLACE.fullmatch(listen)
    if found is None or int(found["port"] or 0) > PORT_MAX:
        raise EndpointError(
            "endpoint to listen at", found=repr(listen), expected=f"like tcp/127.0.0.1:7448, port 0 to {PORT_MAX}",
            remedy="correct it; port 0 takes a free one",
        )  # fmt: skip
