"""What statics say of an arm that fails, against weights worked out by hand and against the plant."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import tomli_w

import configs
from agent.config.cell import Arm, Cell, cell_from_toml, load_cell, placement
from agent.config.schema.fault import Fault, FaultKind
from agent.control.quaternion import Quat
from agent.study.lab import Laboratory, Run
from agent.verify.check import reach, start_configurations
from agent.verify.support import HELD_SAG_M, Fate, Statics, Support
from tests.support.arm_files import sticking, with_figures
from tests.support.control.criterion_cells import gentle
from tests.support.control.level_wx200 import LEVEL
from tests.support.few import few
from tests.support.plant.limp import sag_of_limp

NOTICED = "safety.noticing.enabled=true"
HOLDS_DESIRED = "controller.alignment.track_per_s=0.0"  # an arm without alignment holds where it has sagged to


def without(cell: Cell, arm: int, *instants: float) -> Support:
    models = [cell.model(a) for a in cell.arms]
    q, along = list(start_configurations(cell, models)), []
    for t in instants:
        desired = cell.trajectory().at(t)
        T = placement(desired.p, desired.quat)
        q = [reach(a, m, T, q_i, "") for a, m, q_i in zip(cell.arms, models, q, strict=True)]
        along.append(q)
    return Statics(cell, models, along, instants).without(arm)


def two_of_three() -> Cell:
    """Two arms with six joints, which share the load equally."""
    document = tomllib.loads((configs.CELLS_DIR / "three_wx250s.toml").read_text())
    document["arms"] = [arm | {"load_share": 0.5} for arm in document["arms"][:2]]
    return cell_from_toml(tomli_w.dumps(document).encode(), "two.toml")


def squeezed(force_N: float) -> tuple[str, ...]:
    """What two arms are to press by towards each other."""
    along = {"left": force_N, "right": -force_N}
    return tuple(f"arms.{arm}.internal_wrench_N_Nm=[{f}, 0.0, 0.0, 0.0, 0.0, 0.0]" for arm, f in along.items())


@pytest.mark.parametrize(
    ("name", "limp", "at_s"),
    [
        pytest.param("paper", 0, 5.0, marks=pytest.mark.long),
        pytest.param("paper", 1, 0.5, marks=pytest.mark.long),
        ("two_wx200", 1, 5.0),
        pytest.param("level", 0, 5.0, marks=pytest.mark.long),
        pytest.param("level", 1, 5.0, marks=pytest.mark.long),
        ("two_models", 1, 0.5),
        ("squeezed", 1, 3.0),
    ],
)
@pytest.mark.fault("F1")
def test_the_plant_holds_what_statics_hold_and_drops_what_they_drop(name: str, limp: int, at_s: float) -> None:
    of_name = {"level": ("two_wx200", *LEVEL), "squeezed": ("two_wx200", *squeezed(6.0))}
    cell = gentle(*of_name.get(name, (name,)), HOLDS_DESIRED)
    predicted, simulated = without(cell, limp, at_s).sag_m, sag_of_limp(cell, limp, at_s)
    if math.isfinite(predicted):
        assert 0.8 * predicted < simulated < predicted + 5e-3  # it comes with a swing
    else:
        assert simulated > 2.0 * HELD_SAG_M


def test_shares_of_stall_are_those_of_an_independent_prototype() -> None:
    along = np.linspace(0.0, 15.0, 16).tolist()
    assert without(gentle("paper"), 0, *along).limp.most.share == pytest.approx(0.51, abs=0.01)
    assert without(gentle("two_wx200", *LEVEL), 0, *along).limp.most.share == pytest.approx(0.81, abs=0.01)
    assert without(gentle("two_models"), 1, *along).limp.most.share == pytest.approx(1.03, abs=0.01)


def test_one_survivor_carries_both_weights() -> None:
    """With one survivor torques follow from weights alone: τ = g + Jᵀ (W_O + J_l⁻ᵀ g_l), whatever the gains."""
    cell = gentle("paper")
    models = [cell.model(a) for a in cell.arms]
    q, P = start_configurations(cell, models), models[0].task_basis
    weight = P @ np.array([*(-cell.file.object.mass_kg * cell.gravity), 0.0, 0.0, 0.0])
    J, g = [], []
    for model, q_i in zip(models, q, strict=True):
        J.append(P @ model.task_basis.T @ model.jacobian(q_i))
        g.append(model.evaluate(q_i, np.zeros(3)).g)
    expected = g[0] + J[0].T @ (weight + np.linalg.solve(J[1].T, g[1]))
    found = Statics(cell, models, [q], [0.0]).without(1)
    share = np.abs(expected) / cell.arms[0].tau_stall_Nm
    assert found.limp.most.share == pytest.approx(share.max(), abs=1e-3)
    assert (found.limp.most.arm, found.limp.most.joint, found.limp.most.place) == (0, int(share.argmax()), 0)


def test_a_joint_that_needs_no_torque_takes_part_in_the_balance() -> None:
    """Arms whose waists bear nothing at all, as of many a symmetric cell: they stiffen the object all the same."""
    cell, q = two_of_three(), np.array([0.0, 0.3, -0.3, 0.0, 0.5, 0.0])
    models = [cell.model(a) for a in cell.arms]
    weight = np.array([*(-cell.file.object.mass_kg * cell.gravity), 0.0, 0.0, 0.0])
    J, g = [model.jacobian(q) for model in models], [model.evaluate(q, np.zeros(6)).g for model in models]
    believed = g[0] + J[0].T @ (0.5 * weight)
    assert believed[0] == 0.0
    expected = np.abs(g[0] + J[0].T @ (weight + np.linalg.solve(J[1].T, g[1]))) / cell.arms[0].tau_stall_Nm
    found = Statics(cell, models, [[q, q]], [0.0]).without(1)
    assert found.limp.most.share == pytest.approx(expected.max(), abs=1e-3)
    assert found.limp.most.joint == int(expected.argmax())


EXACT = (
    "tolerance.masses=0.0", "tolerance.object=0.0", "tolerance.torque_constant=0.0", "tolerance.friction=[1.0, 1.0]",
)  # fmt: skip


def test_held_is_only_what_motors_alone_hold_at_every_stated_error() -> None:
    assert without(gentle("two_wx200"), 0, 0.5).fate is Fate.HELD
    assert without(gentle("two_wx200", "object.mass_kg=0.186"), 0, 0.5).fate is Fate.MAY_FALL
    assert without(gentle("two_wx200", "object.mass_kg=0.186", *EXACT), 0, 0.5).fate is Fate.HELD
    assert without(gentle("two_wx200", *LEVEL, "object.mass_kg=2.0"), 0, 0.5).fate is Fate.NOT_HELD


@pytest.mark.parametrize("cell", [("paper",), ("two_wx200", "object.mass_kg=0.31")])
def test_what_friction_alone_holds_may_fall_however_well_it_is_known(cell: tuple[str, ...]) -> None:
    found = without(gentle(*cell, *EXACT), 0, 5.0)
    assert found.limp.most.share > gentle(*cell).file.safety.tau_max_fraction_of_stall
    assert found.sag_m < HELD_SAG_M < found.crept_m == math.inf
    assert found.fate is Fate.MAY_FALL


def test_where_motors_bear_it_joints_creep_as_far_as_they_let_them() -> None:
    found = without(gentle("two_wx200"), 0, 5.0)
    assert found.sag_m + 1e-3 < found.crept_m < HELD_SAG_M
    without_any = without(gentle("two_wx200", *EXACT, "tolerance.friction=[0.0, 1.0]"), 0, 5.0)
    assert without_any.crept_m == pytest.approx(found.crept_m)


def test_the_plant_sags_by_what_statics_say_of_joints_that_stick(tmp_path: Path) -> None:
    believed = gentle("paper", HOLDS_DESIRED)
    cell = with_figures(believed, tmp_path / "arms", sticking)
    predicted, simulated = without(cell, 1, 5.0).sag_m, sag_of_limp(cell, 1, 5.0)
    assert 0.8 * predicted < simulated < predicted + 5e-3
    assert predicted < without(believed, 1, 5.0).sag_m - 3e-3


@pytest.mark.parametrize(
    "figures",
    [
        {"breakaway_Nm": 0.3, "stribeck_rad_per_s": 1.0},
        {"load_friction": 0.2},
        {"breakaway_load_friction": 0.2, "stribeck_rad_per_s": 1.0},
    ],
    ids=["breakaway", "load", "breakaway load"],
)
def test_what_joints_at_rest_may_resist_by_is_not_called_not_held_nor_counted_on(
    figures: dict[str, float], tmp_path: Path
) -> None:
    cell = gentle("two_wx200", *LEVEL, "object.mass_kg=0.8", "controller.friction_feedforward=false")
    assert without(cell, 0, 0.5).fate is Fate.NOT_HELD
    assert without(with_figures(cell, tmp_path / "arms", lambda _: figures), 0, 0.5).fate is Fate.MAY_FALL


def test_friction_that_the_cell_states_and_no_file_has_is_not_called_not_held_either() -> None:
    stated = ("tolerance.breakaway=3.0", "tolerance.load_friction=0.2")
    plain, rubs = (
        gentle("two_wx200", *LEVEL, "object.mass_kg=0.8", "controller.friction_feedforward=false", *more)
        for more in ((), stated)
    )
    assert (without(plain, 0, 0.5).fate, without(rubs, 0, 0.5).fate) == (Fate.NOT_HELD, Fate.MAY_FALL)


def test_a_breakaway_that_alone_holds_the_object_is_not_counted_on_once_it_moves(tmp_path: Path) -> None:
    cell = gentle("two_wx200", *LEVEL, "object.mass_kg=0.8", "controller.friction_feedforward=false")
    figures = {"breakaway_Nm": 1.0, "stribeck_rad_per_s": 1.0}
    found = without(with_figures(cell, tmp_path / "arms", lambda _: figures), 0, 0.5)
    assert found.sag_m < 1e-3
    assert found.fate is Fate.MAY_FALL


def test_a_limp_arm_s_motors_press_on_no_gear_and_others_by_what_they_hold_or_may_give(tmp_path: Path) -> None:
    figures = {"coulomb_Nm": 0.0, "load_friction": 0.2}
    cell = with_figures(gentle("paper"), tmp_path / "arms", lambda _: figures)
    models = [cell.model(a) for a in cell.arms]
    statics = Statics(cell, models, [start_configurations(cell, models)], [0.0])
    arm, high = statics._arms[1], cell.tolerance.friction[1]
    assert not statics._rubbing(1, statics._best, limp=True).any()
    assert not statics._rubbing(1, statics._worst, limp=False).any()
    most = cell.file.safety.tau_max_fraction_of_stall * arm.stall
    np.testing.assert_allclose(statics._rubbing(1, statics._best, limp=False), [high * 0.2 * most])


def test_more_arms_share_the_weight_of_a_limp_one() -> None:
    three = without(gentle("three_wx250s", "object.mass_kg=0.4"), 0, 0.0)
    four = without(gentle("four_wx250s", "object.mass_kg=0.4"), 0, 0.0)
    assert three.fate is four.fate is Fate.HELD
    assert four.limp.most.share <= three.limp.most.share
    assert four.sag_m < three.sag_m < HELD_SAG_M


def test_a_locked_arm_is_pulled_harder_than_one_that_holds_and_none_at_rest() -> None:
    cell = gentle("paper", NOTICED)
    moving = without(cell, 0, *np.linspace(0.0, 15.0, 16).tolist())
    assert moving.locked.most.share > moving.holding.most.share > 0.1
    still = gentle("paper", NOTICED, "trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0")
    rest = without(still, 0, 3.0)
    assert rest.locked.most.share == pytest.approx(rest.holding.most.share)


WEIGHTLESS = (NOTICED, "world.gravity_m_per_s2=[0.0, 0.0, 0.0]", "controller.friction_feedforward=false")


AT_ONCE = ("safety.noticing.fast_N=1e-6", *WEIGHTLESS)  # whatever pulls is felt as soon as it may be


def gone(cell: Cell, t: float, after_s: float) -> tuple[np.ndarray, np.ndarray]:
    """By how much the motion goes on (6,) and how fast it is then (6,)."""
    now, later = (cell.trajectory().at(at) for at in (t, t + after_s))
    return np.concatenate([np.subtract(later.p, now.p), turned(now.quat, later.quat)]), np.array(later.v)


def turned(from_quat: Quat, to_quat: Quat) -> np.ndarray:
    a, b = (placement((0.0, 0.0, 0.0), quat).rotation for quat in (from_quat, to_quat))
    return pin.log3(b @ a.T)


def pull_of(cell: Cell, arm: Arm, J: np.ndarray, B: np.ndarray, way: np.ndarray, lacks: np.ndarray) -> np.ndarray:
    """What the law of an arm gives (m,) on its task rows for that way (6,) and velocity (6,) that the object lacks."""
    offline, P = cell.offline(arm), cell.model(arm).task_basis
    g, H = offline.gains, np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    still = (np.array(g.k_v) * [*g.k_p, *g.k_eps] + offline.load_share) * H * way + np.array(g.k_v) * lacks
    inertia = np.linalg.inv(J @ np.linalg.inv(B) @ J.T)
    return P @ still + inertia @ P @ (np.array([*g.k_p_rate, *g.k_eps_rate]) * H * lacks)


def placed_at(cell: Cell, arm: Arm, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Its Jacobian on its task rows and its inertia, with the object where it is to be."""
    desired, model = cell.trajectory().at(t), cell.model(arm)
    q = reach(arm, model, placement(desired.p, desired.quat), np.array(arm.entry.q_near_rad), "")
    return model.jacobian(q), model.inertia(q)


