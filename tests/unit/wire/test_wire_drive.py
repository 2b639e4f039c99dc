"""The servo's inner controllers, winding, heat and profiles against closed forms."""

from __future__ import annotations

import itertools
import math

import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.counts import PWM_UNIT_DUTY, TICK_RAD, VELOCITY_UNIT_RAD_PER_S
from drivers.dynamixel.servo.models import SERVOS
from sim_backend.wire.drive import Drive, Goals
from sim_backend.wire.motor import Motor, MotorData
from sim_backend.wire.profile import Profile, ProfileType
from sim_backend.wire.servo import Servo
from sim_backend.wire.world import FreeJoint
from tests.support.servos.wire_bench import Bench, xl430, xm430

XM = SERVOS["XM430-W350"]


def run(servo: Servo, joint: FreeJoint, duration_s: float, dt_s: float = 1e-3) -> None:
    """One servo on one joint."""
    body = servo.firmware.body
    for _ in range(round(duration_s / dt_s)):
        body.horn.position_rad, body.horn.velocity_rad_per_s = joint.q_rad, joint.dq_rad_per_s
        joint.step(body.step(dt_s, alive=True), dt_s)


def started(servo: Servo, mode: OperatingMode, goals: dict[table.Register, int]) -> Bench:
    bench = Bench(servo)
    assert bench.write(1, table.OPERATING_MODE, mode) == 0
    for register, value in goals.items():
        assert bench.write(1, register, value) == 0, register.name
    assert bench.write(1, table.TORQUE_ENABLE, 1) == 0
    return bench


class TestMotor:
    def test_stall_and_no_load_points_of_the_data_sheet(self) -> None:
        motor = Motor(MotorData.of(XM))
        motor.drive_duty(1.0, 12.0, 0.0)
        assert motor.current_A == pytest.approx(2.3)
        assert motor.torque_Nm(0.0) == pytest.approx(4.1)
        motor.drive_duty(1.0, 12.0, XM.no_load_rad_per_s)
        assert motor.torque_Nm(XM.no_load_rad_per_s) == pytest.approx(0.0, abs=1e-9)

    def test_zero_duty_brakes_and_an_open_winding_does_not(self) -> None:
        motor = Motor(MotorData.of(XM))
        motor.drive_duty(0.0, 12.0, 1.0)
        assert motor.torque_Nm(1.0) == pytest.approx(-XM.back_emf_damping_Nm_s_per_rad)
        motor.open()
        assert motor.torque_Nm(1.0) == 0.0

    def test_current_is_what_is_wanted_until_the_voltage_runs_out(self) -> None:
        motor = Motor(MotorData.of(XM))
        motor.drive_current(0.5, 1.0, 12.0, 1.0)
        assert motor.current_A == pytest.approx(0.5)
        assert motor.duty == pytest.approx((0.5 * XM.resistance_ohm + XM.back_emf_V_s_per_rad) / 12.0)
        fast = 0.9 * XM.no_load_rad_per_s
        motor.drive_current(2.0, 1.0, 12.0, fast)
        assert motor.duty == 1.0
        assert motor.current_A == pytest.approx(0.1 * 2.3)

    def test_goal_pwm_caps_the_voltage_of_current_mode(self) -> None:
        motor = Motor(MotorData.of(XM))
        motor.drive_current(2.0, 0.1, 12.0, 0.0)
        assert motor.current_A == pytest.approx(0.23)

    @pytest.mark.parametrize(("goal", "limit", "counts"), [(-100, 885, -100), (100, 885, -100), (800, 200, -200)])
    def test_goal_pwm_caps_it_by_its_amount_and_at_most_by_its_limit(self, goal: int, limit: int, counts: int) -> None:
        drive = Drive(Motor(MotorData.of(XM)), 2.69e-3)
        drive.torque_on = True
        drive.goals = Goals(mode=OperatingMode.CURRENT, current=-1000, current_limit=1193, pwm=goal, pwm_limit=limit)
        drive.step(1e-3, lambda: 0.0, 0.0, 12.0)
        assert drive.motor.duty == pytest.approx(counts * PWM_UNIT_DUTY)

    def test_friction_opposes_motion(self) -> None:
        motor = Motor(MotorData.of(XM, coulomb_Nm=0.2))
        assert motor.torque_Nm(1.0) == pytest.approx(-0.2)
        assert motor.torque_Nm(-1.0) == pytest.approx(0.2)
        assert motor.torque_Nm(0.0) == 0.0

    def test_heat_settles_where_conduction_equals_copper_loss(self) -> None:
        motor = Motor(MotorData.of(XM))
        motor.drive_duty(0.4, 12.0, 0.0)
        for _ in range(100_000):
            motor.heat(0.1)
        loss_W = (0.4 * 2.3) ** 2 * XM.resistance_ohm
        assert motor.temperature_C == pytest.approx(25.0 + 13.0 * loss_W, abs=0.01)


