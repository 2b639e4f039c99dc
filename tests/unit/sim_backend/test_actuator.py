"""What a servo adds: each effect alone, and switched off."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dynamixel.servo.counts import TICK_RAD, VELOCITY_UNIT_RAD_PER_S
from drivers.interface import DriverError
from sim_backend.physics.actuator import (
    ActuatorError,
    ActuatorSpec,
    Grid,
    Servos,
    TorqueCommand,
    TorqueCommandError,
)

torques = st.floats(-20, 20)
speeds = st.floats(-20, 20)


def row(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float64)


@given(st.lists(torques, min_size=3, max_size=3))
def test_ideal_servos_give_exactly_what_is_commanded(tau: list[float]) -> None:
    spec = ActuatorSpec.of(3)
    sent = TorqueCommand.of(spec)(np.array(tau))
    servos = Servos([spec])
    servos.command(sent)
    assert sent.tolist() == tau
    assert servos.motor_torque(row(1, -2, 3)).tolist() == tau
    assert servos.reported(row(*tau), row(*tau), sent).tolist() == [tau, tau, tau]


@given(torques, st.floats(0.001, 0.5), st.floats(0.5, 5))
def test_command_is_on_the_grid_within_the_limit_and_nearest(tau: float, lsb: float, limit: float) -> None:
    spec = ActuatorSpec.of(1, torque_lsb_Nm=lsb, tau_max_Nm=limit)
    sent = TorqueCommand.of(spec)(row(tau))[0]
    steps = sent / lsb
    assert abs(steps - round(steps)) < 1e-9
    assert abs(sent) <= limit + 1e-12
    assert abs(sent - np.clip(tau, -limit, limit)) <= lsb + 1e-12
    if abs(tau) < limit - lsb:
        assert abs(sent - tau) <= lsb / 2 + 1e-12


@given(torques)
def test_what_was_sent_is_sent_again_unchanged(tau: float) -> None:
    command = TorqueCommand.of(ActuatorSpec.of(1, torque_lsb_Nm=0.00394, tau_max_Nm=3.0))
    once = command(row(tau))
    assert command(once).tolist() == once.tolist()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", [0, 2])
def test_torque_that_is_not_finite_never_passes(bad: float, joint: int) -> None:
    tau = np.zeros(3)
    tau[joint] = bad
    with pytest.raises(TorqueCommandError, match="finite numbers"):
        TorqueCommand.of(ActuatorSpec.of(3, tau_max_Nm=1.0))(tau)


def test_opposite_infinities_do_not_hide_each_other() -> None:
    with pytest.raises(DriverError, match="finite numbers"):
        TorqueCommand.of(ActuatorSpec.of(2))(row(math.inf, -math.inf))


def test_torque_for_another_number_of_joints_is_refused() -> None:
    with pytest.raises(TorqueCommandError, match="3 finite numbers"):
        TorqueCommand.of(ActuatorSpec.of(3))(np.zeros(2))


@given(torques, speeds, st.floats(0.5, 8), st.floats(1, 8))
def test_motor_stays_below_its_speed_torque_line(tau: float, dq: float, stall: float, no_load: float) -> None:
    servos = Servos([ActuatorSpec.of(1, stall_Nm=stall, no_load_rad_s=no_load)])
    servos.command(row(tau))
    given_torque = servos.motor_torque(row(dq))[0]
    line = max(0.0, stall * (1 - math.copysign(1, tau) * dq / no_load))
    assert given_torque == pytest.approx(math.copysign(min(abs(tau), line), tau), abs=1e-12)


def test_stall_torque_without_a_no_load_speed_is_a_plain_limit() -> None:
    servos = Servos([ActuatorSpec.of(1, stall_Nm=2.0)])
    servos.command(row(-5.0))
    assert servos.motor_torque(row(-100.0))[0] == -2.0


def test_torque_constant_error_scales_the_torque_but_not_what_current_tells() -> None:
    servos = Servos([ActuatorSpec.of(1, torque_scale=0.9)])
    servos.command(row(1.0))
    applied = servos.motor_torque(row(0.0)).copy()
    assert applied[0] == pytest.approx(0.9)
    assert servos.reported(row(0.0), row(0.0), applied)[2, 0] == pytest.approx(1.0)


@given(speeds, st.floats(0, 1), st.floats(0, 1), st.floats(1e-4, 1))
def test_friction_opposes_motion_and_is_bounded(dq: float, coulomb: float, viscous: float, scale: float) -> None:
    spec = ActuatorSpec.of(1, coulomb_Nm=coulomb, viscous_Nms_rad=viscous, coulomb_speed_rad_s=scale)
    coefficient = Servos([spec]).friction_coefficient(row(dq))[0]
    assert coefficient >= 0
    assert coefficient * abs(dq) <= coulomb + viscous * abs(dq) + 1e-12


def test_friction_far_from_rest_is_coulomb_plus_viscous() -> None:
    servos = Servos([ActuatorSpec.of(1, coulomb_Nm=0.0843, viscous_Nms_rad=0.0347, coulomb_speed_rad_s=0.01)])
    assert servos.friction_coefficient(row(2.0))[0] * 2.0 == pytest.approx(0.0843 + 0.0347 * 2.0, rel=1e-5)


@given(st.floats(-10, 10))
def test_reported_motion_is_on_the_servos_grid(value: float) -> None:
    spec = ActuatorSpec.of(1, position_lsb_rad=TICK_RAD, velocity_lsb_rad_s=VELOCITY_UNIT_RAD_PER_S)
    servos = Servos([spec])
    said = servos.reported(row(value), row(value), row(value))[:, 0]
    assert abs(said[2] - value) < 2.0**-899  # which has no resolution
    for reported, lsb in zip(said[:2], (TICK_RAD, VELOCITY_UNIT_RAD_PER_S), strict=True):
        assert abs(reported - value) <= lsb / 2 + 1e-12
        assert abs(reported / lsb - round(reported / lsb)) < 1e-6


def test_grid_of_one_joint_leaves_the_others_exact() -> None:
    assert Grid(row(0.5, 0.0))(row(0.3, 0.3)).tolist() == [0.5, 0.3]


def test_what_has_no_resolution_beside_what_has_is_exact_as_far_as_is_said() -> None:
    """To 2⁻⁶⁰ beside a joint that has one, to 2⁻⁹⁰⁰ in a row without any."""
    lsb, fine = np.array([[0.5, 0.0], [0.0, 0.0]]), 2.0**-60
    values = np.array([[0.3, 1.6 * fine], [1.75 * 2.0**-600, -(2.0**-900)]])
    assert Grid(lsb)(values).tolist() == [[0.5, 2.0 * fine], values[1].tolist()]


@pytest.mark.parametrize("name", ["position_lsb_rad", "velocity_lsb_rad_s", "torque_lsb_Nm"])
def test_a_value_lies_on_every_step_of_its_own_grid_and_on_no_other(name: str) -> None:
    steps = np.arange(-3, 4)
    servos = Servos([ActuatorSpec.of(7, **{name: 0.25})])
    said = servos.reported(0.25 * steps + 0.1, 0.25 * steps + 0.1, 0.25 * steps + 0.1)
    at = ("position_lsb_rad", "velocity_lsb_rad_s", "torque_lsb_Nm").index(name)
    for i, row_of in enumerate(said):
        assert row_of.tolist() == (0.25 * steps + (0.0 if i == at else 0.1)).tolist()


def test_arms_side_by_side_keep_their_own_servos() -> None:
    strong, weak = ActuatorSpec.of(2), ActuatorSpec.of(1, stall_Nm=0.1)
    servos = Servos([strong, weak])
    servos.command(row(3.0, -3.0, 3.0))
    assert servos.motor_torque(np.zeros(3)).tolist() == [3.0, -3.0, 0.1]


def test_seized_gear_changes_only_its_joints() -> None:
    servos = Servos([ActuatorSpec.of(2), ActuatorSpec.of(1)])
    assert not servos.has_friction
    servos.set_viscous(slice(2, 3), 50.0)
    assert servos.has_friction
    assert servos.friction_coefficient(np.zeros(3)).tolist() == [0.0, 0.0, 50.0]


@pytest.mark.parametrize(("coulomb", "viscous"), [(0.1, 0.0), (0.0, 0.1), (0.1, 0.1), (0.0, 0.0)])
def test_either_friction_is_friction_and_a_gear_that_turns_freely_again_keeps_the_other(
    coulomb: float, viscous: float
) -> None:
    servos = Servos([ActuatorSpec.of(1, coulomb_Nm=coulomb, viscous_Nms_rad=viscous)])
    assert servos.has_friction is (coulomb + viscous > 0.0)
    servos.set_viscous(slice(0, 1), 0.0)
    assert servos.has_friction is (coulomb > 0.0)


def test_a_scale_of_the_coulomb_torque_is_the_speed_at_which_71_percent_of_it_are_there() -> None:
    servos = Servos([ActuatorSpec.of(1, coulomb_Nm=1.0)])
    assert servos.friction_coefficient(row(0.01))[0] * 0.01 == pytest.approx(math.sqrt(0.5))


def test_every_default_switches_its_effect_off() -> None:
    spec = ActuatorSpec.of(2)
    assert (spec.delay_s, spec.delay_jitter_s, spec.position_lsb_rad, spec.velocity_lsb_rad_s) == (0, 0, 0, 0)
    for none in (spec.coulomb_Nm, spec.viscous_Nms_rad, spec.torque_lsb_Nm, spec.zero_error_rad, spec.backlash_rad):
        assert none.tolist() == [0.0, 0.0]
    for endless in (spec.tau_max_Nm, spec.stall_Nm, spec.no_load_rad_s):
        assert endless.tolist() == [math.inf, math.inf]
    assert spec.torque_scale.tolist() == [1.0, 1.0]


def test_without_an_arm_there_are_no_servos_and_they_say_nothing() -> None:
    servos, none = Servos([]), np.zeros(0)
    servos.command(none)
    assert servos.motor_torque(none).shape == (0,)
    assert servos.reported(none, none, none).shape == (3, 0)


def test_an_encoder_s_zero_may_be_off_to_either_side() -> None:
    servos = Servos([ActuatorSpec.of(2, zero_error_rad=[-0.25, 0.5])])
    assert servos.reported(row(1.0, 1.0), row(0.0, 0.0), row(0.0, 0.0))[0].tolist() == [0.75, 1.5]


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"coulomb_Nm": -0.1}, "coulomb_Nm.*no negative"),
        ({"viscous_Nms_rad": [0.1, math.nan, 0.1]}, "viscous_Nms_rad.*no negative"),
        ({"coulomb_speed_rad_s": 0.0}, "coulomb_speed_rad_s.*positive"),
        ({"torque_scale": 0.0}, "torque_scale.*positive"),
        ({"no_load_rad_s": 6.0}, "stall_Nm.*finite stall torque"),
        ({"delay_s": -1e-3}, "delay_s.*no negative"),
        ({"delay_s": math.inf}, "delay_s.*a finite time"),
        ({"delay_s": 1e-3, "delay_jitter_s": 2e-3}, "delay_jitter_s.*at most the delay"),
        ({"backlash_rad": math.inf}, "backlash_rad.*finite angles"),
        ({"zero_error_rad": math.inf}, "zero_error_rad.*finite angles"),
    ],
)
def test_impossible_servo_is_refused(effects: dict[str, float], message: str) -> None:
    with pytest.raises(ActuatorError, match=message) as refused:
        ActuatorSpec.of(3, **effects)
    assert refused.value.exit_code == 4


def test_description_cannot_be_changed_afterwards() -> None:
    spec = ActuatorSpec.of(2, coulomb_Nm=0.1)
    with pytest.raises(ValueError, match="read-only"):
        spec.coulomb_Nm[0] = 0.0
    own = row(0.2, 0.3)
    changed = replace(spec, coulomb_Nm=own)
    own[0] = 5.0  # its owner's, as before
    assert changed.coulomb_Nm.tolist() == [0.2, 0.3]