@pytest.mark.parametrize("squeeze_N", [0.0, 2.0])
def test_the_pull_at_a_locked_arm_is_the_law_on_the_way_until_it_is_noticed(squeeze_N: float) -> None:
    cell, t = gentle("paper", *AT_ONCE, *squeezed(squeeze_N)), 3.0
    arm = cell.arms[1]
    J, B = placed_at(cell, arm, t)
    way, lacks = gone(cell, t, 0.1)
    asked = np.reshape(cell.offline(arm).internal_wrench or np.zeros(6), (2, 3))
    squeeze = (asked @ placement((0.0, 0.0, 0.0), cell.trajectory().at(t).quat).rotation.T).ravel()  # in object axes
    expected = J.T @ (pull_of(cell, arm, J, B, way, lacks) + cell.model(arm).task_basis @ squeeze)
    found = without(cell, 0, t)
    assert found.locked.most.share == pytest.approx(np.abs(expected / arm.tau_stall_Nm).max(), rel=2e-3)
    assert found.locked_s == (0.1,)


@pytest.mark.parametrize(("name", "count"), [("paper", 2), ("three_wx250s", 3)])
def test_a_holding_arm_gives_way_by_its_part_of_the_stiffness(name: str, count: int) -> None:
    found = without(gentle(name, *AT_ONCE, "safety.noticing.brace_N=0.0"), 0, 3.0)
    assert found.holding.most.share == pytest.approx(found.locked.most.share / count, rel=0.01)


