"""Which tests answer for which module."""

from __future__ import annotations

from dataclasses import dataclass

UNIT = "tests/unit"
_PROPERTY = "tests/property/control"


@dataclass(frozen=True)
class Target:
    """A module and the tests that must notice every change to it.

    generate: whether changes are generated; warm: cached functions of tests as module:name, which are called once for
    all changes; they call nothing of the module itself.
    """

    module: str
    tests: tuple[str, ...]
    generate: bool = True
    warm: tuple[str, ...] = ()


_STEP = tuple(
    f"{UNIT}/{name}.py"
    for name in (
        "test_step", "test_step_rules", "test_step_together", "test_step_session", "test_singular", "test_hold",
        "test_calm", "control/test_brace", "control/test_friction_factor",
        "control/test_adaptive", "control/test_floating", "guard/test_resume", "monitors/test_monitors",
    )
)  # fmt: skip
_LAW = tuple(
    f"{_PROPERTY}/test_{name}.py"
    for name in (
        "control_law", "control_derivatives", "control_internal_force", "control_inverse", "control_posture",
        "adaptive_law",
    )
)  # fmt: skip
_WELDED = tuple(
    f"{UNIT}/sim_backend/test_{name}.py"
    for name in ("plant", "chain", "gears", "plant_refusals", "meter", "snapshot", "sticking", "instants")
)
_MONITORS = tuple(f"{UNIT}/monitors/{name}.py" for name in ("test_each_monitor", "test_monitors"))
_RUNNER = tuple(
    f"{UNIT}/{name}.py"
    for name in (
        "test_runner", "test_runner_trouble", "test_runner_record", "test_runner_return", "test_runner_session",
        "monitors/test_watch_in_runner",
    )
)  # fmt: skip
_WARM = (
    "tests.support.runner_rig:q_start",
    "tests.support.runner_rig:period_ns",
    "tests.support.session_script:made",
)
_RING = (
    f"{UNIT}/telemetry/test_ring.py",
    f"{UNIT}/telemetry/test_ring_file.py",
    f"{UNIT}/telemetry/test_ring_heir.py",
    f"{UNIT}/telemetry/test_ring_reader.py",
    "tests/property/telemetry/test_ring_model.py",
)
_DRIVER = (f"{UNIT}/drivers/test_driver.py", f"{UNIT}/drivers/test_driver_cycle.py")
_BRING_UP = tuple(f"{UNIT}/drivers/{name}.py" for name in ("test_dxl_bringup", "test_swapped_arms", "test_standby"))
_VIEW = tuple(f"{UNIT}/view/{name}.py" for name in ("test_scene", "test_pictures"))
_PAGE = (f"{UNIT}/view/test_page.py",)
_VERIFY = tuple(f"{UNIT}/replay/{name}.py" for name in ("test_verify", "test_verify_trouble", "test_replay_command"))
_CRITERION = f"{UNIT}/verify/criterion"
_RECORDED = (*_WARM, "tests.unit.replay.test_verify:eventful")
_SENSES = ("test_against", "test_borne", "test_brace", "test_knock", "test_touch")
_SOFT = tuple(f"{UNIT}/sim_backend/{name}.py" for name in ("test_soft", "test_pads", "test_reality", "test_calendar"))

