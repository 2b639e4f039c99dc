"""What may stand under `[hil]` of a cell file: which real arms rehearse with simulated partners and object, and how.

Without the table nothing is coupled.  sim_backend/hil/coupling.py has the formulae.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field, model_validator

from agent.config.schema.types import Name, Strict, wrong
from drivers.rehearsal import STIFFEST, frequency, loop_delay_s


class Hil(Strict):
    """Arms in the loop: driven through the real driver, holding nothing; the others and the object are simulated."""

    arms: Annotated[list[Name], Field(min_length=1, max_length=8)]
    """Arms in the loop."""
    tau_share: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Largest addition of the coupling to a torque, of the torque bound."""
    damping_ratio: Annotated[float, Field(ge=0.1, le=2.0)] = 0.7
    """Of the coupling of an arm and its twin."""
    frequency_rad_per_s: Annotated[float, Field(ge=1.0, le=200.0)] | None = None
    """Of that coupling; none: as its delay allows."""
    extra_cycles: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Delay between real arm and plant beside the usual one and a half cycles."""
    ramp_s: Annotated[float, Field(ge=0.05, le=10.0)] = 0.2
    """Time in which the coupling begins and ends."""
    apart_max_rad: Annotated[float, Field(gt=0.0, le=1.0)] = 0.3
    """Difference of a joint and its twin at which the rehearsal ends."""
    touch_max_N: Annotated[float, Field(ge=0.0, le=20.0)] = 7.5
    """Largest force of somebody who touches an arm with which the rehearsal goes on; 0: with none."""
    touch_max_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.6
    """Longest touch with which it does."""
    gripper_share_max: Annotated[float, Field(gt=0.0, le=1.0)] = 0.3
    """Part of the object's weight that may be felt before it begins: the gripper must be empty."""

    def delay_s(self, rate_hz: float) -> float:
        """Around real arm and twin."""
        return loop_delay_s(1.0 / rate_hz, self.extra_cycles)

    def frequency(self, rate_hz: float) -> float:
        """w of the coupling, rad/s."""
        return self.frequency_rad_per_s or frequency(self.delay_s(rate_hz))

    @model_validator(mode="after")
    def _different(self) -> Hil:
        if len(set(self.arms)) != len(self.arms):
            raise wrong("arms", found=", ".join(self.arms), expected="different arms", remedy="name each arm once")
        return self

    def require_fit(self, arms: Sequence[str], rate_hz: float, *, simulated: bool) -> None:
        """Refuse arms that are not there, a coupling that its delay makes unstable, and a cell of real arms alone.

        simulated: the cell's driver.  Raises PydanticCustomError.
        """
        if not simulated:
            raise wrong(
                "hil", found='[hil] with driver = "dynamixel"', expected='driver = "sim"',
                remedy="a rehearsal simulates the object; remove [hil] for the real carry",
            )  # fmt: skip
        for name in self.arms:
            if name not in arms:
                raise wrong("hil.arms", found=name, expected=" or ".join(arms), remedy="name arms of the cell")
        stiff = self.frequency(rate_hz) * self.delay_s(rate_hz)
        if stiff > STIFFEST:
            raise wrong(
                "hil.frequency_rad_per_s",
                found=f"{self.frequency(rate_hz):g} rad/s, {self.delay_s(rate_hz) * 1e3:.3g} ms of delay: {stiff:.2f}",
                expected=f"a product ≤ {STIFFEST:g}, beyond which arm and twin swing against each other",
                remedy="leave the key out, which takes what the delay allows",
            )
