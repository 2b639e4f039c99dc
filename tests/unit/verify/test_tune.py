"""Gains: what the check predicts of the sampled loop, what `coop tune` proposes, and what the plant then does.

Servos are ideal here but for their delay, so that stable and unstable are told apart by nothing but the loop.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, cell_from_toml, load_cell, placement
from agent.control import ik, known
from agent.verify.chatter import velocity_chatter
from agent.verify.check import Verdict, examine
from agent.verify.tune import RIGID, Form, Margin, NoGains, Tuner
from agent.verify.tune_table import toml_lines, tune_table
from drivers.dynamixel.servo.table import VELOCITY_UNIT_RAD_PER_S
from tests.support.arm_files import with_true_arms
from tests.support.plant.inprocess import History, simulate

PAPER = configs.CELLS_DIR / "paper.toml"
EFFECTS = ("friction", "position_quantisation", "velocity_quantisation", "torque_quantisation")
IDEAL = (*(f"simulation.effects.{effect}=false" for effect in EFFECTS), "controller.friction_feedforward=false")
WORST = Margin(worst=0.98)
# a wrong inertia is then nothing but a wrong inertia
WEIGHTLESS = ("world.gravity_m_per_s2=[0.0, 0.0, 0.0]",)


def ideal(*overrides: str) -> Cell:
    return load_cell(PAPER, [*IDEAL, *overrides])


def settles(history: History) -> bool:
    """Whether the torque comes to rest; an unstable loop ends in a swing between the torque bounds."""
    chatter = history.chatter(0.7 * history.t[-1])
    assert chatter < 1e-3 or chatter > 0.03, f"neither at rest nor swinging: {chatter} N·m"
    return chatter < 1e-3


TABLE = [
    ("servo", 120.0, 0.0, True),
    ("servo", 150.0, 0.75, True),
    ("servo", 90.0, 0.75, False),
    ("servo", 120.0, 1.0, False),
    ("servo", 150.0, 1.0, False),
    ("servo", 170.0, 1.0, True),
    ("servo", 200.0, 1.0, True),
    ("observer", 100.0, 0.3, False),
    ("observer", 150.0, 0.3, True),
    ("observer", 120.0, 1.0, False),
    ("observer", 180.0, 1.0, True),
    ("observer", 200.0, 1.0, True),
]


@pytest.mark.parametrize(("velocity", "rate_hz", "delay", "accepted"), TABLE)
def test_what_the_check_refuses_diverges_and_what_it_accepts_converges(
    velocity: str, rate_hz: float, delay: float, accepted: bool
) -> None:
    cell = ideal(f"rate_hz={rate_hz}", f"loop_delay_s={delay / rate_hz!r}", f'controller.velocity="{velocity}"')
    assert examine(cell).ok == accepted
    assert settles(simulate(cell, 1.5)) == accepted


@pytest.mark.parametrize(
    ("velocity", "rate_hz", "delay", "stable"),
    [
        ("servo", 200.0, 2.0, False),
        ("servo", 190.0, 1.8, False),
        ("servo", 300.0, 2.0, True),
        ("observer", 200.0, 2.0, False),
        ("observer", 200.0, 0.5, True),
        ("observer", 320.0, 2.0, True),
    ],
)
def test_a_simulated_delay_that_nobody_believes_is_warned_of_where_it_diverges(
    velocity: str, rate_hz: float, delay: float, stable: bool
) -> None:
    cell = ideal(
        f"rate_hz={rate_hz}", f"simulation.effects.delay_s={delay / rate_hz!r}", f'controller.velocity="{velocity}"'
    )
    report = examine(cell)
    found = next(f for f in report.findings if f.what == f"the same, {delay / rate_hz * 1e3:.3g} ms delay as simulated")
    assert report.ok
    assert found.verdict is (Verdict.OK if stable else Verdict.WARNING)
    assert settles(simulate(cell, 1.5)) == stable


@pytest.mark.parametrize("velocity", ["servo", "observer"])
@pytest.mark.parametrize(("rate_hz", "delay"), [(110.0, 1.0), (120.0, 1.0), (140.0, 1.0), (90.0, 0.7), (80.0, 0.85)])
def test_a_small_disturbance_grows_by_the_spectral_radius(velocity: str, rate_hz: float, delay: float) -> None:
    cell = ideal(
        f"rate_hz={rate_hz}",
        f"loop_delay_s={delay / rate_hz!r}",
        f'controller.velocity="{velocity}"',
        "trajectory.p_amplitude_m=[0.0, 0.0, 0.0]",
        "trajectory.angle_rad=0.0",
        "object.p_start_m=[0.3000001, 0.1200002, 0.0]",
        "safety.tau_step_max_fraction=2.0",
        *WEIGHTLESS,
    )
    predicted = Tuner(cell).configured().damping[0.0].radius
    assert predicted > 1.01
    change = np.abs(np.diff(np.array(simulate(cell, 2.0).tau), axis=0)).max(axis=1)
    linear = (change > 1e-4) & (change < 0.1)  # grown out of the start, not yet at the torque bounds
    first, last = np.flatnonzero(linear)[[0, -1]]
    assert last - first > 20
    envelope = np.maximum.accumulate(change[first : last + 1])
    growth = np.polyfit(np.arange(len(envelope)), np.log(envelope), 1)[0]
    assert np.exp(growth) == pytest.approx(predicted, abs=0.01)


@pytest.fixture(scope="module", params=["servo", "observer"])
def tuner(request: pytest.FixtureRequest) -> Tuner:
    return Tuner(ideal(f'controller.velocity="{request.param}"', *WEIGHTLESS))


@pytest.mark.parametrize("form", RIGID)
def test_a_proposal_keeps_the_margin(tuner: Tuner, form: Form) -> None:
    proposal = tuner.propose(form, Margin())
    assert set(proposal.after.damping) == {0.0, -0.3, 0.3}
    for found in proposal.after.damping.values():
        assert found.radius <= 0.999
        assert found.ratio >= 0.05
    again = Tuner(cell_from_toml(proposal.toml().encode(), "again")).configured()
    assert again.damping == pytest.approx(proposal.after.damping)


@pytest.mark.parametrize(("velocity", "form"), [("servo", Form.RATIO), ("observer", Form.RATIO), ("servo", Form.RATE)])
def test_a_proposal_is_the_largest(velocity: str, form: Form) -> None:
    margin = Margin(damping=0.1)
    proposal = Tuner(ideal(f'controller.velocity="{velocity}"')).propose(form, margin)
    gains = proposal.after.gains
    bolder = [f"controller.k_p_rate_per_s={1.05 * gains.k_p_rate[0]}"]
    bolder.append(f"controller.k_eps_rate_rad_per_s={1.05 * gains.k_eps_rate[0]}")
    if form is Form.RATIO:
        bolder.append(f"controller.k_p_per_s={1.05 * gains.k_p[0]}")
        bolder.append(f"controller.k_eps_rad_per_s={1.05 * gains.k_eps[0]}")
    k_v = [c for c in proposal.changes if c.table == "arms"]
    bolder += [f"arms.{c.name}.{c.key}={c.toml}" for c in k_v]
    cell = ideal(f'controller.velocity="{velocity}"', *bolder)
    assert not all(map(margin.kept_by, Tuner(cell).configured().damping.values()))


def test_the_ratio_form_keeps_the_ratio_and_the_rate_form_the_gains_themselves() -> None:
    cell = ideal('controller.velocity="servo"', "controller.k_p_rate_per_s=120.0", "controller.k_p_per_s=[150, 90, 60]")
    tuner = Tuner(cell)
    ratio, rate = (tuner.propose(form, Margin(damping=0.3)).after.gains for form in RIGID)
    before = tuner.configured().gains
    for was, now in zip((*before.k_p, *before.k_p_rate), (*ratio.k_p, *ratio.k_p_rate), strict=True):
        assert now / was == pytest.approx(ratio.k_p[0] / 150.0, rel=0.01)
    assert rate.k_p == before.k_p
    assert rate.k_eps == before.k_eps
    assert rate.k_p_rate[0] < before.k_p_rate[0]


def test_a_k_v_that_no_gain_can_make_up_for_is_lowered_for_rotation_alone() -> None:
    """At 120 Hz and a wrist this light, k_v of the rotation alone swings."""
    cell = ideal("rate_hz=120.0", 'controller.velocity="servo"', "controller.k_p_per_s=20.0")
    proposal = Tuner(cell).propose(Form.RATIO, Margin(damping=0.3))
    changed = {(c.name, c.key) for c in proposal.changes if c.table == "arms"}
    assert changed == {("left", "k_v_Nm_s_per_rad"), ("right", "k_v_Nm_s_per_rad")}


def test_no_gains_are_refused_with_the_rate() -> None:
    tuner = Tuner(ideal("rate_hz=20.0"))
    with pytest.raises(NoGains, match=r"at 20 Hz: found none.*damping of at least 0\.4; raise rate_hz"):
        tuner.proposals(Margin(damping=0.4))


def test_lines_to_paste_are_the_changes_of_the_written_file(tuner: Tuner) -> None:
    proposal = tuner.propose(Form.RATIO, Margin())
    pasted = tomllib.loads(toml_lines(proposal))
    written = tomllib.loads(proposal.toml())
    assert pasted["controller"].items() <= written["controller"].items()
    for arm, lines in zip(written["arms"], pasted.get("arms", []), strict=False):
        assert lines.items() <= arm.items()


def test_the_table_has_a_column_for_every_proposal_and_marks_what_is_unstable(tuner: Tuner) -> None:
    proposals = tuner.proposals(Margin())
    table = tune_table(tuner.configured(), proposals)
    assert [column.header for column in table.columns] == ["", "configured", "--form ratio", "--form rate"]
    cells = {row: list(column.cells) for row, column in zip(("label", "configured"), table.columns, strict=False)}
    row = dict(zip(cells["label"], cells["configured"], strict=True))
    assert row["k_p_per_s"] == "150"
    assert row["spectral radius, arms' inertia -30%"].startswith("[red]")
    assert not row["spectral radius"].startswith("[red]")


def test_torque_noise_is_that_of_the_law_itself() -> None:
    """dτ/d(dq) of the running law at rest on a still trajectory, by finite differences."""
    cell = ideal("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0")
    arm = cell.arms[0]
    model, offline, desired = cell.model(arm), cell.offline(arm), cell.trajectory().at(0.0)
    q = ik.solve(model, placement(desired.p, desired.quat), np.array(arm.entry.q_near_rad))
    h = 1e-6
    columns = [known.torque(model, offline, q, h * e, desired).tau_cmd for e in np.eye(model.n)]
    columns_back = [known.torque(model, offline, q, -h * e, desired).tau_cmd for e in np.eye(model.n)]
    feedback = (np.array(columns) - np.array(columns_back)).T / (2.0 * h)
    grid = VELOCITY_UNIT_RAD_PER_S
    rms = np.sqrt((feedback**2).sum(axis=1) * grid**2 / 12.0).max()
    assert velocity_chatter(model, offline, q) == pytest.approx(rms, rel=1e-6)


@pytest.mark.parametrize("form", RIGID)
def test_the_proposal_settles_where_the_configured_gains_diverge(tuner: Tuner, form: Form, tmp_path: Path) -> None:
    """The plant's arms 30 % lighter than the agents believe, in every mass, inertia and rotor."""
    proposed = tuner.propose(form, Margin()).after.cell
    assert not settles(simulate(with_true_arms(tuner.cell, tmp_path, inertia=0.7), 2.0, agents_cell=tuner.cell))
    for inertia in (0.7, 1.0, 1.3):
        assert settles(simulate(with_true_arms(proposed, tmp_path, inertia=inertia), 2.0, agents_cell=proposed))