TARGETS = (
    Target("agent.safety", (f"{UNIT}/test_safety.py",)),
    Target("agent.calibrate.poses", (f"{UNIT}/calibrate/test_poses.py",)),
    Target("agent.config.floating", (f"{UNIT}/config/test_floating_config.py",)),
    Target(
        "agent.config.friction",
        (f"{UNIT}/config/test_noticing.py", f"{UNIT}/config/test_reality.py", f"{UNIT}/verify/test_rubbing.py"),
    ),
    Target("agent.config.reality", (f"{UNIT}/config/test_reality.py",)),
    Target("agent.config.monitors", (f"{UNIT}/monitors/test_bounds.py",)),
    Target(
        "agent.config.noticing",
        (f"{UNIT}/config/test_noticing.py", *(f"{UNIT}/control/{name}.py" for name in _SENSES)),
    ),
    Target(
        "agent.config.usual",
        (f"{UNIT}/config/test_noticing.py", *(f"{UNIT}/control/{name}.py" for name in _SENSES)),
    ),
    Target("agent.config.statics", (f"{UNIT}/monitors/test_bounds.py",)),
    Target("agent.config.urdf_joints", (f"{UNIT}/config/test_arm_file.py",)),
    Target(
        "agent.control.adaptation",
        (
            *(f"{UNIT}/control/{name}.py" for name in ("test_adaptation", "test_adaptive")),
            f"{_PROPERTY}/test_adaptive_projection.py",
        ),
    ),
    Target(
        "agent.control.adaptive",
        (
            *(f"{_PROPERTY}/test_{name}.py" for name in ("adaptive_law", "control_posture")),
            f"{UNIT}/control/test_adaptive.py",
        ),
    ),
    Target("agent.control.against", (f"{UNIT}/control/test_against.py",)),
    Target("agent.control.borne", (f"{UNIT}/control/test_borne.py",)),
    Target("agent.control.brace", (f"{UNIT}/control/test_brace.py",)),
    Target("agent.control.cause", (f"{UNIT}/control/test_cause.py",)),
    Target("agent.control.knock", (f"{UNIT}/control/test_knock.py",)),
    Target("agent.control.alignment", (f"{UNIT}/control/test_alignment.py",)),
    Target("agent.control.errors", _LAW),
    Target("agent.control.estimator", (f"{UNIT}/control/test_estimator.py",)),
    Target("agent.control.floating", (f"{UNIT}/control/test_floating.py",)),
    Target(
        "agent.control.friction",
        tuple(f"{UNIT}/control/{name}.py" for name in ("test_friction", "test_friction_factor")),
    ),
    Target("agent.control.friction_factor", (f"{UNIT}/control/test_friction_factor.py",)),
    Target("agent.control.internal_force", (f"{_PROPERTY}/test_control_internal_force.py",)),
    Target("agent.control.inverse", (f"{_PROPERTY}/test_control_inverse.py",)),
    Target("agent.control.joint_hold", tuple(f"{UNIT}/{name}.py" for name in ("test_singular", "test_hold"))),
    Target("agent.control.joint_track", (f"{UNIT}/test_phase_torques.py",)),
    Target("agent.control.known", _LAW),
    Target("agent.control.law", _LAW),
    Target(
        "agent.control.memory",
        tuple(f"{UNIT}/{name}.py" for name in ("control/test_estimator", "test_hold", "telemetry/test_row")),
    ),
    Target(
        "agent.control.models",
        (f"{_PROPERTY}/test_control_models.py", f"{_PROPERTY}/test_control_models_by_definition.py"),
    ),
    Target("agent.control.posture", (f"{_PROPERTY}/test_control_posture.py",)),
    Target("agent.control.residual", tuple(f"{UNIT}/control/{name}.py" for name in ("test_residual", "test_touch"))),
    Target("agent.control.touch", (f"{UNIT}/control/test_touch.py",)),
    Target("agent.guard.guarded", (f"{UNIT}/guard/test_guarded.py",)),
    Target("agent.guard.pulse", (f"{UNIT}/guard/test_pulse.py",)),
    Target("agent.guard.resume", (f"{UNIT}/guard/test_resume.py",)),
    Target(
        "agent.guard.takeover",
        (f"{UNIT}/guard/test_vigil.py", f"{UNIT}/guard/test_go_on.py", f"{UNIT}/process/test_guard_watches.py"),
    ),
    Target("agent.guard.vigil", (f"{UNIT}/guard/test_vigil.py",)),
    Target("agent.guard.watched", (f"{UNIT}/guard/test_watched.py",)),
    Target("agent.host.notify", (f"{UNIT}/host/test_notify.py",)),
    Target("agent.host.process_handle", (f"{UNIT}/host/test_process_handle.py",)),
    Target("agent.process.hearing", (f"{UNIT}/process/test_hearing.py",)),
    Target("agent.process.let_go", (f"{UNIT}/process/test_agent_order.py",)),
    Target("agent.config.schema.fault", (f"{UNIT}/config/test_fault.py",)),
    Target("agent.process.arranged", (f"{UNIT}/process/test_arranged.py",)),
    Target("agent.process.befallen", (f"{UNIT}/process/test_befallen.py",)),
    Target(
        "agent.process.operated",
        (f"{UNIT}/process/test_operated.py", f"{UNIT}/process/test_arranged.py"),
    ),
    Target("agent.modes", (f"{UNIT}/test_modes.py",)),
    Target("agent.log.lacking", (f"{UNIT}/log/test_lacking.py", f"{UNIT}/process/test_listening.py")),
    Target("agent.loop", _STEP),
    Target("agent.missed", _STEP),
    Target("agent.standing", _STEP),
    Target("agent.calm", tuple(f"{UNIT}/{name}.py" for name in ("test_calm", "test_hold", "test_step_together"))),
    Target("agent.cycles", (f"{UNIT}/test_cycles.py",)),
    Target("agent.phases", (f"{UNIT}/test_phase_torques.py",)),
    Target("agent.session_modes", (f"{UNIT}/test_session_modes.py", f"{UNIT}/test_modes.py")),
    Target("agent.runner", _RUNNER, warm=_WARM),
    Target("agent.sight", (f"{UNIT}/test_sight.py",)),
    Target("agent.telling", (f"{UNIT}/test_telling.py",)),
    Target("agent.ticks", _RUNNER, warm=_WARM),
    Target("agent.transition", (f"{UNIT}/test_transition.py",)),
    Target(
        "agent.process.float_loop",
        tuple(f"{UNIT}/process/{name}.py" for name in ("test_float_loop", "test_float_ending")),
    ),
    Target("agent.host.unix_socket", (f"{UNIT}/operator/test_control_socket.py", f"{UNIT}/guard/test_line.py")),
    Target("drivers.peer", (f"{UNIT}/drivers/test_peer.py",)),
    Target("agent.operator.promise", (f"{UNIT}/operator/test_two_operators.py",)),
    Target(
        "agent.operator.socket",
        (
            f"{UNIT}/operator/test_control_socket.py",
            f"{UNIT}/operator/test_two_operators.py",
            f"{UNIT}/process/test_operated.py",
        ),
    ),
    Target("agent.monitors.body", _MONITORS),
    Target("agent.monitors.gravity", (f"{UNIT}/monitors/test_gravity.py",)),
    Target("agent.monitors.joints", _MONITORS),
    Target("agent.monitors.servos", _MONITORS),
    Target("agent.monitors.watch", _MONITORS),
    Target(
        "agent.replay.chain",
        (*_VERIFY, f"{UNIT}/replay/test_whatif.py", f"{UNIT}/guard/test_resume.py"),
        warm=_RECORDED,
    ),
    Target("agent.replay.grasps", (f"{UNIT}/replay/test_grasps.py", f"{UNIT}/replay/test_answers.py")),
    Target("agent.replay.rows", _VERIFY, warm=_RECORDED),
    Target("agent.replay.same", (f"{UNIT}/replay/test_same.py", f"{UNIT}/replay/test_answers.py")),
    Target("agent.replay.verify", _VERIFY, warm=_RECORDED),
    Target("agent.report.found_together", (f"{UNIT}/report/test_found_together.py",)),
    Target("agent.telemetry.ring.file", _RING),
    Target("agent.telemetry.ring.heir", _RING),
    Target("agent.telemetry.ring.reader", _RING),
    Target("agent.telemetry.ring.texts", (f"{UNIT}/telemetry/test_texts.py", f"{UNIT}/telemetry/test_event.py")),
    Target("agent.telemetry.ring.words", _RING),
    Target("agent.telemetry.ring.writer", _RING),
    Target("agent.view.camera", (f"{UNIT}/view/test_camera.py", *_VIEW)),
    Target("agent.view.curves", _PAGE),
    Target("agent.view.motion", (f"{UNIT}/view/test_motion.py", *_VIEW, *_PAGE)),
    Target("agent.view.player", _PAGE),
    Target("agent.view.pose", _VIEW),
    Target("agent.verify.ahead", (f"{UNIT}/verify/test_felt.py",)),
    Target("agent.verify.asked", (f"{UNIT}/verify/test_asked.py",)),
    Target("agent.verify.felt", (f"{UNIT}/verify/test_felt.py",)),
    Target("agent.verify.collision.way", (f"{UNIT}/verify/test_way.py",)),
    Target("agent.verify.criterion.exponential", (f"{_CRITERION}/test_exponential.py",)),
    Target("agent.verify.criterion.power", (f"{_CRITERION}/test_power.py",)),
    Target("agent.verify.radius", (f"{UNIT}/verify/test_radius.py",)),
    Target("agent.verify.rubbing", (f"{UNIT}/verify/test_rubbing.py",)),
    Target("agent.verify.start", (f"{UNIT}/verify/test_start.py",)),
    Target("agent.verify.disagreement", (f"{UNIT}/verify/test_disagreement.py",)),
    Target(
        "drivers.dynamixel.bringup",
        (*_BRING_UP, f"{UNIT}/drivers/test_bringup_writes.py", f"{UNIT}/drivers/test_recover.py"),
    ),
    Target("drivers.dynamixel.checks", (f"{UNIT}/drivers/test_checks.py", f"{UNIT}/drivers/test_interpret.py")),
    Target("drivers.dynamixel.connected", (f"{UNIT}/drivers/test_driver.py", f"{UNIT}/drivers/test_connected.py")),
    Target("drivers.dynamixel.cycle", (f"{UNIT}/drivers/test_cycle.py", f"{UNIT}/drivers/test_cycle_again.py")),
    Target(
        "drivers.dynamixel.driver",
        (
            *_DRIVER,
            f"{UNIT}/drivers/test_recover.py",
            f"{UNIT}/drivers/test_grip.py",
            f"{UNIT}/drivers/test_dxl_faults.py",
        ),
    ),
    Target("drivers.dynamixel.identify", (*_BRING_UP, f"{UNIT}/drivers/test_identify.py")),
    Target("drivers.dynamixel.interpret", (f"{UNIT}/drivers/test_interpret.py",)),
    Target(
        "drivers.dynamixel.line.codec",
        tuple(f"{UNIT}/drivers/{name}.py" for name in ("test_dxl_codec", "test_dxl_scanner")),
    ),
    Target("drivers.dynamixel.line.group", (f"{UNIT}/drivers/test_group.py",)),
    Target("drivers.dynamixel.monitor", (f"{UNIT}/drivers/test_monitor.py",)),
    Target("drivers.dynamixel.pace", tuple(f"{UNIT}/drivers/{name}.py" for name in ("test_pace", "test_driver"))),
    Target(
        "drivers.dynamixel.recovery", tuple(f"{UNIT}/drivers/{name}.py" for name in ("test_driver", "test_recover"))
    ),
    Target(
        "drivers.dynamixel.running",
        tuple(
            f"{UNIT}/drivers/{name}.py" for name in ("test_running", "test_grip", "test_swapped_arms", "test_recover")
        ),
    ),
    Target("drivers.dynamixel.servo.counts", (f"{UNIT}/drivers/test_dxl_units.py",)),
    Target(
        "drivers.dynamixel.servo.models",
        tuple(f"{UNIT}/drivers/{name}.py" for name in ("test_servo_figures", "test_servo_table")),
    ),
    Target("drivers.dynamixel.servo.torque", (f"{UNIT}/drivers/test_dxl_torque.py",)),
    Target("drivers.dynamixel.servo.units", (f"{UNIT}/drivers/test_dxl_units.py",)),
    Target(
        "drivers.dynamixel.standby",
        tuple(f"{UNIT}/drivers/{name}.py" for name in ("test_standby", "test_standby_line")),
    ),
    Target("drivers.dynamixel.stale", _DRIVER),
    Target("sim_backend.hil.touch", (f"{UNIT}/hil/test_touch.py",)),
    Target("sim_backend.physics.actuator", (f"{UNIT}/sim_backend/test_actuator.py",)),
    Target("sim_backend.physics.calendar", _SOFT),
    Target("sim_backend.physics.free_body", _SOFT),
    Target("sim_backend.physics.gears", (f"{UNIT}/sim_backend/test_gears.py",)),
    Target(
        "sim_backend.physics.lone", (*_WELDED, f"{UNIT}/sim_backend/test_lone.py", f"{UNIT}/sim_backend/test_stops.py")
    ),
    Target("sim_backend.physics.openings", (f"{UNIT}/sim_backend/test_slipped.py", *_SOFT)),
    Target("sim_backend.physics.pads", _SOFT),
    Target("sim_backend.physics.plant", (*_WELDED, "tests/property/sim_backend/test_plant_physics.py")),
    Target("sim_backend.physics.reality", (f"{UNIT}/sim_backend/test_reality.py",)),
    Target(
        "sim_backend.physics.soft", (*_SOFT, f"{UNIT}/sim_backend/test_slipped.py", f"{UNIT}/sim_backend/test_gears.py")
    ),
)
