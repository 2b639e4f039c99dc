"""An emulated arm in a process of its own, for tests: ends when its standard input closes."""

from __future__ import annotations

import contextlib
import json
import select
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
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring, servo_eeprom

START_S = 30.0


def standard_input_closed() -> bool:
    """True once the parent has let go."""
    return bool(select.select((sys.stdin,), (), (), 0)[0])


def like_wx200(baud: int, firmware: int) -> ArmWiring:
    """Servos 1 to 7 of a wx200: a shoulder pair, a reversed elbow, XL430 at the end."""

    def servo(servo_id: int, model: str, *, reverse: bool = False, secondary_id: int = 255) -> ServoWiring:
        eeprom = servo_eeprom(baud=baud, reverse=reverse, secondary_id=secondary_id)
        return ServoWiring(servo_id, model, reverse, firmware=firmware, eeprom=eeprom)

    xm, xl = "XM430-W350", "XL430-W250"
    joints = (
        JointWiring("waist", (servo(1, xm),)),
        JointWiring("shoulder", (servo(2, xm), servo(3, xm, reverse=True, secondary_id=2)), start_rad=0.2),
        JointWiring("elbow", (servo(4, xm, reverse=True),), start_rad=-0.1),
        JointWiring("wrist_angle", (servo(5, xm, reverse=True),)),
        JointWiring("wrist_rotate", (servo(6, xl),)),
        JointWiring("gripper", (servo(7, xl),)),
    )
    return ArmWiring("left", joints, baud)


def main(options: dict[str, Any]) -> None:
    """Serve until standard input closes."""
    timing = BusTiming() if options.get("timing") else None
    arm = EmulatedArm(like_wx200(options.get("baud", 1_000_000), options.get("firmware", 46)), timing=timing)
    folder = Path(options["folder"])
    serve(
        EmulatedCell([arm], None),
        ServeOptions(ports={"left": folder / "arm-left"}, control_socket=folder / "control"),
        standard_input_closed,
    )


@contextlib.contextmanager
def emulator(folder: Path, **options: Any) -> Iterator[Path]:
    """Start the process; yield the path of its port."""
    arguments = [
        sys.executable,
        "-m",
        "tests.support.servos.wire_emulator",
        json.dumps({"folder": str(folder)} | options),
    ]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE) as process:
        try:
            port = folder / "arm-left"
            deadline = time.monotonic() + START_S
            while not (port.exists() and (folder / "control").exists()):
                assert process.poll() is None, "the emulator ended by itself"
                assert time.monotonic() < deadline, "the emulator did not start"
                time.sleep(0.01)
            yield port
        finally:
            assert process.stdin is not None
            process.stdin.close()
            assert process.wait(START_S) == 0
    assert not port.is_symlink()
    assert not (folder / "control").exists()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