class TestModes:
    def test_current_mode_gives_the_torque_of_the_goal(self) -> None:
        servo = xm430()
        bench = started(servo, OperatingMode.CURRENT, {table.GOAL_CURRENT: -100})
        assert servo.firmware.body.step(1e-3, alive=True) == pytest.approx(-0.269 * 4.1 / 2.3)
        assert bench.read(1, table.PRESENT_CURRENT) == -100

    def test_pwm_mode_obeys_the_back_emf_law(self) -> None:
        servo = xl430()
        model = SERVOS["XL430-W250"]
        bench = started(servo, OperatingMode.PWM, {table.GOAL_PWM: 300})
        horn = servo.firmware.body.horn
        horn.velocity_rad_per_s, horn.supply_V = 0.7, 11.1
        expected = model.stall_torque_Nm_per_V * 300 / 885 * 11.1 - model.back_emf_damping_Nm_s_per_rad * 0.7
        assert servo.firmware.body.step(1e-3, alive=True) == pytest.approx(expected)
        assert bench.read(1, table.PRESENT_PWM) == 300
        assert bench.read(1, table.PRESENT_LOAD) == round(1000 * 300 / 885)
        assert bench.read(1, table.PRESENT_INPUT_VOLTAGE) == 111

    def test_velocity_mode_reaches_its_goal(self) -> None:
        servo, joint = xm430(), FreeJoint(inertia_kg_m2=0.02, viscous_Nm_s_per_rad=0.05)
        started(servo, OperatingMode.VELOCITY, {table.GOAL_VELOCITY: 100})
        run(servo, joint, 3.0)
        assert joint.dq_rad_per_s == pytest.approx(100 * VELOCITY_UNIT_RAD_PER_S, rel=0.02)

    def test_velocity_mode_starts_with_its_proportional_gain(self) -> None:
        servo = xm430()
        bench = started(servo, OperatingMode.VELOCITY, {table.GOAL_VELOCITY: 100, table.VELOCITY_I_GAIN: 0})
        servo.firmware.body.step(1e-3, alive=True)
        assert bench.read(1, table.PRESENT_PWM) == round(100 / 128 * 100)

    @pytest.mark.parametrize("mode", [OperatingMode.POSITION, OperatingMode.EXTENDED_POSITION])
    @pytest.mark.parametrize("make", [xm430, xl430])
    def test_position_mode_reaches_its_goal_and_stays(self, mode: OperatingMode, make: type[Servo]) -> None:
        servo, joint = make(), FreeJoint(inertia_kg_m2=0.02, viscous_Nm_s_per_rad=0.05)
        bench = started(servo, mode, {})
        bench.write(1, table.GOAL_POSITION, 2400)
        run(servo, joint, 2.0)
        assert joint.q_rad == pytest.approx(352 * TICK_RAD, abs=2 * TICK_RAD)
        assert abs(joint.dq_rad_per_s) < 0.02

    def test_position_mode_gives_way_to_load_by_its_gain(self) -> None:
        servo, joint = xm430(), FreeJoint(inertia_kg_m2=0.02, viscous_Nm_s_per_rad=0.5)
        started(servo, OperatingMode.POSITION, {})
        body = servo.firmware.body
        for _ in range(3000):
            body.horn.position_rad, body.horn.velocity_rad_per_s = joint.q_rad, joint.dq_rad_per_s
            joint.step(body.step(1e-3, alive=True) - 1.0, 1e-3)
        duty = 1.0 / (12.0 * XM.stall_torque_Nm_per_V)
        assert joint.q_rad / TICK_RAD == pytest.approx(-duty * 885 / (800 / 128), abs=2)

    def test_integral_gain_takes_the_load_in_the_end(self) -> None:
        servo, joint = xm430(), FreeJoint(inertia_kg_m2=0.02, viscous_Nm_s_per_rad=0.5)
        bench = started(servo, OperatingMode.POSITION, {table.POSITION_I_GAIN: 400})
        body = servo.firmware.body
        for _ in range(6000):
            body.horn.position_rad, body.horn.velocity_rad_per_s = joint.q_rad, joint.dq_rad_per_s
            joint.step(body.step(1e-3, alive=True) - 1.0, 1e-3)
        assert abs(joint.q_rad) <= 2 * TICK_RAD
        assert bench.read(1, table.MOVING_STATUS) == 1, "in position, no profile"

    def test_velocity_mode_ramps_with_the_profile_acceleration(self) -> None:
        servo = xm430()
        goals = {table.PROFILE_ACCELERATION: 10, table.GOAL_VELOCITY: 100}
        bench = started(servo, OperatingMode.VELOCITY, goals)
        run(servo, FreeJoint(inertia_kg_m2=0.02), 0.5)
        per_second = 10 * 214.577 / 60 / 0.229  # rev/min^2 into counts of velocity
        assert bench.read(1, table.VELOCITY_TRAJECTORY) == pytest.approx(0.5 * per_second, abs=1)

    def test_current_based_position_mode_never_exceeds_the_goal_current(self) -> None:
        servo, joint = xm430(), FreeJoint(inertia_kg_m2=0.02, viscous_Nm_s_per_rad=0.05)
        bench = started(servo, OperatingMode.CURRENT_BASED_POSITION, {table.GOAL_CURRENT: 150})
        bench.write(1, table.GOAL_POSITION, 3000)
        largest = 0.0
        for _ in range(300):
            run(servo, joint, 0.01)
            largest = max(largest, abs(servo.firmware.body.motor.current_A))
        assert largest == pytest.approx(150 * 2.69e-3)
        assert joint.q_rad == pytest.approx(952 * TICK_RAD, abs=3 * TICK_RAD)

    def test_torque_off_lets_the_joint_swing(self) -> None:
        servo, joint = xm430(), FreeJoint(q_rad=0.5, inertia_kg_m2=0.02, gravity_Nm=1.0)
        run(servo, joint, 0.1)
        assert joint.dq_rad_per_s < -0.5

    def test_limp_servo_heats_no_more(self) -> None:
        servo = xm430()
        bench = started(servo, OperatingMode.CURRENT, {table.GOAL_CURRENT: 700})
        run(servo, FreeJoint(inertia_kg_m2=1e6), 20.0, 0.01)
        warm = servo.firmware.body.motor.temperature_C
        assert warm > 26.0
        bench.write(1, table.TORQUE_ENABLE, 0)
        run(servo, FreeJoint(inertia_kg_m2=1e6), 20.0, 0.01)
        assert 25.0 < servo.firmware.body.motor.temperature_C < warm


