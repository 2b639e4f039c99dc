"""A Zenoh session that listens and connects where it was told, with no scouting, and is closed in any case."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Final

import zenoh

from agent.host import open_files
from agent.telemetry.link.endpoint import EndpointError, NetworkError, require_endpoint

MESSAGE_BYTES_MAX: Final = 1 << 20  # Zenoh's default would let a stranger ask for 1 GiB
_PORT_ATTEMPTS: Final = 20
_VIEWER_TIMEOUT_MS: Final = 3000
_IN_SOURCE: Final = re.compile(r" at /\S+\.rs:[0-9]+\.?")  # where Zenoh found an error, which may stand in another one

_CLOSED: Final[dict[str, Any]] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,  # its buffers can be invalidated under CPU load
    "transport/link/rx/max_message_size": MESSAGE_BYTES_MAX,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "transport/unicast/max_sessions": 32,
    "transport/unicast/accept_pending": 8,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    "adminspace/enabled": False,
    "plugins_loading/enabled": False,
}
# On what a process passes on from one member to another: a receiver that stands still loses rows, and nobody waits
# for it.  With 16 batches of 64 kB for each receiver one that keeps up loses almost none of 4000 rows/s.
_PASSES_ON: Final[dict[str, Any]] = {
    "qos/network": [
        {"messages": ["put"], "key_exprs": ["**"], "flows": ["egress"], "overwrite": {"congestion_control": "drop"}}
    ],
    "transport/link/tx/queue/size/data": 16,
}
_FREE: Final = {
    "expected": "an endpoint that is free, and files that can be read",
    "remedy": "see `ss -tlnp` for who listens where; port 0 takes a free one",
}
_SERVED: Final = {
    "expected": "somebody who listens there",
    "remedy": "start them first (`coop run` or `coop record`; of ROS its router), or correct the endpoint",
}
_FREE_OR_SERVED: Final = {
    "expected": "endpoints to listen on that are free, somebody at those to connect to, and files that can be read",
    "remedy": "see `ss -tlnp` for who listens where, and correct the file",
}


class Role(Enum):
    """How a process takes part; the values are Zenoh's modes."""

    MEMBER = "peer"  # opens without the others and meets them when they come
    VIEWER = "client"  # hears everything through the recorder it connects to; does not open without it


@dataclass(frozen=True, slots=True)
class Network:
    """Where to listen and connect; a configuration file (TLS, access control) replaces all of it."""

    connect: tuple[str, ...] = ()
    listen: str | None = None  # port 0: any free one
    config_file: Path | None = None
    role: Role = Role.MEMBER
    timestamps: bool = False  # on what it publishes, for receivers that recover by time (rmw_zenoh)
    passes_on: bool = False  # it publishes nothing itself; viewers hear the cell through it and are never waited for


@dataclass(frozen=True, slots=True)
class OpenSession:
    """A session and where it can be reached."""

    session: zenoh.Session
    endpoint: str | None  # None: it listens nowhere, or where its file says

    def put(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        """Send it under this key, and wait where there is no room on the way: nothing is dropped."""
        self.session.put(key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.BLOCK)


@contextmanager
def open_session(network: Network) -> Iterator[OpenSession]:
    """Session for `network`, closed when the block ends in whatever way.  Raises NetworkError."""
    opened = _open(network)
    try:
        yield opened
    finally:
        opened.session.close()  # type: ignore[no-untyped-call]


def has_link(session: zenoh.Session) -> bool:
    """Whether anybody is connected; with wrong credentials a session opens without complaint and has none."""
    return bool(session.info.links())


def _open(network: Network) -> OpenSession:
    if open_files.raised() < open_files.NEEDED:  # Zenoh would open all the same, and take in nobody
        raise NetworkError(
            "network of this process", found=open_files.found(), expected=f"{open_files.NEEDED} or more",
            remedy=open_files.REMEDY,
        )  # fmt: skip
    if network.config_file is not None:
        file = network.config_file
        return OpenSession(_try_open(_from_file(file), f"configuration {file}", _FREE_OR_SERVED), None)
    if network.listen is not None:
        require_endpoint(network.listen)
    if network.listen is None or not network.listen.endswith(":0"):
        where = network.listen or " ".join(network.connect) or "no endpoint"
        wanted = _SERVED if network.role is Role.VIEWER else _FREE
        return OpenSession(_try_open(_from_table(network, network.listen), where, wanted), network.listen)
    for attempt in range(_PORT_ATTEMPTS):
        endpoint = f"{network.listen[:-2]}:{_free_port()}"
        try:
            return OpenSession(_try_open(_from_table(network, endpoint), endpoint, _FREE), endpoint)
        except NetworkError:  # somebody took the port between the question and the answer
            if attempt == _PORT_ATTEMPTS - 1:
                raise
    raise AssertionError("the last attempt returns or raises")


def _try_open(config: zenoh.Config, what: str, wanted: Mapping[str, str]) -> zenoh.Session:
    """wanted: expected and remedy, for who cannot open it."""
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise NetworkError(
            f"cannot open the network at {what}",
            found=_IN_SOURCE.sub("", str(error)),
            **wanted,
        ) from error


def _from_file(path: Path) -> zenoh.Config:
    try:
        config = zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise NetworkError(
            f"Zenoh configuration {path}",
            found=_IN_SOURCE.sub("", str(error)),
            expected="a file in Zenoh's JSON5 with known keys only",
            remedy="correct it; the shipped examples show the keys that work",
        ) from error
    _require_own_files(json.loads(config.get_json("transport/link/tls")) or {}, path)
    return config


def _require_own_files(tls: Mapping[str, Any], path: Path) -> None:
    """Raise NetworkError for keys and certificates that cannot be used: who dials with them only has no link."""
    import ssl  # noqa: PLC0415 - for whom a file names some

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    for end in ("listen", "connect"):
        certificate, key = tls.get(f"{end}_certificate"), tls.get(f"{end}_private_key")
        if certificate and key:
            _usable(path, f"{certificate} and {key}", partial(context.load_cert_chain, certificate, key, password=""))
    authority = tls.get("root_ca_certificate")
    if authority:
        _usable(path, authority, partial(context.load_verify_locations, authority))


def _usable(path: Path, files: str, load: Callable[[], None]) -> None:
    try:
        load()
    except OSError as error:  # of the host, or what OpenSSL found
        raise NetworkError(
            f"Zenoh configuration {path}",
            found=f"{files}: {error.strerror}",
            expected="files that can be read, and a key of its certificate",
            remedy="copy them again from the folder that `coop pki` made (docs/security.md)",
        ) from error


def _from_table(network: Network, listen: str | None) -> zenoh.Config:
    config = zenoh.Config()
    table = _CLOSED | {
        "mode": network.role.value,
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": list(network.connect),
    }
    if network.timestamps:
        table |= {"timestamping/enabled": True}
    if network.passes_on:
        table |= _PASSES_ON
    if network.role is Role.VIEWER:
        table |= {"connect/exit_on_failure": True, "connect/timeout_ms": _VIEWER_TIMEOUT_MS}
    try:
        for key, value in table.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise EndpointError(
            "endpoint",
            found=", ".join(filter(None, (listen, *network.connect))),
            expected="like tcp/127.0.0.1:7448",
            remedy="correct it",
        ) from error
    return config


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