@pytest.mark.parametrize("brace_N", [0.0, 0.15, 0.3])
def test_one_that_braces_itself_asks_each_of_the_others_for_its_part_of_that_pull_along_the_motion(
    brace_N: float,
) -> None:
    cell, t = gentle("three_wx250s", *AT_ONCE, f"safety.noticing.brace_N={brace_N}"), 3.0
    v, (way, lacks) = np.array(cell.trajectory().at(t).v), gone(cell, t, 0.5)
    shares = []
    for arm in cell.arms[1:]:
        J, B = placed_at(cell, arm, t)
        given = pull_of(cell, arm, J, B, way / 3.0, lacks / 3.0)
        given[:3] += brace_N / 3.0 * v[:3] / np.linalg.norm(v[:3])
        shares.append(np.abs(J.T @ given) / arm.tau_stall_Nm)
    found = without(cell, 0, t)
    assert found.holding.most.share == pytest.approx(np.max(shares), rel=0.01)
    assert found.holding.most.share < found.locked.most.share


STAYING = [
    (name, at_s, kind)
    for name, at_s in (("two_wx200", 3.7), ("two_wx200", 4.2), ("three_wx250s", 7.0), ("paper_adaptive", 5.5))
    for kind in (FaultKind.LOCKED, FaultKind.HOLD)
]


