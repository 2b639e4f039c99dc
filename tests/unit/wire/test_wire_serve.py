"""Where the emulator is served: what it puts into the file system."""

from __future__ import annotations

import stat
import time
from pathlib import Path

from sim_backend.wire.serve import ServeOptions, Server
from tests.support.servos.dxl_rig import XM
from tests.support.servos.tool_rig import fresh, servo_rig


def test_the_control_socket_is_for_this_user_only_and_gone_afterwards(tmp_path: Path) -> None:
    control = tmp_path / "control"
    options = ServeOptions({"left": tmp_path / "port"}, control_socket=control)
    with Server(servo_rig(fresh(XM, 1)).cell, options, time.monotonic_ns):
        assert stat.S_IMODE(control.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == []
