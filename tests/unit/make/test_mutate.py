"""What `make mutate` knows of the code is still so: a line that has changed is asked of its tests again."""

from __future__ import annotations

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.mutate.equivalent import EQUIVALENT
from tests.mutate.targets import TARGETS


@pytest.mark.parametrize("module", EQUIVALENT)
def test_a_change_that_nobody_could_see_is_one_of_a_line_that_is_there(module: str) -> None:
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    source = ast.unparse(ast.parse(Path(spec.origin).read_text()))
    lines = {line.strip().removeprefix("el") for line in source.splitlines()}  # a change looks at each `if` by itself
    gone = [before for _, before, _ in EQUIVALENT[module] if before.splitlines()[0] not in lines]
    assert not gone, "tests/mutate/equivalent names what is not there any more"


def test_every_module_with_such_a_change_is_changed() -> None:
    assert set(EQUIVALENT) <= {target.module for target in TARGETS}
