"""Layouts as a log's own schema describes them: ours come back, others are read by name or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

import configs
from agent.config.cell import load_cell
from agent.log.layout import differences, parse
from agent.log.read import LogError, open_log, read_log
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE, Field, Layout
from tests.support.telemetry.run_log import write_other_release
from tests.support.telemetry.telemetry_cell import make_rows

STATE = "coop_msgs/msg/AgentState"
ODD = [f for f in AGENT_STATE.fields if f.name not in ("shift", "tau_sent")]


@pytest.mark.parametrize(("name", "own"), [(STATE, AGENT_STATE), ("coop_msgs/msg/PlantState", PLANT_STATE)])
def test_the_layout_of_this_release_is_itself(name: str, own: Layout) -> None:
    assert parse(name, own.definition) is own


def test_every_field_comes_back_with_its_type_length_unit_and_words() -> None:
    written = Layout(AGENT_STATE.ros_name, tuple(ODD))
    found = parse(STATE, written.definition)
    assert found is not None
    assert found.fields == written.fields
    assert found.dtype == written.dtype


@pytest.mark.parametrize(
    "definition",
    [
        "",
        "string name",
        "float64[] q",
        "float64 q\nfloat64 q",
        "uint32 a\nfloat64 b\n",
        "float64 encapsulation",
        "int8 a",
    ],
    ids=["empty", "text", "any length", "twice", "not aligned", "our word", "another number"],
)
def test_what_has_no_constant_layout_is_not_read(definition: str) -> None:
    assert parse(STATE, definition) is None


def test_a_schema_of_somebody_else_is_not_read() -> None:
    assert parse("sensor_msgs/msg/JointState", "float64 a") is None


def test_differences_are_named_from_the_side_of_this_release() -> None:
    longer = Field("memory", "float64", 51, "", "")
    theirs = [*(f for f in ODD if f.name != "memory"), longer, Field("old", "float64", 0, "", "")]
    assert differences(theirs, AGENT_STATE.fields) == "without memory, shift, tau_sent, with another memory, old"
    assert differences(AGENT_STATE.fields, AGENT_STATE.fields) == ""


def test_rows_of_another_release_are_read_by_name_where_they_are_asked_for(tmp_path: Path) -> None:
    cell, rows = load_cell(configs.CELLS_DIR / "paper.toml"), make_rows("left", 50)
    path = write_other_release(tmp_path / "run.mcap", cell, {"left": rows}, without=("shift",), memory=51)
    with open_log(path, any_layout=True) as log:
        own = log.agents["left"]
        assert own["q"].tobytes() == rows["q"].tobytes()
        assert own["memory"].tobytes() == rows["memory"][:, :51].tobytes()
        with pytest.raises(KeyError):
            own["shift"]
    found = r"found .*AgentState without memory, shift, with another memory, of release 0\.0\.7, expected"
    with pytest.raises(LogError, match=found):
        read_log(path)
