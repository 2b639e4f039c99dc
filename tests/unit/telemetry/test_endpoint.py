"""Where somebody is to listen: what is no place is refused before anything is opened, what is taken is told whole."""

from __future__ import annotations

import socket
from contextlib import closing

import pytest

from agent.telemetry.link.endpoint import EndpointError, NetworkError, require_endpoint
from agent.telemetry.link.session import Network, open_session

PLACES = ("tcp/127.0.0.1:0", "tcp/[::1]:7448", "udp/localhost:65535", "ws/cell.lab:80#iface=eth0")


@pytest.mark.parametrize("place", [*PLACES, "unixsock-stream//tmp/cell"])
def test_a_place_to_listen_at_is_taken(place: str) -> None:
    require_endpoint(place)


@pytest.mark.parametrize(
    "place",
    [
        "foo", "", "tcp/127.0.0.1", "tcp/127.0.0.1:65536", "tcp/127.0.0.1:99999", "tcp/127.0.0.1:-5", "tcp/:7448",
        "tcp/127.0.0.1:x", "tls/127.0.0.1:7448", "TCP/127.0.0.1:0", "tcp/::1:0", "127.0.0.1:7448", "tcp/h:7448 ",
    ],
)  # fmt: skip
def test_what_is_none_is_a_mistake_of_the_command_line(place: str) -> None:
    with pytest.raises(
        EndpointError, match=r"expected like tcp/127.0.0.1:7448, port 0 to 65535; correct it"
    ) as refused:
        require_endpoint(place)
    assert refused.value.exit_code == 2
    with pytest.raises(EndpointError), open_session(Network(listen=place)):
        pass


def test_a_place_that_is_taken_is_told_without_where_in_its_source_the_network_found_it() -> None:
    with closing(socket.socket()) as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        place = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(NetworkError) as refused, open_session(Network(listen=f"tcp/{place}")):
            pass
    said = str(refused.value)
    assert f"[{place}: Address already in use (os error 98)], expected an endpoint that is free" in said
    assert ".rs" not in said
