"""The page on monitors names every monitor, every key and every default that the code has."""

from __future__ import annotations

import re

from agent.config import monitors as derived
from agent.config.schema.cell import Safety
from agent.config.schema.monitors import MonitorsSpec
from agent.monitors import body, gravity, joints, servos, watch
from agent.monitors.bounds import Name
from tests.support.documents import ROOT

PAGE = (ROOT / "docs/monitors.md").read_text(encoding="utf-8")
ROWS = {
    cells[0]: cells[1:]
    for line in PAGE.splitlines()
    if len(cells := [c.strip() for c in re.split(r"(?<!\\)\|", line.strip("|"))]) == 4 and cells[0].startswith("`")
}


def test_every_monitor_has_a_row_and_every_row_a_monitor() -> None:
    assert {
        name for name in ROWS if name.strip("`") not in ("paper_real", "two_wx200", "three_wx250s", "four_wx250s")
    } == {f"`{name}`" for name in Name}


def test_every_key_is_named() -> None:
    keys = {key for row in ROWS.values() for key in re.findall(r"`(\w+)`", row[2])}
    assert keys | {"off"} == set(MonitorsSpec.model_fields)


def test_defaults_are_those_of_the_code() -> None:
    spec = MonitorsSpec()
    told = {
        "speed": (spec.speed_share, derived.FASTEST), "power": (spec.power_share,),
        "position": (spec.position_margin_rad,), "workspace": (spec.workspace_margin_m,),
        "saturated": (spec.limited_share * body.LIMITED_TICKS, body.LIMITED_TICKS),
        "rate_limited": (spec.limited_share * body.LIMITED_TICKS, body.LIMITED_TICKS),
        "frozen": (spec.frozen_rad,), "load": (spec.load_share,), "temperature": (spec.temperature_margin_C,),
        "voltage": (spec.voltage_margin_V,), "servo_load": (spec.load_share,),
        "start": (1e3 * Safety().start_error_max_m, 1e3 * Safety().start_error_max_rad),
    }  # fmt: skip
    for name, numbers in told.items():
        for number in numbers:
            assert f"{number:g} " in ROWS[f"`{name}`"][1] + " ", name
    assert derived.SPEED_TIMES == 2.0
    assert derived.FRICTION_TIMES == 3.0
    assert joints.FROZEN_S == 0.05
    assert servos.READINGS == 2
    assert (gravity.WINDOW_S, gravity.WINDOWS) == (0.5, 2)
    assert (derived.MARGIN, derived.ADAPTIVE_TIMES) == (1.4, 1.9)
    assert watch.HEALTH_S == 0.25
    assert spec.load_time_s == 30.0
