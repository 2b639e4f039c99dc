"""What a table holds that a cell leaves out is what a table with nothing in it is read as."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from agent.config.schema.cell import CellFile
from agent.config.schema.types import Strict


def tables(model: type[Strict]) -> Iterator[type[Strict]]:
    for field in model.model_fields.values():
        if isinstance(field.default, Strict):
            yield type(field.default)
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, Strict):
                yield from tables(kind)


LEFT_OUT = sorted(set(tables(CellFile)), key=lambda table: table.__name__)


@pytest.mark.parametrize("table", LEFT_OUT, ids=lambda table: table.__name__)
def test_a_table_that_is_left_out_is_one_without_keys(table: type[Strict]) -> None:
    assert table.default() == table.model_validate({})
    assert repr(table.default()) == repr(table.model_validate({}))
    assert table.default().model_dump(mode="json") == table.model_validate({}).model_dump(mode="json")


def test_there_are_some() -> None:
    assert {table.__name__ for table in LEFT_OUT} >= {"Safety", "Tolerance", "Simulation", "Effects", "ArmBounds"}