@pytest.mark.parametrize(("name", "at_s", "kind"), few(STAYING, (STAYING[0], STAYING[7]).__contains__))
def test_what_the_plant_asks_of_the_others_until_they_notice_is_about_what_is_said(
    name: str, at_s: float, kind: FaultKind
) -> None:
    """Where the motion is slow, too, and they notice late: 0.1 s of it would be said to ask for 24 % of 31.

    Estimates learn the pull meanwhile: without that 13 % of 20.
    """
    cell = load_cell(Path(name), ["simulation.ready_s=1.2"])
    lab, fault = Laboratory(cell), Fault(kind=kind, arm=cell.arms[0].name, at_s=at_s)
    run, found = Run(lab, None, [fault]), without(cell, 0, at_s)
    while run.t < at_s:
        run.advance()
    run.peak_Nm[:] = 0.0
    while run.t < at_s + 1.5:
        run.advance()
    gave = float((run.peak_Nm / lab.stall_Nm)[cell.arms[0].n :].max())
    said = (found.locked if kind is FaultKind.LOCKED else found.holding).most.share
    assert gave - 0.02 < said < gave + 0.1
    assert {trip.arm for trip in run.trips} >= {arm.name for arm in cell.arms[1:]}, "they noticed"


@pytest.mark.parametrize(("name", "noticed_s"), [("paper", 0.1), ("three_wx250s", 0.5)])
def test_what_one_place_says_by_itself_is_what_it_says_among_others(name: str, noticed_s: float) -> None:
    cell = gentle(name, NOTICED)
    found = without(cell, 0, 0.5, 3.0)
    assert found.noticed_s == noticed_s
    for place, t in enumerate((0.5, 3.0)):
        alone = without(cell, 0, t)
        for fault in ("limp", "locked", "holding"):
            load, own = getattr(found, fault).along[place], getattr(alone, fault).most
            assert (load.share, load.arm, load.joint) == (pytest.approx(own.share, rel=5e-3), own.arm, own.joint)
            assert load.place == place
        assert found.sag_along_m[place] == pytest.approx(alone.sag_m, rel=0.05)
    assert found.limp.most == max(found.limp.along, key=lambda load: load.share)
    assert found.sag_m == max(found.sag_along_m)


