"""Gains: what the check predicts of the sampled loop, what `coop tune` proposes, and what the plant then does.

Servos are ideal here but for their delay, so that stable and unstable are told apart by nothing but the loop.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config import observer
from agent.config.cell import Cell, cell_from_toml, load_cell, placement
from agent.control import ik, known
from agent.control.estimator import Observer
from agent.verify import along, lowering, stiffest
from agent.verify.chatter import Shaking, forgetting
from agent.verify.check import Verdict, examine
from agent.verify.proposed import OBSERVER_KEYS
from agent.verify.robustness import loop_of, ranges_of
from agent.verify.scale import Scale
from agent.verify.stiffest import Search, Wanted
from agent.verify.tune import RIGID, Form, Margin, Proposal, Tuner
from agent.verify.tune_refusal import NoGains
from agent.verify.tune_table import toml_lines, tune_table
from agent.verify.usual_gains import PLANAR
from drivers.dynamixel.servo.counts import VELOCITY_UNIT_RAD_PER_S
from drivers.interface import Vector
from tests.support.arm_files import with_true_arms
from tests.support.few import few
from tests.support.plant.inprocess import History, simulate

PAPER = configs.CELLS_DIR / "paper.toml"
LONG = pytest.mark.long
EFFECTS = ("friction", "position_quantisation", "velocity_quantisation", "torque_quantisation")
IDEAL = (*(f"simulation.effects.{effect}=false" for effect in EFFECTS), "controller.friction_feedforward=false")
# a wrong inertia is then nothing but a wrong inertia
WEIGHTLESS = ("world.gravity_m_per_s2=[0.0, 0.0, 0.0]",)


@pytest.fixture(scope="module", autouse=True)
def at_a_few_places() -> Iterator[None]:
    """Gains are looked for at the start and a third and two thirds of the motion on: every one costs the same again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(along, "PLACES", 3)
        yield


def ideal(*overrides: str) -> Cell:
    return load_cell(PAPER, [*IDEAL, *overrides])


def settles(history: History) -> bool:
    """Whether the torque comes to rest; an unstable loop ends in a swing between the torque bounds."""
    chatter = history.chatter(0.7 * history.t[-1])
    assert chatter < 1e-3 or chatter > 0.03, f"neither at rest nor swinging: {chatter} N·m"
    return chatter < 1e-3


TABLE = [
    ("servo", 120.0, 0.0, True),
    ("servo", 90.0, 0.75, False),
    ("servo", 150.0, 1.0, False),
    ("servo", 170.0, 1.0, True),
    ("observer", 100.0, 0.3, False),
    ("observer", 180.0, 1.0, True),
    *(
        pytest.param(*row, marks=LONG)
        for row in (
            ("servo", 150.0, 0.75, True),
            ("servo", 120.0, 1.0, False),
            ("servo", 200.0, 1.0, True),
            ("observer", 150.0, 0.3, True),
            ("observer", 120.0, 1.0, False),
            ("observer", 200.0, 1.0, True),
        )
    ),
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
        ("observer", 320.0, 2.0, True),
        *(
            pytest.param(*row, marks=LONG)
            for row in (
                ("servo", 190.0, 1.8, False),
                ("servo", 300.0, 2.0, True),
                ("observer", 200.0, 2.0, False),
                ("observer", 200.0, 0.5, True),
            )
        ),
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


@pytest.mark.parametrize(
    ("rate_hz", "delay", "velocity"),
    few(
        (
            (*row, velocity)
            for velocity in ("servo", "observer")
            for row in ((120.0, 1.0), (80.0, 0.85), (110.0, 1.0), (140.0, 1.0), (90.0, 0.7))
        ),
        {(120.0, 1.0, "servo"), (80.0, 0.85, "observer")}.__contains__,
    ),
)
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


@pytest.fixture(scope="module", params=[pytest.param("servo", marks=LONG), "observer"])
def tuner(request: pytest.FixtureRequest) -> Tuner:
    return Tuner(ideal(f'controller.velocity="{request.param}"', *WEIGHTLESS))


@pytest.fixture(scope="module")
def proposed(tuner: Tuner) -> Callable[[Form], Proposal]:
    """What it proposes with the usual margin, searched once."""
    return cache(lambda form: tuner.propose(form, Margin()))


@pytest.mark.parametrize("form", RIGID)
def test_a_proposal_keeps_the_margin(proposed: Callable[[Form], Proposal], form: Form) -> None:
    proposal = proposed(form)
    assert set(proposal.after.damping) == {0.0, -0.3, 0.3}
    for found in proposal.after.damping.values():
        assert found.radius <= 0.999
        assert found.ratio >= 0.05
    again = Tuner(cell_from_toml(proposal.toml().encode(), "again")).configured()
    assert again.damping == pytest.approx(proposal.after.damping)


@pytest.mark.parametrize(
    ("velocity", "form"),
    [("observer", Form.RATIO), *(pytest.param("servo", form, marks=LONG) for form in (Form.RATE, Form.RATIO))],
)
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


def test_no_gains_are_refused_with_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lowering, "K_V_FACTORS", (1.0, 0.1))  # the ends of what is tried
    tuner = Tuner(ideal("rate_hz=20.0", "simulation.substeps_per_cycle=9"))
    with pytest.raises(NoGains, match=r"at 20 Hz: found none.*damping of at least 0\.4; raise rate_hz"):
        tuner.proposals(Margin(damping=0.4))


