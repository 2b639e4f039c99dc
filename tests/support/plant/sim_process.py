"""Processes for the simulated cell's tests: `plant SOCKET` and `agent SOCKET ARM CYCLES OUT [READ_TIMEOUT_S]`.

Both print a line when they are ready, and end with a Refusal's exit code and text.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import numpy as np

from drivers.interface import Refusal
from sim_backend.physics.plant import Plant
from sim_backend.served.driver import SimDriver
from sim_backend.served.options import ServerOptions
from sim_backend.served.server import serve
from tests.support.plant.plant_cells import PLANAR_JOINTS, planar_cell
from tests.support.plant.served_plant import CONFIG_ID, SERVOS

LISTENING = "listening"


def run_plant(path: Path) -> None:
    """Serve the paper's cell in lockstep until the arms have left, or SIGTERM."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    options = ServerOptions(path, rate_hz=200.0, config_id=CONFIG_ID, stop=lambda: bool(stopped))
    summary = serve(Plant(planar_cell(SERVOS)), options, on_listening=lambda: _say(LISTENING))
    _say(f"ticks {summary.ticks}")


def run_agent(path: Path, arm: str, cycles: int, out: Path, read_timeout_s: float = 30.0) -> None:
    """Run cycles with a torque that depends on the state; every state goes to `out`."""
    driver = SimDriver(path, arm, PLANAR_JOINTS, CONFIG_ID, read_timeout_s=read_timeout_s)
    driver.connect()
    driver.enable()
    with out.open("wb", buffering=0) as file:
        for _ in range(cycles):
            state = driver.read()
            file.write(np.concatenate([[state.stamp_ns], state.q, state.dq, state.tau]).tobytes())
            driver.write(np.array([0.3, -0.2, 0.1]) - 0.5 * state.q - 0.05 * state.dq)
    driver.disable()
    driver.close()


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        if sys.argv[1] == "plant":
            run_plant(Path(sys.argv[2]))
        else:
            run_agent(Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]), Path(sys.argv[5]), *map(float, sys.argv[6:]))
    except Refusal as refusal:
        sys.stderr.write(str(refusal))
        sys.exit(refusal.exit_code)
