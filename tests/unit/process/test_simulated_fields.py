"""What a cell file may say of a simulated cell, and what the simulator is told, have the same keys and the same meaning
where nothing is said; the one is of the agents' side, the other of the simulator's, which knows nothing of theirs.
"""

from __future__ import annotations

from dataclasses import MISSING, Field, fields
from typing import Any

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from agent.config.schema import reality as schema
from agent.config.schema.simulation import Grasp
from sim_backend.physics import reality as simulator
from sim_backend.physics.spec import GraspSpec

PAIRS = [(schema.Reality, simulator.Reality), (schema.ArmReality, simulator.ArmReality), (Grasp, GraspSpec)]
OF_THE_FILE = {"Reality": {"seed"}}  # drawn from before the simulator is told anything


def told(key: Field[Any]) -> Any:
    return key.default_factory() if key.default_factory is not MISSING else key.default


def unsaid(key: FieldInfo) -> Any:
    return MISSING if key.is_required() else key.get_default(call_default_factory=True, validated_data={})


@pytest.mark.parametrize(("of_file", "of_simulator"), PAIRS)
def test_a_key_of_the_file_is_one_of_the_simulator_and_means_the_same_where_it_is_left_out(
    of_file: type[BaseModel], of_simulator: Any
) -> None:
    own = OF_THE_FILE.get(of_file.__name__, set())
    assert own <= set(of_file.model_fields)
    given = {name: unsaid(key) for name, key in of_file.model_fields.items() if name not in own}
    assert given == {key.name: told(key) for key in fields(of_simulator)}
