"""A process that may open too few files says so, and by how many: a log without rows was all that told of it."""

from __future__ import annotations

import errno
import os
import resource

import pytest

from agent.host import open_files
from agent.host.starting import of_host
from agent.telemetry.link.endpoint import FREE_PORT, NetworkError
from agent.telemetry.link.session import Network, open_session

NO_LIMIT = resource.RLIM_INFINITY


class Limits:
    """Of a process; what it sets counts."""

    RLIMIT_NOFILE, RLIM_INFINITY = resource.RLIMIT_NOFILE, NO_LIMIT

    def __init__(self, soft: int, hard: int) -> None:
        self.now = soft, hard

    def getrlimit(self, _: int) -> tuple[int, int]:
        return self.now

    def setrlimit(self, _: int, limits: tuple[int, int]) -> None:
        self.now = limits


@pytest.mark.parametrize(
    ("soft", "hard", "raised", "now"),
    [
        (1024, 4096, 1024, 1024),
        (128, 128, 128, 128),
        (20, 4096, 128, 128),
        (20, 100, 100, 100),
        (20, 20, 20, 20),
        (20, NO_LIMIT, 128, 128),
        (NO_LIMIT, NO_LIMIT, 128, NO_LIMIT),
    ],
)
def test_a_limit_is_raised_as_far_as_is_needed_and_allowed(
    monkeypatch: pytest.MonkeyPatch, soft: int, hard: int, raised: int, now: int
) -> None:
    limits = Limits(soft, hard)
    monkeypatch.setattr(open_files, "resource", limits)
    assert (open_files.raised(), limits.now) == (raised, (now, hard))


def test_a_network_that_could_take_in_nobody_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_files, "resource", Limits(20, 127))
    told = r"found a limit of 127 open files \(`ulimit -n`\), expected 128 or more; raise it with `ulimit -n 1024`"
    with pytest.raises(NetworkError, match=told), open_session(Network(listen=FREE_PORT)):
        pass
    monkeypatch.setattr(open_files, "resource", Limits(20, 128))
    with open_session(Network(listen=FREE_PORT)) as opened:
        assert opened.endpoint


def test_a_command_that_has_no_room_for_another_file_names_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_files, "resource", Limits(10, 10))
    told = of_host(OSError(errno.EMFILE, os.strerror(errno.EMFILE)))
    assert told == (
        "this host: found Too many open files, with a limit of 10 open files (`ulimit -n`), expected more; "
        "raise it with `ulimit -n 1024`, or LimitNOFILE= of a unit"
    )
    assert "limit" not in of_host(OSError(errno.ENFILE, os.strerror(errno.ENFILE)))
