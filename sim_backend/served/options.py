"""How a plant is served, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

from sim_backend.physics.spec import PlantError


class LostArm(Enum):
    """What the plant does when an arm's process vanishes."""

    END_RUN = auto()
    GO_LIMP = auto()  # as after the bus watchdog of a real arm: torque off, time goes on, it may connect again


class ArmVanished(PlantError):
    """An arm's process has gone without saying so; the run is over."""

    exit_code = 5

    def __init__(self, arm: str, tick: int, reason: str) -> None:
        self.arm = arm
        self.tick = tick
        super().__init__(
            f"arm {arm} vanished at tick {tick}",
            found=reason,
            expected="a torque every tick, and a word at the end",
            remedy=f"see the end of the log of arm {arm}",
        )


@dataclass(frozen=True)
class ServerOptions:
    """How the plant is served."""

    socket_path: Path
    rate_hz: float
    config_id: int  # 32 bit; every agent must present the same
    lockstep: bool = True
    utc_offset_ns: int = 0  # UTC minus the plant's clock, told to every agent: all stamps of the cell have one origin
    ticks: int | None = None  # end after so many; None: when every arm has said BYE
    observe_every: int = 1  # ticks between two calls of on_tick
    pause: Callable[[int], None] = lambda _: None  # told the stamp of such a tick before its time passes; may wait
    lost_arm: LostArm = LostArm.END_RUN
    supported_start: bool = True  # the cell rests on a support until the first torques have come through the delay
    stop: Callable[[], bool] = lambda: False  # asked every tick, and ten times a second while nothing happens


@dataclass(frozen=True)
class Summary:
    """What `serve` did."""

    ticks: int
    sim_s: float
    wall_s: float  # from the first tick to the end
    late_ticks: int  # real time only: begun more than a period after their instant
    dropped_states: int  # real time only: an agent did not fetch its states
    lost_arms: tuple[str, ...]

    @property
    def real_time_factor(self) -> float:
        """Simulated over wall time."""
        return self.sim_s / self.wall_s if self.wall_s > 0 else 0.0