UNNOTICED = (*WEIGHTLESS, "safety.noticing.enabled=false")


def test_unnoticed_the_others_pull_by_the_error_that_holds_them_at_an_arm_that_is_locked_or_holds() -> None:
    narrow = ("safety.tracking_error_max_m=0.01", "safety.tracking_error_max_rad=3.0")
    cell, at_s = gentle("paper", *UNNOTICED, *narrow, "trajectory.angle_rad=0.0"), 0.0
    desired, arm = cell.trajectory().at(at_s), cell.arms[1]
    model, offline, P = cell.model(arm), cell.offline(arm), cell.model(cell.arms[0]).task_basis
    q = reach(arm, model, placement(desired.p, desired.quat), np.array(arm.entry.q_near_rad), "")
    k = offline.gains.k_v[0] * offline.gains.k_p[0] + offline.load_share
    J = P @ model.task_basis.T @ model.jacobian(q)
    expected = np.abs(J.T @ P @ np.array([0.01 * k, 0.0, 0.0, 0.0, 0.0, 0.0])) / arm.tau_stall_Nm
    found = without(cell, 0, at_s)
    assert found.noticed_s is None
    assert found.locked.most.share == pytest.approx(expected.max(), rel=1e-3)
    assert found.holding.most.share == pytest.approx(expected.max(), rel=1e-3)


def test_unnoticed_they_pull_by_what_the_motion_goes_where_it_goes_less_than_that() -> None:
    short = ("trajectory.p_amplitude_m=[0.004, 0.0, 0.0]", "trajectory.angle_rad=0.0")
    once, twice = (without(gentle("paper", *UNNOTICED, *short), 0, t) for t in (0.0, 3.75))
    assert twice.locked.most.share == pytest.approx(2.0 * once.locked.most.share, rel=0.05)
    assert twice.holding.most.share == pytest.approx(0.5 * twice.locked.most.share, rel=0.01)


