"""A rate that a servo bus cannot carry is refused before anything is opened, with the highest one that it can."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

import configs
from agent.config.cell import Cell, ConfigError, cell_from_toml, load_cell
from agent.config.servo_map import arm_map
from agent.verify.bus import bus_rates
from agent.verify.check import Verdict, examine
from drivers.dynamixel.budget import round_of
from drivers.dynamixel.errors import DriverError
from drivers.dynamixel.pace import PaceError, check_rate
from tests.support.starts import start_joints

WX200 = configs.CELLS_DIR / "two_wx200.toml"
WHAT = "rate on the servo bus"
ASKED = "all servos asked for their state"


def highest(cell: Cell) -> float:
    return min(bus.rate_max_hz for bus in bus_rates(cell, start_joints(cell)))


def test_the_highest_rate_that_fits_is_accepted_and_the_next_is_refused_naming_it() -> None:
    rate_hz = highest(load_cell(WX200))
    fits = examine(load_cell(WX200, [f"rate_hz={rate_hz}"]), wired=True)
    fits.require()
    assert [f.where for f in fits.findings if f.what == "what tells arms apart"] == ["left, right"]
    with pytest.raises(ConfigError, match=re.escape(f"found {rate_hz + 1:g} Hz, expected ≤ {rate_hz:g} Hz (7 servos")):
        examine(load_cell(WX200, [f"rate_hz={rate_hz + 1}"]), wired=True).require()


def test_the_check_refuses_exactly_what_the_driver_would_refuse() -> None:
    for path in sorted(configs.CELLS_DIR.glob("*.toml")):
        cell = load_cell(path)
        q_start = start_joints(cell)
        for bus, arm, q in zip(bus_rates(cell, q_start), cell.arms, q_start, strict=True):
            for rate_hz, refused in ((bus.rate_max_hz, False), (bus.rate_max_hz + 1.0, True)):
                servos = arm_map(load_cell(path, [f"rate_hz={rate_hz}"]), arm, "port", q)
                error: DriverError | None = None
                try:
                    check_rate(servos, fast=bus.fast)
                except PaceError as found:
                    error = found
                assert (error is not None) == refused, (path.name, arm.name, rate_hz)


def test_a_delay_that_no_bus_has_is_refused_for_servos_and_warned_of_in_simulation() -> None:
    delay_s = max(bus.delay_s for bus in bus_rates(load_cell(WX200), start_joints(load_cell(WX200))))
    assert 0.002 < delay_s < 0.005
    for share, driver, verdict in (
        (0.91, "dynamixel", Verdict.OK),
        (0.89, "dynamixel", Verdict.REFUSED),
        (0.89, "sim", Verdict.WARNING),
    ):
        cell = load_cell(WX200, [f"loop_delay_s={share * delay_s}", f'driver="{driver}"'])
        found = [f for f in examine(cell, wired=True, thorough=False).findings if f.what == "loop_delay_s"]
        assert [f.verdict for f in found] == [verdict] * 2


@pytest.mark.parametrize(("rate_hz", "verdict"), [(60.0, Verdict.WARNING), (79.0, Verdict.WARNING), (80.0, Verdict.OK)])
def test_a_rate_at_which_servos_are_asked_too_seldom_is_warned_of_with_a_remedy_where_servos_move_the_arms(
    rate_hz: float, verdict: Verdict
) -> None:
    cell = load_cell(WX200, [f"rate_hz={rate_hz}"])
    of = [f for f in examine(cell, wired=True, thorough=False).findings if f.what == ASKED]
    assert [f.verdict for f in of] == [verdict] * 2
    assert of[0].found == f"within {4e3 / rate_hz:.0f} ms"
    assert of[0].remedy == ("raise rate_hz to 80 or more" if verdict is Verdict.WARNING else "")
    assert ASKED not in {f.what for f in examine(cell).findings}, "in simulation nobody asks"


def test_servos_that_find_no_room_beside_the_read_want_a_lower_rate_or_a_faster_bus() -> None:
    arm = load_cell(WX200).arms[0]
    for rate_hz, baud, quick in ((130.0, 200_000, False), (130.0, 1_000_000, True)):
        servos = replace(arm_map(load_cell(WX200), arm, "port", np.zeros(3)), rate_hz=rate_hz, baud=baud)
        found = round_of(servos, fast=False)
        assert found.quick == quick, found
        assert found.remedy.startswith("lower rate_hz, or raise")


def test_a_faster_bus_carries_a_higher_rate() -> None:
    faster = load_cell(WX200, [f"arms.{arm}.dynamixel.baud=3000000" for arm in ("left", "right")])
    assert highest(faster) > 1.3 * highest(load_cell(WX200))


def test_a_simulated_run_is_warned_and_goes_on() -> None:
    rate_hz = highest(load_cell(WX200)) + 1
    report = examine(load_cell(WX200, [f"rate_hz={rate_hz}"]))
    assert {f.verdict for f in report.findings if f.what == WHAT} == {Verdict.WARNING}
    assert not [f for f in report.findings if f.what == "what tells arms apart"], "no servos, no cables"
    report.require()


def test_arms_without_a_port_have_no_bus_to_check() -> None:
    document = tomllib.loads(WX200.read_text())
    document["rate_hz"] = 2000.0
    for arm in document["arms"]:
        del arm["dynamixel"]
    cell = cell_from_toml(tomli_w.dumps(document).encode(), "portless.toml")
    assert [f for f in examine(cell, wired=True).findings if f.what == WHAT] == []


def test_a_servo_map_that_contradicts_itself_is_refused_with_its_reason() -> None:
    cell = load_cell(WX200)
    arm = cell.arms[0]
    first = arm.file.joints[0]
    clash = arm.file.model_copy(update={"joints": [first, first.model_copy(), *arm.file.joints[1:]]})
    broken = replace(cell, arms=(replace(arm, file=clash), *cell.arms[1:]))
    with pytest.raises(ConfigError, match=r"servo IDs: found .* give every servo its own ID"):
        bus_rates(broken, start_joints(cell))
