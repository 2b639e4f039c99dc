"""When a torque acts after the sample it answers: whole periods, parts of one, parts of a substep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_backend.physics.actuator import ActuatorError, ActuatorSpec
from sim_backend.physics.delay import DelayLine, stretches

SUBSTEP_S, SUBSTEPS = 1e-3, 5
torques = st.lists(st.floats(-20, 20), min_size=6, max_size=30)


def acted(delay_s: float, commands: Sequence[float]) -> list[float]:
    """Torque in every substep, the command of a tick being pushed as late as the plant's server may push it."""
    line, found = DelayLine(delay_s, SUBSTEP_S, SUBSTEPS, 1), []
    for tick, tau in enumerate(commands):
        if not line.periods:
            line.push(tick, np.array([tau]))
        parts = stretches([line], SUBSTEPS)
        found += [float(line.acting(tick, begin)[0]) for begin, count in parts for _ in range(count)]
        if line.periods:
            line.push(tick, np.array([tau]))
    return found


@given(st.integers(0, 4), torques)
def test_whole_periods_shift_the_commands_and_change_no_bit(periods: int, commands: list[float]) -> None:
    late = ([0.0] * periods + commands)[: len(commands)]
    assert acted(periods * SUBSTEPS * SUBSTEP_S, commands) == [tau for tau in late for _ in range(SUBSTEPS)]


@given(st.floats(0.0, 0.02), torques)
def test_every_substep_has_the_mean_of_what_acts_in_it(delay_s: float, commands: list[float]) -> None:
    """Impulse of each substep, against the held commands shifted by the delay to the last digit."""
    edges = np.arange(len(commands) * SUBSTEPS + 1) * SUBSTEP_S - delay_s
    impulse_until = np.concatenate([[0.0], np.cumsum(commands)]) * SUBSTEPS * SUBSTEP_S
    ticks = np.arange(len(commands) + 1) * SUBSTEPS * SUBSTEP_S
    wanted = np.diff(np.interp(edges, ticks, impulse_until, left=0.0)) / SUBSTEP_S
    np.testing.assert_allclose(acted(delay_s, commands), wanted, atol=1e-4)  # a delay next to a substep's edge is on it


@pytest.mark.parametrize(
    ("delay_s", "parts"),
    [
        (0.0, ((0, 5),)),
        (0.005, ((0, 5),)),
        (0.002, ((0, 2), (2, 3))),
        (0.0023, ((0, 2), (2, 1), (3, 2))),
        (0.0049, ((0, 4), (4, 1))),
        (0.0073, ((0, 2), (2, 1), (3, 2))),
    ],
)
def test_the_plant_is_stopped_only_where_the_torque_changes(delay_s: float, parts: tuple[tuple[int, int], ...]) -> None:
    assert stretches([DelayLine(delay_s, SUBSTEP_S, SUBSTEPS, 1)], SUBSTEPS) == parts


def test_arms_of_different_delay_share_the_stops() -> None:
    lines = [DelayLine(delay_s, SUBSTEP_S, SUBSTEPS, 1) for delay_s in (0.001, 0.0035)]
    assert stretches(lines, SUBSTEPS) == ((0, 1), (1, 2), (3, 1), (4, 1))


@pytest.mark.parametrize(("delay_s", "substep"), [(0.0, 0), (0.0021, 3), (0.005, 5), (0.0121, 13)])
def test_the_first_torque_is_through_in_that_substep(delay_s: float, substep: int) -> None:
    assert DelayLine(delay_s, SUBSTEP_S, SUBSTEPS, 1).first_substep == substep


def test_a_cleared_line_has_nothing_on_its_way() -> None:
    line = DelayLine(0.0125, SUBSTEP_S, SUBSTEPS, 1)
    for tick in range(2):
        line.push(tick, np.array([tick + 1.0]))
    line.clear()
    assert [float(line.acting(k, s)[0]) for k in (2, 3) for s in range(SUBSTEPS)] == [0.0] * 10