def test_unnoticed_three_reach_that_error_though_one_that_holds_gives_way() -> None:
    cell = gentle("three_wx250s", *UNNOTICED, "safety.tracking_error_max_m=0.001")
    found = without(cell, 0, 3.0)
    assert found.holding.most.share == pytest.approx(found.locked.most.share, rel=0.05)


def test_every_survivor_has_a_part_of_its_own_and_the_largest_is_that_of_the_fault() -> None:
    found = without(gentle("three_wx250s"), 1, 0.5, 8.0)
    for fault in (found.limp, found.locked, found.holding):
        assert [load.arm for load in fault.each] == [0, 2]
        assert fault.most in fault.each


def test_what_the_others_learn_of_an_arm_that_stays_is_pulled_by_too() -> None:
    """Without gains nothing is learnt; with a leak less stays than without."""
    quiet = ("controller.adaptive.gamma=0.0", "controller.adaptive.gamma_object=0.0")
    shares = []
    for own in (quiet, ("controller.adaptive.leak_per_s=4.0",), ("controller.adaptive.leak_per_s=0.0",)):
        shares.append(without(load_cell(Path("paper_adaptive"), own), 0, 5.5).holding.most.share)
    assert shares[0] + 0.03 < shares[1] < shares[2] - 0.05
    plain = without(load_cell(Path("paper_adaptive"), [*quiet, "controller.kind='known'"]), 0, 5.5)
    assert plain.holding.most.share == pytest.approx(shares[0], abs=0.01)


def test_estimates_learn_of_the_velocity_that_the_object_lacks_as_of_its_place() -> None:
    """With next to no position gain the former is all."""
    unfelt = [f"safety.noticing.{key}=99.0" for key in ("fast_N", "fast_Nm", "slow_N", "slow_Nm")]
    keys = ("k_p_per_s", "k_eps_rad_per_s", "k_p_rate_per_s", "k_eps_rate_rad_per_s")
    slack = (*unfelt, *(f"controller.{key}=0.1" for key in keys), "controller.adaptive.leak_per_s=0.0")
    none, much = (
        without(load_cell(Path("paper_adaptive"), [*slack, f"controller.adaptive.gamma={gamma}"]), 0, 9.0)
        for gamma in (0.0, 1.0)
    )
    assert much.locked.most.share > none.locked.most.share + 2.0
    assert much.locked_s == (math.inf,)


def test_however_it_braces_itself_it_asks_for_no_more_than_a_locked_one() -> None:
    straight = "trajectory.points=[{t_s=0.0, p_m=[0.0, 0.0, 0.2]}, {t_s=6.0, p_m=[0.03, 0.02, 0.22]}]"
    found = without(gentle("three_wx250s", *AT_ONCE, straight, "safety.noticing.brace_N=20.0"), 0, 3.0)
    assert found.holding.most.share == pytest.approx(found.locked.most.share, rel=0.01)
    still = without(gentle("three_wx250s", *AT_ONCE, straight, "safety.noticing.brace_N=20.0"), 0, 10.0)
    assert still.holding.most.share == pytest.approx(0.0, abs=1e-9), "at rest nobody carries it on"
    assert still.holding_s == (math.inf,)


@pytest.mark.parametrize(
    "wider",
    ["tolerance.masses=0.2", "tolerance.object=0.9", "tolerance.torque_constant=0.2", "arms.right.k_v_N_s_per_m=0.2"],
)
def test_every_stated_error_and_a_soft_law_may_cost_the_object(wider: str) -> None:
    heavy = ("object.mass_kg=0.17", *EXACT)
    assert without(gentle("two_wx200", *heavy), 0, 5.0).fate is Fate.HELD
    assert without(gentle("two_wx200", *heavy, wider), 0, 5.0).fate is Fate.MAY_FALL


def test_what_holds_as_the_files_say_is_never_called_not_held() -> None:
    for name in ("paper", "two_models"):
        for arm in (0, 1):
            found = without(gentle(name), arm, *np.linspace(0.0, 15.0, 31).tolist())
            assert found.sag_m > HELD_SAG_M or found.fate is not Fate.NOT_HELD
