"""Network namespaces for tests: one per host of a cell, joined to the recorder's by a pair of virtual cables."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RECORDER = "10.77.0.1"  # of the recorder's host, whichever cable one comes by
_CLONE_NEWNET = 0x40000000


@dataclass(frozen=True)
class Inside:
    """A child's work in a namespace."""

    namespace: str
    function: Callable[..., Any]
    options: Any


def run_inside(options: Inside, stop: Callable[[], bool], ready: Callable[[Any], None]) -> Any:
    """For `Process`: enter the namespace before any thread is started, then work."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path(f"/run/netns/{options.namespace}").open() as there:
        if libc.setns(there.fileno(), _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), "setns")
    return options.function(options.options, stop, ready)


def run(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True, timeout=20)


def unavailable() -> str:
    """Why there can be no namespaces here; empty when there can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if absent := [tool for tool in ("ip", "tc") if shutil.which(tool) is None]:
        return f"no {' or '.join(absent)} in the search path of this process"
    name = f"coop{os.getpid()}try"
    try:
        run("ip", "netns", "add", name)
        run("ip", "netns", "del", name)
    except (OSError, subprocess.SubprocessError) as error:
        return f"no network namespaces here: {error}"
    return ""


class Hosts:
    """Namespaces by the name of their host."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self.names = dict(names)
        self._numbers = {host: k for k, host in enumerate(names)}

    def ip(self, host: str, *words: str) -> None:
        run("ip", "-n", self.names[host], *words)

    def join(self, host: str) -> None:
        """A cable between this host and the recorder's."""
        k = self._numbers[host]
        run("ip", "link", "add", f"ctr{k}", "netns", self.names["recorder"], "type", "veth", "peer", "name", f"cta{k}",
            "netns", self.names[host])  # fmt: skip
        self.ip("recorder", "addr", "add", f"10.77.{k}.1/24", "dev", f"ctr{k}")
        self.ip("recorder", "link", "set", f"ctr{k}", "up")
        self.ip(host, "addr", "add", f"10.77.{k}.2/24", "dev", f"cta{k}")
        self.plug(host)

    def plug(self, host: str) -> None:
        k = self._numbers[host]
        self.ip(host, "link", "set", f"cta{k}", "up")
        self.ip(host, "route", "replace", f"{RECORDER}/32", "via", f"10.77.{k}.1")

    def unplug(self, host: str) -> None:
        self.ip(host, "link", "set", f"cta{self._numbers[host]}", "down")

    def slow(self, host: str, rate: str) -> None:
        """What the host sends goes at this rate, as `tc` writes it; queued for 0.4 s, then dropped."""
        self._tc(host, "replace", "tbf", "rate", rate, "burst", "16kbit", "latency", "400ms")

    def fast(self, host: str) -> None:
        self._tc(host, "del")

    def _tc(self, host: str, word: str, *rest: str) -> None:
        device = f"cta{self._numbers[host]}"
        run("ip", "netns", "exec", self.names[host], "tc", "qdisc", word, "dev", device, "root", *rest)


@contextmanager
def hosts(*others: str) -> Iterator[Hosts]:
    """The recorder's host and these, each with a cable to it, for the time of the block."""
    made = Hosts({host: f"coop{os.getpid()}{host}" for host in ("recorder", *others)})
    try:
        for host in made.names:
            run("ip", "netns", "add", made.names[host])
            made.ip(host, "link", "set", "lo", "up")
        made.ip("recorder", "addr", "add", f"{RECORDER}/32", "dev", "lo")
        for host in others:
            made.join(host)
        yield made
    finally:
        for name in made.names.values():
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)
