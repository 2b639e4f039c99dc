"""Loose emulated servos on one pty in a process of their own, for tests of the tools: ends when its input closes."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.serve import ServeOptions, serve
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring, JointWiring
from tests.support.servos.tool_rig import fresh
from tests.support.servos.wire_emulator import START_S, standard_input_closed


def main(port: Path, servos: list[dict[str, Any]]) -> None:
    """Serve until standard input closes."""
    joints = tuple(JointWiring(f"joint {place}", (fresh(**servo),)) for place, servo in enumerate(servos))
    arm = EmulatedArm(ArmWiring("loose", joints), timing=BusTiming())
    serve(EmulatedCell([arm], None), ServeOptions(ports={"loose": port}), standard_input_closed)


@contextlib.contextmanager
def loose_servos(port: Path, *servos: dict[str, Any]) -> Iterator[None]:
    """Servos as `tool_rig.fresh` makes them, on a port at this path."""
    arguments = [sys.executable, "-m", "tests.support.servos.motor_emulator", str(port), json.dumps(servos)]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE) as process:
        try:
            deadline = time.monotonic() + START_S
            while not port.exists():
                assert process.poll() is None, "the emulator ended by itself"
                assert time.monotonic() < deadline, "the emulator did not start"
                time.sleep(0.01)
            yield
        finally:
            assert process.stdin is not None
            process.stdin.close()
            assert process.wait(START_S) == 0
    assert not port.is_symlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]), json.loads(sys.argv[2]))
