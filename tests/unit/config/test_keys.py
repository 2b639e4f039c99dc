"""`coop schema`, its page, and the files that ship: each key with its unit and what it changes, and nothing else."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import configs
from agent.config import keys
from agent.config.schema.cell import CellFile

ROOT = Path(__file__).parents[3]
SCHEMA_FILE = Path(configs.__file__).parent / "cell.schema.json"
CELLS = sorted(configs.CELLS_DIR.glob("*.toml"))
BARE = (  # numbers that have no unit
    "format", "e_eta_min", "sigma_min", "tau_step_max_fraction", "tau_max_fraction_of_stall", "spectral_radius_max",
    "friction_share", "speed_share", "power_share", "limited_share", "load_share",
    "gravity_times", "tau_share", "extra_cycles", "gripper_share_max",
    "inertia_error", "load_share", "position_gain", "velocity_gain", "gamma", "gamma_object", "mass", "first_moment",
    "inertia", "rotor_inertia", "viscous", "coulomb", "breakaway", "load", "start_scale", "relative_min",
    "relative_max", "substeps_per_cycle", "object_mass_error", "torque_constant_error",
    "damping_ratio", "masses", "object", "friction",
    "torque_constant", "pads_damping_ratio", "delay", "seed", "quat_start", "quat_world_base", "quat_object_ee",
    "quat_centre", "quat_from", "quat_to", "quat", "axis", "mark", "load_friction",
    "link_masses", "joint_friction",
)  # fmt: skip


def models(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    yield model
    for info in model.model_fields.values():
        yield from (m for inner in keys._inside(info.annotation) for m in models(inner))


def test_the_files_that_ship_are_what_the_schema_gives() -> None:
    assert json.loads(SCHEMA_FILE.read_text()) == keys.json_schema(), "coop schema > configs/cell.schema.json"
    assert (ROOT / "docs/cell.md").read_text() == keys.page(), "coop schema --page > docs/cell.md"


def test_the_page_names_every_key_of_the_schema() -> None:
    page = keys.page()
    for model in set(models(CellFile)):
        for name in model.model_fields:
            assert f"| `{name}` |" in page, f"{model.__name__}.{name}"


def test_every_key_says_what_it_changes_and_numbers_have_a_unit() -> None:
    for key in keys.all_keys():
        assert len(key.text) > 6, key
        assert key.text.endswith("."), key
        if re.search(r"\bnumber\b", key.kind):
            assert bool(key.unit) != (key.name in BARE), key


@pytest.mark.parametrize(
    ("name", "unit"),
    [("k_v_N_s_per_m", "N·s/m"), ("k_v_Nm_s_per_rad", "N·m·s/rad"), ("k_eps_rad_per_s", "rad/s"), ("xx", "kg·m²"),
     ("gravity_m_per_s2", "m/s²"), ("grip_force_max_N", "N"), ("slip_Nm", "N·m"), ("rate_hz", "Hz"), ("name", "")],
)  # fmt: skip
def test_units_stand_in_names(name: str, unit: str) -> None:
    assert keys.unit_of(name) == unit


def test_ranges_and_defaults_are_those_of_the_schema() -> None:
    by_name = {(k.table, k.name): k for k in keys.all_keys()}
    assert by_name["[object]", "mass_kg"].kind == "number ≥ 1e-06 ≤ 100"
    assert by_name["[object]", "mass_kg"].default == "needed"
    assert by_name["[controller.alignment]", "dead_zone_m"].default == "`0.0015`"
    assert by_name["[[simulation.push]]", "at_s"].default == "needed"
    assert by_name["[simulation.reality.arms.NAME]", "masses"].default == "`1.0`"
    assert by_name["[controller]", "k_p_per_s"].kind.count("number") == 2


@pytest.mark.parametrize("path", CELLS, ids=lambda p: p.stem)
def test_shipped_cells_name_the_schema_and_fit_it(path: Path) -> None:
    first = path.read_text().splitlines()[0]
    assert first.startswith("#:schema ")
    assert (path.parent / first.split()[1]).resolve() == SCHEMA_FILE.resolve()
    fits(tomllib.loads(path.read_text()), keys.json_schema())


def fits(node: Any, schema: dict[str, Any]) -> None:
    """What an editor would find: unknown and missing keys, types and lengths."""
    if "$ref" in schema:
        schema = keys.json_schema()["$defs"][schema["$ref"].rsplit("/", 1)[1]] | {
            k: v for k, v in schema.items() if k != "$ref"
        }
    if "oneOf" in schema:
        schema = keys.json_schema()["$defs"][schema["discriminator"]["mapping"][node["kind"]].rsplit("/", 1)[1]]
    if "anyOf" in schema:
        kinds = [option for option in schema["anyOf"] if option.get("type") == _type(node) or "$ref" in option]
        assert kinds, (node, schema)
        schema = kinds[0]
    assert schema.get("type", _type(node)) in {_type(node), "number" if isinstance(node, int) else None}, (node, schema)
    if isinstance(node, dict) and "properties" in schema:
        assert set(node) <= set(schema["properties"])
        assert set(schema.get("required", ())) <= set(node)
        for key, value in node.items():
            fits(value, schema["properties"][key])
    if isinstance(node, list):
        assert schema.get("minItems", 0) <= len(node) <= schema.get("maxItems", 10**6)
        for value in node:
            fits(value, schema.get("items", {}))


def _type(node: Any) -> str:
    kinds = {bool: "boolean", int: "integer", float: "number", str: "string", list: "array", dict: "object"}
    return kinds[type(node)]
