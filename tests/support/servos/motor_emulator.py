"""Loose emulated servos on one pty in a process of their own, for tests of the tools."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.serve import ServeOptions, serve
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring, JointWiring
from tests.support.forked import serving
from tests.support.servos.tool_rig import fresh
from tests.support.servos.wire_emulator import START_S


def serve_loose(port: Path, servos: tuple[dict[str, Any], ...], stop: Callable[[], bool]) -> None:
    """Serve until `stop` says so."""
    joints = tuple(JointWiring(f"joint {place}", (fresh(**servo),)) for place, servo in enumerate(servos))
    arm = EmulatedArm(ArmWiring("loose", joints), timing=BusTiming())
    serve(EmulatedCell([arm], None), ServeOptions(ports={"loose": port}), stop)


@contextlib.contextmanager
def loose_servos(port: Path, *servos: dict[str, Any]) -> Iterator[None]:
    """Servos as `tool_rig.fresh` makes them, on a port at this path."""
    with serving(serve_loose, port, servos) as process:
        deadline = time.monotonic() + START_S
        while not port.exists():
            assert process.is_alive(), "the emulator ended by itself"
            assert time.monotonic() < deadline, "the emulator did not start"
            time.sleep(0.01)
        yield
    assert not port.is_symlink()
