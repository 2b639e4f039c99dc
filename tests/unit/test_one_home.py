"""Facts that several processes go by, each of which would go wrong beside others that it has not changed in."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.schema.simulation import Grasp
from agent.config.schema.tolerance import Tolerance
from agent.config.servo_map import arm_map
from agent.doctor import host
from agent.faults.virtual import UTC_OFFSET_NS
from agent.guard.pulse import pulse_vigil
from agent.guard.takeover import stale_ns
from agent.host.clock import ClockState
from agent.log.columns import Table
from agent.log.when import in_lockstep
from agent.operator.local import judge_clock
from agent.operator.past import Past
from agent.process import plant
from agent.process.build import Connection, patient
from agent.process.rehearse import bridge
from agent.process.schedule import patience_of
from agent.telemetry.row.sample import AGENT_STATE
from agent.verify.criterion.cases import Ranges
from agent.verify.finding import Verdict
from drivers.clock import LOCKSTEP_UTC_NS
from sim_backend.physics.spec import GraspSpec

CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", ['hil.arms=["left"]'])
ARM = CELL.arm("left")


def test_what_is_emulated_is_borne_for_half_a_second_by_loop_line_guard_and_bridge() -> None:
    cycles = CELL.file.rate_hz / 2
    assert patience_of(CELL, emulated=True).hold == cycles
    servos = arm_map(CELL, ARM, "none", np.zeros(ARM.n))
    assert patient(servos, Connection(emulated=True)).line_patience_cycles == cycles
    assert pulse_vigil(CELL.period_ns, shared=True).stale_ns == 500_000_000
    assert stale_ns(CELL.period_ns, emulated=True, simulated=False, floating=True) == 500_000_000
    any_of_it: Any = SimpleNamespace()
    assert bridge(CELL, ARM, any_of_it, any_of_it, any_of_it, emulated=True)._patience.stale_s == 0.5


def test_a_run_in_lockstep_is_known_by_the_origin_that_its_plant_gives_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: 1_700_000_000_987_654_321)
    offset_ns = plant._utc_at_zero_ns()
    assert offset_ns == 1_700_000_000_000_000_000
    rows = np.zeros(3, AGENT_STATE.dtype)
    rows["stamp_ns"] = [0, 5_000_000, 10_000_000]
    for beside_ns, waits in ((0, True), (1, False), (UTC_OFFSET_NS, False)):
        rows["utc_ns"] = rows["stamp_ns"] + offset_ns + beside_ns
        assert in_lockstep([Table.of(rows)]) is waits
        past = Past(written_by_the_living=True, rows=rows, health=None, trouble=None)
        by_utc_s = past.age_s(10_000_000 + 10**9, int(rows["utc_ns"][-1]) + 7 * 10**9)
        assert by_utc_s == pytest.approx(7.0 if waits else 1.0), "stamps of a lockstep are no time of this host"
    assert LOCKSTEP_UTC_NS == 10**9, "logs of earlier runs are known by it"


def test_a_clock_that_the_doctor_takes_for_good_is_one_that_no_start_warns_of() -> None:
    facts: Any = SimpleNamespace()
    for error_s, good in ((1e-3, True), (1.001e-3, False)):
        facts.clock = ClockState(synchronised=True, max_error_s=error_s)
        assert (host._clock_finding(facts).verdict is Verdict.OK) is good
        assert ("WARNING" not in judge_clock(facts.clock, several_hosts=True)) is good


def test_pads_of_which_nothing_is_said_damp_alike_for_file_plant_draws_and_checks() -> None:
    said_nothing = {
        Grasp(stiffness_N_per_m=1e4, stiffness_Nm_per_rad=50.0).damping_ratio, GraspSpec(1e4, 50.0).damping_ratio,
        Tolerance().pads_damping_ratio, Ranges((0.0, 0.0, 0.0)).pads_damping_ratio,
    }  # fmt: skip
    assert said_nothing == {0.25}