def test_lines_to_paste_are_the_changes_of_the_written_file(proposed: Callable[[Form], Proposal]) -> None:
    proposal = proposed(Form.RATIO)
    pasted = tomllib.loads(toml_lines(proposal))
    written = tomllib.loads(proposal.toml())
    assert pasted["controller"].items() <= written["controller"].items()
    for arm, lines in zip(written["arms"], pasted.get("arms", []), strict=False):
        assert lines.items() <= arm.items()


def test_the_table_has_a_column_for_every_proposal_and_marks_what_is_unstable(
    tuner: Tuner, proposed: Callable[[Form], Proposal]
) -> None:
    proposals = [proposed(form) for form in RIGID]
    assert all(proposal.before is tuner.configured() for proposal in proposals), "a sweep of the criterion each"
    table = tune_table(tuner.configured(), proposals)
    assert [column.header for column in table.columns] == ["", "configured", "--form ratio", "--form rate"]
    cells = {row: list(column.cells) for row, column in zip(("label", "configured"), table.columns, strict=False)}
    row = dict(zip(cells["label"], cells["configured"], strict=True))
    assert row["k_p_per_s"] == "150"
    assert row["spectral radius, arms' inertia -30%"].startswith("[red]")
    assert not row["spectral radius"].startswith("[red]")


def shaken(*overrides: str) -> tuple[Shaking, Cell, Vector]:
    """The left arm of the paper's cell, weightless and at rest, and its joint angles."""
    cell = ideal("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0", *WEIGHTLESS, *overrides)
    arm, desired = cell.arms[0], cell.trajectory().at(0.0)
    model = cell.model(arm)
    q = ik.solve(model, placement(desired.p, desired.quat), np.array(arm.entry.q_near_rad))
    # near rest the smooth sign of Coulomb friction is viscous, too
    viscous = np.array([s.viscous_Nm_s_per_rad.value + s.coulomb_Nm.value / 10.0 for s in arm.servos])
    return Shaking(model, cell.offline(arm), viscous, q), cell, q


@pytest.mark.parametrize("friction", ["false", "true"])
def test_torque_noise_is_that_of_the_law_itself(friction: str) -> None:
    """dτ/dq and dτ/d(dq) of the running law at rest on a still trajectory, by finite differences."""
    shaking, cell, q = shaken(
        f"controller.friction_feedforward={friction}", "controller.friction_smooth_rad_per_s=10.0"
    )
    arm = cell.arms[0]
    model, offline, desired = cell.model(arm), cell.offline(arm), cell.trajectory().at(0.0)
    h = 1e-6

    def torque(dq: Vector, ddq: Vector) -> Vector:
        return known.torque(model, offline, q + dq, ddq, desired).tau_cmd

    units, zero = h * np.eye(model.n), np.zeros(model.n)
    by_angle = np.array([torque(e, zero) - torque(-e, zero) for e in units]).T / (2.0 * h)
    by_velocity = np.array([torque(zero, e) - torque(zero, -e) for e in units]).T / (2.0 * h)
    found = shaking.feedback(offline.gains)
    assert -found[0] == pytest.approx(by_angle, rel=1e-3, abs=1e-4)
    assert -found[1] == pytest.approx(by_velocity, rel=1e-3, abs=1e-4)
    steps = np.hstack([found[0] * 2.0 * np.pi / 4096.0, found[1] * VELOCITY_UNIT_RAD_PER_S])
    rms = np.sqrt((steps**2).sum(axis=1) / 12.0).max()
    assert shaking.torque_Nm(offline.gains, None) == pytest.approx(rms, rel=1e-9)


