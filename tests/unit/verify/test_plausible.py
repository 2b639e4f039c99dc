"""What may be meant but is more often a slip: warned of in the check's table, or refused where it cannot be."""

from __future__ import annotations

import pytest

import configs
from agent.config.cell import Cell, ConfigError, cell_from_toml, load_cell
from agent.verify.check import examine
from agent.verify.finding import Finding, Verdict
from agent.verify.plausible import plausibility

PAPER = configs.CELLS_DIR / "paper.toml"


def findings(*overrides: str) -> list[Finding]:
    return plausibility(load_cell(PAPER, overrides))


def warnings(cell: Cell) -> list[tuple[str, str, str]]:
    found = [f for f in plausibility(cell) if f.verdict is not Verdict.OK]
    assert all(f.verdict is Verdict.WARNING for f in found)
    return [(f.what, f.where, f.found) for f in found]


@pytest.mark.parametrize("path", sorted(configs.CELLS_DIR.glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_cells_give_no_warning(path: object) -> None:
    assert warnings(load_cell(path)) == []


@pytest.mark.parametrize(
    ("gravity", "direction", "tilt"),
    [
        ("[0.0, -9.81, 0.0]", "9.81 m/s² along −y", "0.0°"),
        ("[0.0, 9.81, 0.0]", "9.81 m/s² along +y", "180.0°"),
        ("[-9.81, 0.0, 0.0]", "9.81 m/s² along −x", "90.0°"),
        ("[0.0, -9.7, 1.0]", "9.751 m/s² along [0.000, -0.995, 0.103]", "5.9°"),
    ],
)
def test_direction_of_gravity_is_told_and_held_against_how_the_arms_stand(
    gravity: str, direction: str, tilt: str
) -> None:
    found = findings(f"world.gravity_m_per_s2={gravity}")
    assert next(f for f in found if f.what == "gravity").found == direction
    bases = [f for f in found if f.what == "base against gravity"]
    assert [(f.where, f.found) for f in bases] == [(arm, f"{tilt} from upright") for arm in ("left", "right")]
    assert {f.verdict for f in bases} == {Verdict.OK if tilt == "0.0°" else Verdict.WARNING}


@pytest.mark.parametrize(("driver", "verdict"), [("sim", Verdict.WARNING), ("dynamixel", Verdict.REFUSED)])
def test_without_gravity_only_simulated_arms_move(driver: str, verdict: Verdict) -> None:
    found = findings("world.gravity_m_per_s2=[0.0, 0.0, 0.0]", f"driver={driver}")
    assert next(f for f in found if f.what == "gravity").verdict is verdict


@pytest.mark.parametrize("gravity", [0.5, 0.981, 31.0, 98.1])
def test_gravity_of_another_unit_is_refused(gravity: float) -> None:
    with pytest.raises(ConfigError, match=r"world.gravity_m_per_s2 in .* expected 1 to 30 m/s² in all, or zero"):
        load_cell(PAPER, [f"world.gravity_m_per_s2=[0.0, {-gravity}, 0.0]"])


def test_the_least_object_that_a_cell_may_have_is_examined_to_the_end() -> None:
    """With 1e-100 kg, figures of the cell with soft grasps were infinite, and sides of 1e-120 m have no volume."""
    least = ["object.mass_kg=1e-6", "object.size_m=[1e-6, 1e-6, 1e-6]"]
    cell = load_cell(PAPER, [*least, "object.inertia_kg_m2={xx=1e-12, yy=1e-12, zz=1e-12}"])
    examine(cell, wired=True, thorough=True).require()
    less = {"object.mass_kg": 1e-7, "object.size_m": [0.1, 0.1, 1e-7], "object.inertia_kg_m2.xx": 1e-13}
    for key, value in less.items():
        with pytest.raises(ConfigError, match=rf"^{key}[.0-9]* in paper\.toml.*greater than or equal to 0\.0000"):
            load_cell(PAPER, [f"{key}={value}"])
    with pytest.raises(ConfigError, match=r"object\.inertia_kg_m2 in .*expected 1e-12 at least"):
        load_cell(PAPER, ["object.inertia_kg_m2={xx=1e-4, yy=1e-4, zz=2e-4, xy=0.99999999999999e-4}"])


@pytest.mark.parametrize(
    ("changes", "warned"),
    [
        (["object.mass_kg=1e-6"], ["density of the object's box", "inertia of the object"]),
        (
            ["object.mass_kg=2.6e-4", "object.inertia_kg_m2={xx=1e-9, yy=1e-9, zz=1e-9}"],
            ["density of the object's box"],
        ),
        (["object.mass_kg=2.7e-4", "object.inertia_kg_m2={xx=1e-9, yy=1e-9, zz=1e-9}"], []),
        (["object.mass_kg=6.5"], []),
        (["object.mass_kg=6.6"], ["density of the object's box"]),
        (["object.inertia_kg_m2={xx=5.0, yy=5.0, zz=5.0}"], ["inertia of the object"]),
        (["object.inertia_kg_m2={xx=6.8e-4, yy=6.8e-4, zz=6.8e-4}"], []),
        (["object.inertia_kg_m2={xx=7e-4, yy=6.8e-4, zz=6.8e-4}"], ["inertia of the object"]),
        (["object.inertia_kg_m2={xx=5e-4, yy=5e-4, zz=5e-4, xy=2.2e-4}"], ["inertia of the object"]),
    ],
)
def test_an_object_of_which_no_body_of_its_size_can_be_made_is_warned_of(changes: list[str], warned: list[str]) -> None:
    """62 g in a box of 135 by 44 by 44 mm: at most 3.4e-4 kg·m² in its corners, of which twice is let pass."""
    assert [what for what, _, _ in warnings(load_cell(PAPER, changes))] == warned


def test_what_is_wrong_with_the_object_is_told_with_what_a_solid_one_would_have() -> None:
    (found,) = (f for f in findings("object.inertia_kg_m2={xx=5, yy=5, zz=5}") if "object" in f.what)
    assert found.line == (
        "cell: inertia of the object: found up to 5 kg·m², wanted ≤ 0.000343 kg·m², all its mass in the corners of its "
        "box; correct object.inertia_kg_m2, mass_kg or size_m; a solid box of these has 2e-05, 0.000104, 0.000104 kg·m²"
    )
    (found,) = (f for f in findings("object.mass_kg=62") if "object" in f.what)
    assert found.line == (
        "cell: density of the object's box: found 2.37e+05 kg/m³, wanted 1 to 25000 kg/m³; correct object.mass_kg (kg) "
        "or object.size_m (m)"
    )


def test_an_arm_that_carries_nothing_is_allowed_by_the_paper_and_warned_of() -> None:
    cell = load_cell(PAPER, ["arms.left.load_share=1.0", "arms.right.load_share=0.0"])
    assert warnings(cell) == [("load share", "right", "0")]


@pytest.mark.parametrize(
    ("key", "value", "warned"),
    [
        ("tracking_error_max_m", 0.2, False),
        ("tracking_error_max_m", 0.21, True),
        ("tracking_error_max_rad", 1.0, False),
        ("tracking_error_max_rad", 1.1, True),
    ],
)
def test_a_guard_that_notices_nothing_is_warned_of(key: str, value: float, warned: bool) -> None:
    found = warnings(load_cell(PAPER, [f"safety.{key}={value}"]))
    assert found == ([(key, "cell", f"{value:g}")] if warned else [])


@pytest.mark.parametrize(("key", "value"), [("tracking_error_max_m", 1e9), ("tracking_error_max_rad", 3.2)])
def test_a_guard_that_cannot_be_meant_is_refused(key: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"safety.{key} in .*less than or equal to"):
        load_cell(PAPER, [f"safety.{key}={value}"])


def test_two_arms_on_one_port_are_warned_of_because_hosts_may_differ() -> None:
    cell = load_cell(PAPER, ['arms.right.dynamixel.port="/dev/coop/left"'])
    assert warnings(cell) == [("port", "left and right", "/dev/coop/left")]


ONE_PORT = 'arms.right.dynamixel.port="/dev/coop/left"'
REAL = "driver=dynamixel"


@pytest.mark.parametrize(
    ("left", "right", "more", "verdict"),
    [
        ("h1", "h1", [REAL], Verdict.REFUSED),
        ("h1", "h1", ['hil.arms=["left", "right"]'], Verdict.REFUSED),
        ("h1", "h1", ['hil.arms=["left"]'], Verdict.WARNING),
        ("h1", "h1", [], Verdict.WARNING),
        ("h1", None, [REAL], Verdict.WARNING),
        (None, None, [REAL], Verdict.WARNING),
        ("h1", "h2", [REAL], None),
        ("h1", "h2", [], None),
    ],
)
def test_two_arms_on_one_port_of_one_stated_host_are_refused_where_servos_move_them(
    left: str | None, right: str | None, more: list[str], verdict: Verdict | None
) -> None:
    hosts = [f"arms.{arm}.host={host}" for arm, host in (("left", left), ("right", right)) if host is not None]
    found = [f for f in findings(ONE_PORT, *hosts, *more) if f.what == "port"]
    assert [f.verdict for f in found] == ([] if verdict is None else [verdict])
    assert {(f.where, f.found) for f in found} <= {
        ("left and right", "/dev/coop/left" + (" on host h1" if verdict is Verdict.REFUSED else ""))
    }


def test_of_three_arms_on_one_port_those_of_one_host_are_named() -> None:
    ports = [f'arms.{arm}.dynamixel.port="/dev/coop/all"' for arm in ("left", "back", "front")]
    hosts = [f"arms.{arm}.host={host}" for arm, host in (("left", "h1"), ("back", "h2"), ("front", "h1"))]
    found = plausibility(load_cell(configs.CELLS_DIR / "three_wx250s.toml", [*ports, *hosts, REAL]))
    (port,) = [f for f in found if f.what == "port"]
    assert (port.verdict, port.where) == (Verdict.REFUSED, "left and front")


@pytest.mark.parametrize("port", ["", " ", "/dev/tty 1", "a\\u0000b", "\\u202e"])
def test_a_port_that_is_no_name_of_one_is_refused(port: str) -> None:
    with pytest.raises(ConfigError, match=r"arms\.right\.dynamixel\.port in"):
        load_cell(PAPER, [f'arms.right.dynamixel.port="{port}"'])


def test_servos_without_a_port_are_refused() -> None:
    text = PAPER.read_text().replace('dynamixel = { port = "/dev/coop/right" }', "")
    assert cell_from_toml(text.encode(), "paper.toml").arms[1].entry.dynamixel is None
    with pytest.raises(ConfigError, match="found no port of arm right"):
        cell_from_toml(text.replace('driver = "sim"', 'driver = "dynamixel"').encode(), "paper.toml")


BY_A_HAND = "duration_s=1.0, force_N=[0.0, 1.0, 0.0]"


def test_what_befalls_the_cell_behind_the_end_is_warned_of() -> None:
    changes = [
        "duration_s=20.0",
        "report.transient_s=5.0",
        f"simulation.push=[{{at_s=19.9, {BY_A_HAND}}}, {{at_s=20.0, {BY_A_HAND}}}]",
        "simulation.opening=[{at_s=25.0, arm='left'}]",
        "simulation.fault=[{kind='limp', at_s=19.9, arm='left'}, {kind='hold', at_s=20.0, arm='left'}]",
    ]
    found = warnings(load_cell(PAPER, changes))
    assert found == [
        (f"simulated {what}", "cell", f"at {at} s") for what, at in (("push", 20), ("opening", 25), ("fault", 20))
    ]


SIZES = {
    "grasp": ("arms.left.p_object_ee_m=[-0.06, 0.0, 0.08]", ("grasp beside the object", "left")),
    "gravity": ("world.gravity_m_per_s2=[0.0, -1.62, 0.0]", ("gravity", "cell")),
    "lower": ("session.lower_s=600.0", ("session.lower_s", "cell")),
    "lift": ("session.lift_s=61.0", ("session.lift_s", "cell")),
    "off": ("session.off_max_rad=1.01", ("session.off_max_rad", "cell")),
    "soft": ("session.soft_rad=0.25", ("session.soft_rad", "cell")),
    "no push": ("simulation.push=[{at_s=1.0, duration_s=1.0}]", ("simulated push", "cell")),
    "strong": ("simulation.push=[{at_s=1.0, duration_s=1.0, force_N=[0.0, 0.0, 1e4]}]", ("simulated push", "cell")),
    "turn": ("simulation.push=[{at_s=1.0, duration_s=1.0, moment_Nm=[0.0, 0.0, 21.0]}]", ("simulated push", "cell")),
    "transient": ("report.transient_s=1000.0", ("report.transient_s", "cell")),
    "faults": (
        'simulation.fault=[{kind="limp", arm="left", at_s=1.0}, {kind="locked", arm="left", at_s=1.0}]',
        ("simulated fault", "left"),
    ),
}


@pytest.mark.parametrize(("change", "expected"), SIZES.values(), ids=list(SIZES))
def test_what_nobody_means_is_warned_of_by_its_own_line(change: str, expected: tuple[str, str]) -> None:
    session = ("session.lift_m=0.01",) if change.startswith("session") else ()
    found = warnings(load_cell(PAPER, [*session, change]))
    assert [(what, where) for what, where, _ in found] == [expected]


@pytest.mark.parametrize(
    "change",
    [
        "arms.left.p_object_ee_m=[-0.06, 0.0, 0.0]",
        "world.gravity_m_per_s2=[0.0, -9.78, 0.0]",
        "session.lower_s=60.0",
        "session.soft_rad=0.24",
        "simulation.push=[{at_s=1.0, duration_s=1.0, force_N=[0.0, 0.0, 99.0]}]",
        "simulation.push=[{at_s=1.0, duration_s=1.0, moment_Nm=[0.0, 0.0, 19.0]}]",
        'simulation.fault=[{kind="limp", arm="left", at_s=1.0}, {kind="locked", arm="right", at_s=1.0}]',
        'simulation.fault=[{kind="limp", arm="left", at_s=1.0}, {kind="locked", arm="left", at_s=1.5}]',
    ],
)
def test_what_is_within_is_not_warned_of(change: str) -> None:
    assert warnings(load_cell(PAPER, [change])) == []
