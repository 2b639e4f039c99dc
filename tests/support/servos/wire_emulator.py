"""An emulated arm in a process of its own, for tests."""

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
from sim_backend.wire.wiring import ArmWiring, JointWiring, ServoWiring, servo_eeprom
from tests.support.forked import serving

START_S = 30.0


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


def serve_arm(folder: Path, options: dict[str, Any], stop: Callable[[], bool]) -> None:
    """Serve until `stop` says so."""
    timing = BusTiming() if options.get("timing") else None
    arm = EmulatedArm(like_wx200(options.get("baud", 1_000_000), options.get("firmware", 46)), timing=timing)
    serve(
        EmulatedCell([arm], None),
        ServeOptions(ports={"left": folder / "arm-left"}, control_socket=folder / "control"),
        stop,
    )


@contextlib.contextmanager
def emulator(folder: Path, **options: Any) -> Iterator[Path]:
    """Start the process; yield the path of its port."""
    with serving(serve_arm, folder, options) as process:
        port = folder / "arm-left"
        deadline = time.monotonic() + START_S
        while not (port.exists() and (folder / "control").exists()):
            assert process.is_alive(), "the emulator ended by itself"
            assert time.monotonic() < deadline, "the emulator did not start"
            time.sleep(0.01)
        yield port
    assert not port.is_symlink()
    assert not (folder / "control").exists()