def test_torque_noise_through_the_observer_is_what_a_long_run_of_it_shows() -> None:
    shaking, cell, q = shaken()
    offline, seen, random = cell.offline(cell.arms[0]), observer.build(cell.file), np.random.default_rng(0)
    assert seen is not None
    by_angle, by_velocity = shaking.feedback(offline.gains)
    x, w = np.zeros((2, len(q), 200))
    still, torques = np.zeros_like(x), []
    for tick in range(300):
        read_q, read_dq = random.uniform(-0.5, 0.5, (2, *x.shape))
        x, w = seen.follow(x, w, still, still, read_q * 2.0 * np.pi / 4096.0, read_dq * VELOCITY_UNIT_RAD_PER_S)
        if tick > 100:
            torques.append(by_angle @ x + by_velocity @ w)
    rms = float(np.sqrt(np.mean(np.square(torques), axis=(0, 2))).max())
    assert shaking.torque_Nm(offline.gains, seen) == pytest.approx(rms, rel=0.02)
    assert shaking.torque_Nm(offline.gains, replace(seen, velocity_gain=3.0)) == np.inf


@pytest.mark.parametrize("form", [Form.RATIO, pytest.param(Form.RATE, marks=LONG)])
def test_the_proposal_settles_where_the_configured_gains_diverge(
    tuner: Tuner, proposed: Callable[[Form], Proposal], form: Form, tmp_path: Path
) -> None:
    """The plant's arms 30 % lighter than the agents believe, in every mass, inertia and rotor."""
    better = proposed(form).after.cell
    assert not settles(simulate(with_true_arms(tuner.cell, tmp_path, inertia=0.7), 1.4, agents_cell=tuner.cell))
    for inertia in (0.7, 1.0, 1.3):
        assert settles(simulate(with_true_arms(better, tmp_path, inertia=inertia), 1.4, agents_cell=better))


FEW = Margin(worst=0.98)