class TestProfile:
    def test_no_profile_is_a_step(self) -> None:
        profile = Profile.by_velocity(0.0, 100.0, 0.0, 0.0)
        assert profile.kind is ProfileType.NONE
        assert profile.sample(0.0) == (100.0, 0.0)

    def test_rectangular_profile_has_the_profile_velocity(self) -> None:
        profile = Profile.by_velocity(0.0, -100.0, 50.0, 0.0)
        assert profile.kind is ProfileType.RECTANGULAR
        assert profile.total_s == 2.0
        assert profile.sample(1.0) == (-50.0, -50.0)

    @pytest.mark.parametrize(("distance", "kind"), [(1000.0, ProfileType.TRAPEZOIDAL), (10.0, ProfileType.TRIANGULAR)])
    def test_profile_keeps_its_acceleration_and_its_speed(self, distance: float, kind: ProfileType) -> None:
        speed, acceleration = 100.0, 200.0
        profile = Profile.by_velocity(0.0, distance, speed, acceleration)
        assert profile.kind is kind
        steps = 2000
        dt = profile.total_s / steps
        samples = [profile.sample(i * dt) for i in range(steps + 1)]
        assert samples[0] == (0.0, 0.0)
        assert samples[-1][0] == pytest.approx(distance)
        assert max(v for _, v in samples) <= speed * (1 + 1e-9)
        for (_, v0), (_, v1) in itertools.pairwise(samples):
            assert abs(v1 - v0) <= acceleration * dt * (1 + 1e-6)
        travelled = math.fsum(0.5 * (v0 + v1) * dt for (_, v0), (_, v1) in itertools.pairwise(samples))
        assert travelled == pytest.approx(distance, rel=1e-3)

    @pytest.mark.parametrize("distance", [1000.0, -1000.0, 10.0, -10.0])
    def test_profile_brakes_as_it_accelerates_and_is_not_longer_than_needed(self, distance: float) -> None:
        speed, acceleration = 100.0, 200.0
        profile = Profile.by_velocity(5.0, 5.0 + distance, speed, acceleration)
        for share in (0.01, 0.1, 0.3, 0.45):
            since_s = share * profile.total_s
            begun, speed_then = profile.sample(since_s)
            left, speed_later = profile.sample(profile.total_s - since_s)
            assert begun - 5.0 == pytest.approx(5.0 + distance - left)
            assert speed_then == pytest.approx(speed_later)
        far = abs(distance)
        whole = far / speed + speed / acceleration if far > 50.0 else 2.0 * math.sqrt(far / acceleration)
        assert profile.total_s == pytest.approx(whole)

    def test_time_based_profile_takes_its_time(self) -> None:
        servo = xm430(drive_mode=4)
        bench = started(servo, OperatingMode.POSITION, {table.PROFILE_VELOCITY: 2000, table.PROFILE_ACCELERATION: 300})
        bench.write(1, table.GOAL_POSITION, 2500)
        joint = FreeJoint(inertia_kg_m2=0.02)
        run(servo, joint, 1.0)
        assert bench.read(1, table.POSITION_TRAJECTORY) == pytest.approx((2048 + 2500) / 2, abs=1)
        assert bench.read(1, table.MOVING_STATUS) & 0x32 == 0x32
        run(servo, joint, 1.1)
        assert bench.read(1, table.POSITION_TRAJECTORY) == 2500
        assert bench.read(1, table.MOVING_STATUS) & 0x02 == 0