def jittered(jitter_s: float, commands: Sequence[float], seed: int = 1) -> list[float]:
    line = DelayLine(0.0055, SUBSTEP_S, SUBSTEPS, 1, jitter_s=jitter_s, seed=seed)
    found = []
    for tick, tau in enumerate(commands):
        parts = stretches([line], SUBSTEPS)
        known = [part for part in parts if line.is_known(part[0])]
        found += [float(line.acting(tick, begin)[0]) for begin, count in known for _ in range(count)]
        line.push(tick, np.array([tau]))
        found += [float(line.acting(tick, begin)[0]) for begin, count in parts[len(known) :] for _ in range(count)]
    return found


def test_jitter_moves_each_change_by_its_own_time_and_loses_no_impulse() -> None:
    """One command that differs acts for a period, a little more or less, and not before the delay less the jitter."""
    lengths = []
    for tick in range(5, 60):
        commands = [0.0] * 70
        commands[tick] = 1.0
        acted_s = np.array(jittered(0.002, commands)) * SUBSTEP_S
        begin = int(np.flatnonzero(acted_s)[0]) * SUBSTEP_S - tick * SUBSTEPS * SUBSTEP_S
        assert 0.0025 <= begin <= 0.0075
        lengths.append(float(acted_s.sum()))
    assert 0.001 < min(lengths) < 0.004
    assert 0.006 < max(lengths) < 0.009
    assert np.mean(lengths) == pytest.approx(0.005, abs=5e-4)


def test_jitter_is_the_same_for_the_same_seed_and_none_without() -> None:
    commands = list(np.arange(1.0, 60.0))
    assert jittered(0.001, commands) == jittered(0.001, commands)
    assert jittered(0.001, commands) != jittered(0.001, commands, seed=2)
    lates = [np.array(DelayLine(0.0055, SUBSTEP_S, SUBSTEPS, 1, jitter_s=j)._lates) for j in (1e-3, 1.1e-3)]
    parts = [(late - 5.5) / j for late, j in zip(lates, (1.0, 1.1), strict=True)]
    assert abs(np.corrcoef(*parts)[0, 1]) < 0.1, "another reality, another sequence"
    np.testing.assert_allclose(jittered(1e-12, commands), jittered(0.0, commands), rtol=1e-8)


def test_torques_that_could_overtake_each_other_are_refused() -> None:
    with pytest.raises(ActuatorError, match="delay_jitter_s"):
        DelayLine(0.005, SUBSTEP_S, SUBSTEPS, 1, jitter_s=0.0025)


def test_what_acts_before_an_answer_does_not_depend_on_it() -> None:
    """With jitter too: what is said to be known is the same before and after the command of its tick."""
    for delay_s in (0.0025, 0.0055, 0.0105):
        line = DelayLine(delay_s, SUBSTEP_S, SUBSTEPS, 1, jitter_s=0.002, seed=1)
        for tick in range(200):
            known = [substep for substep in range(SUBSTEPS) if line.is_known(substep)]
            before = [line.acting(tick, substep).copy() for substep in known]
            line.push(tick, np.array([float(tick + 1)]))
            assert before == [line.acting(tick, substep) for substep in known]
        assert len(known) == min(SUBSTEPS, max(0, int((delay_s - 0.002) / SUBSTEP_S + 1e-9)))


def test_from_the_first_substep_on_only_what_was_pushed_acts() -> None:
    line = DelayLine(0.0055, SUBSTEP_S, SUBSTEPS, 1, jitter_s=0.002)
    assert line.first_substep == 8
    for tick in range(60):
        line.push(tick, np.array([1.0]))
        for substep in range(SUBSTEPS):
            if tick * SUBSTEPS + substep >= line.first_substep:
                assert line.acting(tick, substep) == pytest.approx(1.0)


def test_a_line_is_that_of_the_servos() -> None:
    servos = ActuatorSpec.of(2, delay_s=0.0055, delay_jitter_s=0.002)
    made, same = DelayLine.of(servos, SUBSTEP_S, SUBSTEPS, 3), DelayLine(0.0055, 1e-3, 5, 2, jitter_s=0.002, seed=3)
    for tick in range(20):
        for line in (made, same):
            line.push(tick, np.array([1.0, 2.0]) * tick)
        assert [made.acting(tick, s).tolist() for s in range(5)] == [same.acting(tick, s).tolist() for s in range(5)]