@pytest.fixture(scope="module")
def robust() -> Proposal:
    """A short search, which finds less than a whole one and keeps the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stiffest, "TRIES", 100)
        return Tuner(load_cell(PAPER)).propose(Form.REALITY, FEW)


def test_gains_for_reality_are_stable_in_all_of_it_and_no_noisier(robust: Proposal) -> None:
    found = examine(cell_from_toml(robust.toml().encode(), "again"), thorough=True)
    assert found.robustness is not None
    assert robust.before.criterion.radius > 1.5
    assert found.robustness.criterion.radius < 0.99  # at other places of the trajectory than those of the search
    assert robust.after.criterion.radius <= 0.98 + 1e-6
    assert robust.after.criterion.radius > 0.96  # and not more timid than asked
    assert max(robust.after.noise_Nm) <= 1.02 * max(robust.before.noise_Nm)  # at the place where it is largest
    gains = robust.after.gains
    assert gains.k_v[3] < 0.3 < gains.k_v[0]


def test_the_observer_is_searched_too_and_forgets_as_fast_as_the_residual_of_noticing(robust: Proposal) -> None:
    changed = {c.key: c.toml for c in robust.changes if c.table == "controller.observer"}
    after, before = robust.after.observer, robust.before.observer
    assert after is not None
    assert before is not None
    assert changed == {key: repr(getattr(after, key)) for key in OBSERVER_KEYS}
    assert all(getattr(after, key) != getattr(before, key) for key in OBSERVER_KEYS)
    assert forgetting(after) <= math.exp(-30.0 / 200.0)
    assert tomllib.loads(toml_lines(robust))["controller"]["observer"] == {k: float(v) for k, v in changed.items()}
    rows = list(tune_table(robust.before, [robust]).columns[0].cells)
    assert [row for row in rows if str(row).startswith("observer")] == [f"observer, {key}" for key in OBSERVER_KEYS]


WX200, AT_REST = Path("two_wx200"), "trajectory.p_amplitude_m=[0.0, 0.0, 0.0]"
UNSTABLE = {
    "k_p": ("controller.k_p_per_s=1000.0",),
    "no limit": ("controller.k_p_per_s=1e5",),
    "turns": ("arms.left.k_v_Nm_s_per_rad=6.0", "arms.right.k_v_Nm_s_per_rad=6.0"),
    "observer": ("controller.observer.velocity_from_position_per_s=5000.0",),
}
SOFT = tuple(f"arms.{arm}.{k}" for arm in ("left", "right") for k in ("k_v_N_s_per_m=1e-3", "k_v_Nm_s_per_rad=1e-4"))
USELESS = UNSTABLE | {"friction alone": SOFT}


@pytest.fixture(scope="module")
def shortly() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stiffest, "TRIES", 150)
        yield


@cache
def usual_proposal() -> Proposal:
    """For a cell with the usual gains, at rest."""
    u, arms = PLANAR, ("left", "right")
    law = {"k_p_per_s": u.k_p, "k_eps_rad_per_s": u.k_eps, "k_p_rate_per_s": u.k_p_rate}
    law |= {"k_eps_rate_rad_per_s": u.k_eps_rate} | {f"observer.{key}": getattr(u, key) for key in OBSERVER_KEYS}
    k_v = {"k_v_N_s_per_m": u.k_v, "k_v_Nm_s_per_rad": u.k_v_turn}
    changes = [f"controller.{key}={value}" for key, value in law.items()]
    changes += [f"arms.{arm}.{key}={value}" for arm in arms for key, value in k_v.items()]
    return Tuner(load_cell(WX200, [*changes, AT_REST])).propose(Form.REALITY, FEW)


@pytest.mark.parametrize("wrong", few(USELESS, ("k_p", "observer", "friction alone").__contains__))
def test_useless_gains_say_nothing_of_the_noise_that_is_wanted_nor_of_what_is_found(wrong: str, shortly: None) -> None:
    usual, found = usual_proposal(), Tuner(load_cell(WX200, [*USELESS[wrong], AT_REST])).propose(Form.REALITY, FEW)
    assert found.from_usual
    assert (found.before.criterion.radius >= 1.0) is (wrong in UNSTABLE)
    proposed = cell_from_toml(found.toml().encode(), "again")
    assert all(proposed.offline(arm).gains == usual.after.gains for arm in proposed.arms)
    assert observer.build(proposed.file) == usual.after.observer
    assert max(found.after.noise_Nm) <= 1.001 * max(usual.before.noise_Nm)


def test_the_search_begins_with_the_configured_gains_where_they_are_stable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stiffest, "TRIES", 20)
    found = Tuner(load_cell(WX200, [AT_REST])).propose(Form.REALITY, Margin(worst=0.998))
    assert found.before.criterion.radius < 1.0
    assert not found.from_usual
    assert max(found.after.noise_Nm) <= 1.001 * max(found.before.noise_Nm)


@pytest.mark.parametrize("key", ["gamma", "gamma_object"])
def test_adaptation_gains_that_are_too_large_beside_new_ones_are_lowered_with_them(
    key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stiffest, "TRIES", 20)
    wide = Margin(worst=0.9999)
    fast = load_cell(Path("paper_adaptive"), [f"controller.adaptive.{key}=1e3"])
    found = Tuner(fast).propose(Form.REALITY, wide)
    (change,) = (c for c in found.changes if c.table == "controller.adaptive")
    told = {f.what: f for f in examine(cell_from_toml(found.toml().encode(), "again")).findings}
    assert (change.key, told[key].verdict) == (key, Verdict.OK)
    assert float(change.toml) > 0.5 * float(told[key].wanted.removeprefix("≤ ")), "and by no more than is needed"
    slow = Tuner(load_cell(Path("paper_adaptive"))).propose(Form.REALITY, wide)
    assert not [c for c in slow.changes if c.table == "controller.adaptive"]


def test_a_delay_of_more_cycles_than_are_looked_at_is_told_with_how_much_is_enough(shortly: None) -> None:
    with pytest.raises(NoGains) as caught:
        Tuner(load_cell(WX200, [AT_REST, "tolerance.delay=[0.8, 10.0]"])).propose(Form.REALITY, FEW)
    assert "found a delay of up to 10 cycles, for which none are looked for, expected at most 3" in str(caught.value)
    assert "tolerance.delay = [0.8, 3] is enough" in str(caught.value)


def test_without_an_observer_nothing_of_it_is_proposed() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stiffest, "TRIES", 10)
        patch.setattr(stiffest, "ROUNDS", 1)
        tuner = Tuner(load_cell(PAPER, ['controller.velocity="servo"']))
        proposal = tuner.propose(Form.REALITY, Margin(worst=1.7))
    assert proposal.changes
    assert all(c.table in ("controller", "arms") for c in proposal.changes)
    assert proposal.after.observer is None
    assert not [row for row in tune_table(proposal.before, [proposal]).columns[0].cells if "observer" in str(row)]


def test_the_same_cell_is_searched_in_the_same_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stiffest, "TRIES", 6)
    monkeypatch.setattr(stiffest, "ROUNDS", 1)
    cell = load_cell(PAPER)
    loop, ranges, wanted = loop_of(cell), ranges_of(cell), Wanted(1.2, lambda _: 0.0)
    one, two = (Search(Tuner(cell)._poses[:2], loop, ranges, wanted).run() for _ in range(2))
    assert one.scale == two.scale != Scale()


def test_an_observer_forgets_by_its_slowest_error() -> None:
    slow = Observer(0.005, position_gain=0.01, velocity_from_position_per_s=0.7, velocity_gain=0.15, delay_periods=1.0)
    error = np.array([1.0, 0.0])
    for _ in range(200):
        last = error
        x, w = slow.follow(error[:1], error[1:], *np.zeros((4, 1)))
        error = np.array([x[0], w[0]])
    assert forgetting(slow) == pytest.approx(float(np.linalg.norm(error) / np.linalg.norm(last)), rel=1e-3)
    assert forgetting(None) == 0.0


def test_shares_of_a_scaled_observer_end_at_one_its_slope_at_a_thousand_and_nothing_stays_nothing() -> None:
    own = Observer(0.005, position_gain=0.2, velocity_from_position_per_s=5.0, velocity_gain=0.22, delay_periods=1.0)
    large = Scale(position_gain=9.0, velocity_gain=9.0, velocity_from_position=1e4).of_observer(own)
    assert large == replace(own, position_gain=1.0, velocity_gain=1.0, velocity_from_position_per_s=1e3)
    small = Scale(position_gain=0.1239, velocity_gain=0.5).of_observer(replace(own, velocity_from_position_per_s=0.0))
    assert small == replace(own, position_gain=0.0247, velocity_gain=0.11, velocity_from_position_per_s=0.0)
    assert Scale().of_observer(own) == own


def test_noise_and_a_slow_observer_are_missed_like_a_radius() -> None:
    loop = loop_of(load_cell(PAPER))
    assert loop.observer is not None
    own = forgetting(loop.observer)
    for wanted, excess, of in (
        (Wanted(1.0, lambda _: 2.0, 1.0), 0.1, "noise"),
        (Wanted(1.0, lambda _: 0.5, 0.5 * own), 1.0, "observer"),
    ):
        assert wanted.missed(loop) == (pytest.approx(excess), of)
    assert Wanted(1.0, lambda _: 1.0, own).missed(loop).excess <= 0.0


@pytest.mark.parametrize(
    ("stated", "key"),
    [
        ("safety.inertia_error=0.97", "safety.inertia_error"),
        pytest.param("tolerance.masses=0.9", "tolerance.masses", marks=pytest.mark.long),
    ],
)
def test_when_nothing_survives_the_demand_and_the_tolerance_that_bind_are_named(
    stated: str, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, count in (("TRIES", 30), ("STARTS", 1), ("SHORT", 30)):
        monkeypatch.setattr(stiffest, name, count)
    with pytest.raises(NoGains) as caught:
        Tuner(load_cell(PAPER, [stated])).propose(Form.REALITY, Margin(worst=0.97))
    text = str(caught.value)
    assert "found none; the nearest have a radius of " in text
    assert "expected at most 0.97 whatever of the stated tolerance is true, and no more noise; " in text
    assert key in text.partition("; ")[2]
    assert re.search(r"radius of \d\.\d{4} \((arm alone|cell)[ a-z]*\) and \d+\.\d\d times the torque noise", text)
    assert "\n" not in text