def test_gains_for_reality_are_stable_in_all_of_it_and_no_noisier() -> None:
    cell = load_cell(PAPER)
    proposal = Tuner(cell).propose(Form.REALITY, WORST)
    found = examine(cell_from_toml(proposal.toml().encode(), "again"), thorough=True)
    assert found.robustness is not None
    assert proposal.before.criterion.radius > 1.5
    assert found.robustness.criterion.radius < 0.99  # at other places of the trajectory than those of the search
    assert proposal.after.criterion.radius <= 0.98 + 1e-6
    assert proposal.after.criterion.radius > 0.96  # and not more timid than asked
    assert max(proposal.after.chatter_Nm) <= max(proposal.before.chatter_Nm)
    gains = proposal.after.gains
    assert gains.k_v[3] < 0.3 < gains.k_v[0]


@pytest.mark.long
def test_gains_for_reality_are_the_same_every_time() -> None:
    first, second = (Tuner(load_cell(PAPER)).propose(Form.REALITY, WORST) for _ in range(2))
    assert first.changes == second.changes


@pytest.mark.parametrize(
    ("stated", "key"),
    [
        pytest.param("tolerance.delay=[0.8, 10.0]", "tolerance.delay", marks=pytest.mark.long),
        ("safety.inertia_error=0.97", "safety.inertia_error"),
    ],
)
def test_when_nothing_survives_the_demand_and_the_tolerance_that_bind_are_named(stated: str, key: str) -> None:
    with pytest.raises(NoGains) as caught:
        Tuner(load_cell(PAPER, [stated])).propose(Form.REALITY, Margin(worst=0.97))
    text = str(caught.value)
    assert "found none; the nearest have a radius of " in text
    assert "expected at most 0.97 whatever of the stated tolerance is true; " in text
    assert key in text.partition("; ")[2].rpartition(" binds ")[0].split("; ")[-1].split(" or ")
    assert "\n" not in text
