"""What the servos of an arm say of themselves about once a second, as a JSON text and back.

    {"utc_ns": …, "servo_id": [1, …], "joint": ["waist", …], "temperature_C": […], "voltage_V": […],
     "error_bits": […], "current_A": […], "load": […],
     "temperature_limit_C": […], "voltage_min_V": […], "voltage_max_V": […], "stall_current_A": […]}

One number per servo; null where it is not known, or where the servo senses no such thing.  The last four are the
servo's own limits, which texts of older logs lack.  An arm whose gripper can be closed on an object adds

    "grip": [width_m, width_cmd_m, force_N, force_max_N]
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from agent.telemetry.row.event import TEXT_MAX_BYTES, check_time
from drivers.interface import GripState, ServoHealth

QUANTITIES: Final = {"temperature_C": 1, "voltage_V": 2, "current_A": 3, "load": 3}  # decimals that are worth telling
LIMITS: Final = {"temperature_limit_C": 1, "voltage_min_V": 1, "voltage_max_V": 1, "stall_current_A": 2}
SERVOS_MAX: Final = 64
GRIP: Final = {"grip_width_m": 4, "grip_width_cmd_m": 4, "grip_force_N": 1, "grip_force_max_N": 1}


@dataclass(frozen=True, slots=True)
class Health:
    """One text; all tuples have one entry per servo, in the order of the bus; NaN where there is no number."""

    utc_ns: int
    servo_id: tuple[int, ...]
    joint: tuple[str, ...]
    temperature_C: tuple[float, ...]
    voltage_V: tuple[float, ...]
    error_bits: tuple[int, ...]  # Hardware Error Status
    current_A: tuple[float, ...]
    load: tuple[float, ...]  # share of the largest torque, of servos that sense no current
    temperature_limit_C: tuple[float, ...]  # at which the servo switches itself off
    voltage_min_V: tuple[float, ...]
    voltage_max_V: tuple[float, ...]
    stall_current_A: tuple[float, ...]
    # of the gripper: between its fingers as measured and as told, of each finger as its effort and the bound of it say
    grip_width_m: float = math.nan
    grip_width_cmd_m: float = math.nan
    grip_force_N: float = math.nan
    grip_force_max_N: float = math.nan

    @classmethod
    def from_json(cls, payload: bytes) -> Health:
        """The values of a text, which may come from anywhere.  Raises ValueError when it has none."""
        if len(payload) > TEXT_MAX_BYTES:
            raise ValueError(f"{len(payload)} bytes")
        try:
            raw = json.loads(payload)
            ids = tuple(_whole(x, 255) for x in raw["servo_id"])
            joints = tuple(_name(x) for x in raw["joint"])
            bits = tuple(_whole(x, 255) for x in raw["error_bits"])
            numbers: dict[str, Any] = {name: tuple(_number(x) for x in raw[name]) for name in QUANTITIES}
            unknown = [None] * len(ids)
            numbers |= {name: tuple(_number(x) for x in raw.get(name, unknown)) for name in LIMITS}
            width, width_cmd, force, force_max = (_number(x) for x in raw.get("grip", [None] * len(GRIP)))
            utc_ns = check_time(raw["utc_ns"])
        except (KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"not the health of servos: {error!r}") from error
        lengths = {len(column) for column in (ids, joints, bits, *numbers.values())}
        if len(lengths) != 1 or len(set(ids)) != len(ids) or len(ids) > SERVOS_MAX:
            raise ValueError("not one value per servo")
        return cls(
            utc_ns=utc_ns, servo_id=ids, joint=joints, error_bits=bits, **numbers,
            grip_width_m=width, grip_width_cmd_m=width_cmd, grip_force_N=force, grip_force_max_N=force_max,
        )  # fmt: skip


def grip_values(grip: GripState | None) -> Mapping[str, Any]:
    """What is written of a gripper; nothing where there is none that says anything."""
    if grip is None:
        return {}
    found = (grip.width_m, grip.width_cmd_m, grip.force_N, grip.force_max_N)
    return {"grip": [round(x, places) for x, places in zip(found, GRIP.values(), strict=True)]}


def health_values(health: ServoHealth) -> Mapping[str, Any]:
    """What is written of it, but for the time."""
    rounded = {name: getattr(health, name).round(places).tolist() for name, places in (QUANTITIES | LIMITS).items()}
    bits = health.error_bits.tolist()
    return {"servo_id": health.servo_ids, "joint": health.joints, "error_bits": bits, **rounded}


def _whole(found: object, largest: int) -> int:
    if type(found) is not int or not 0 <= found <= largest:
        raise ValueError(f"{found!r} is no whole number up to {largest}")
    return found


def _name(found: object) -> str:
    if not isinstance(found, str):
        raise ValueError(f"{found!r} is no name")
    return found


def _number(found: object) -> float:
    if found is None:
        return math.nan
    if type(found) not in (int, float) or not math.isfinite(found):  # type: ignore[arg-type]
        raise ValueError(f"{found!r} is no number")
    return float(found)  # type: ignore[arg-type]
