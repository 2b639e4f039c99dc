"""Whatever a gripper's figures say: they are refused, or its fingers go apart over the whole stroke."""

from __future__ import annotations

import itertools
import math
import tomllib
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

import configs
from agent.config.schema.arm import LAST_TICK, ArmFile
from agent.config.servo_map import fingers_of

ARM = tomllib.loads((configs.ARMS_DIR / "wx200.toml").read_text())
STEPS = 16  # over a stroke

ticks = st.integers(0, LAST_TICK)
lengths = st.one_of(st.sampled_from([0.014, 0.024, 1e-9, 1e-300, 10.0]), st.floats(1e-3, 0.1))
grippers = st.fixed_dictionaries(
    {}, optional={"zero_tick": ticks, "closed_tick": ticks, "open_tick": ticks, "horn_radius_m": lengths}
)
rods = st.one_of(lengths, st.sampled_from([math.nextafter(1.0, 2.0), 1.0, 0.5, 1.01, 1.5]))  # or a share of the radius


@given(changed=grippers, rod=rods, share=st.booleans())
def test_fingers_that_are_accepted_go_apart_over_the_whole_stroke(
    changed: dict[str, Any], rod: float, share: bool
) -> None:
    gripper = ARM["gripper"] | changed
    gripper["rod_length_m"] = gripper["horn_radius_m"] * rod if share else rod
    try:
        fingers = fingers_of(ArmFile.model_validate(ARM | {"gripper": gripper}))
    except ValidationError:
        return
    assert fingers is not None
    stroke = fingers.open_rad - fingers.closed_rad
    angles = [fingers.closed_rad + stroke * k / STEPS for k in range(STEPS + 1)]
    widths = [fingers.width(angle) for angle in angles]
    assert all(a < b for a, b in itertools.pairwise(widths))
    assert all(fingers.lever(angle) * stroke > 0.0 for angle in angles)
    for angle, width in zip(angles, widths, strict=True):
        assert math.isclose(fingers.width(fingers.angle(width)), width, rel_tol=1e-6), angle
