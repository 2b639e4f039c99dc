"""A plant served by a thread of the test process, stopped and joined on the way out."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from drivers.interface import DriverError, Refusal
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.plant import Plant
from sim_backend.physics.spec import PlantSpec
from sim_backend.served.driver import SimDriver
from sim_backend.served.options import ServerOptions, Summary
from sim_backend.served.server import OnTick, serve
from tests.support.plant.plant_cells import PLANAR_JOINTS, planar_cell

CONFIG_ID = 0xC0FFEE42
TAU = np.array([0.3, -0.2, 0.1])
SERVOS = ActuatorSpec.of(
    3,
    delay_s=0.005,
    tau_max_Nm=3.0,
    torque_lsb_Nm=0.004,
    stall_Nm=6.0,
    no_load_rad_s=6.6,
    coulomb_Nm=0.0843,
    viscous_Nms_rad=0.0347,
    position_lsb_rad=0.0015,
    velocity_lsb_rad_s=0.024,
)


class ServedPlant:
    """Context: `driver(arm)` makes drivers for it; `summary` or `error` say how the serving ended."""

    def __init__(
        self,
        directory: Path,
        *,
        names: Sequence[str] = ("left", "right"),
        servos: ActuatorSpec = SERVOS,
        spec: PlantSpec | None = None,
        on_tick: OnTick | None = None,
        **options: Any,
    ) -> None:
        self.path = directory / "plant.sock"
        self.spec = spec or planar_cell(servos, names=names)
        self.plant = Plant(self.spec)
        self.summary: Summary | None = None
        self.error: Refusal | None = None
        self._stop = threading.Event()
        self._listening = threading.Event()
        self._on_tick = on_tick
        base = ServerOptions(self.path, rate_hz=200.0, config_id=CONFIG_ID, stop=self._stop.is_set)
        self._options = replace(base, **options)
        self._thread = threading.Thread(target=self._serve)
        self._drivers: list[SimDriver] = []

    def driver(self, arm: str = "left", **settings: Any) -> SimDriver:
        """A driver that is closed on the way out; `settings` override those of the cell."""
        known = {
            "joints": PLANAR_JOINTS,
            "config_id": CONFIG_ID,
            "start_timeout_s": 10.0,
            "read_timeout_s": 10.0,
        } | settings
        driver = SimDriver(self.path, arm, **known)
        self._drivers.append(driver)
        return driver

    def enabled(self) -> list[SimDriver]:
        """One enabled driver per arm."""
        drivers = [self.driver(name) for name in self.spec.names]
        for d in drivers:
            d.connect()
        for d in drivers:
            d.enable()
        return drivers

    def stop(self) -> None:
        """Ask the plant to end and wait for it."""
        self._stop.set()
        self.join()

    def join(self) -> None:
        """Wait for the plant's own end."""
        self._thread.join(10.0)
        assert not self._thread.is_alive(), "the plant does not end"

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._listening.wait(10.0)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._stop.set()
        for d in self._drivers:
            d.close()
        self.join()

    def _serve(self) -> None:
        try:
            self.summary = serve(self.plant, self._options, self._on_tick, self._listening.set)
        except Refusal as e:
            self.error = e
        finally:
            self._listening.set()


def cycle(drivers: list[SimDriver], count: int = 1) -> list[bytes]:
    """Run lockstep cycles with torques that depend on the state; every state as bytes."""
    seen = []
    for _ in range(count):
        states = [d.read() for d in drivers]
        for d, s in zip(drivers, states, strict=True):
            seen.append(s.q.tobytes() + s.dq.tobytes() + s.tau.tobytes())
            d.write(TAU - 0.5 * s.q - 0.05 * s.dq)
    return seen


@contextlib.contextmanager
def cycling(driver: SimDriver) -> Iterator[None]:
    """The driver runs its cycles in the background; in lockstep two arms cannot share a thread unless in step."""
    stop = threading.Event()

    def run() -> None:
        with contextlib.suppress(DriverError):
            while not stop.is_set():
                cycle([driver])

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        driver.disable()  # or it would wait for arms that have stopped
        thread.join(10.0)
        assert not thread.is_alive()
