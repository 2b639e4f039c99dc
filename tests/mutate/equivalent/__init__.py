"""Changes that change nothing a test could see, each with the reason; whoever adds one has tried to write the test."""

from __future__ import annotations

from collections.abc import Sequence

from tests.mutate.equivalent.checks import CHECKS
from tests.mutate.equivalent.control import CONTROL
from tests.mutate.equivalent.driver import DRIVER
from tests.mutate.equivalent.logs import LOGS
from tests.mutate.equivalent.operator import OPERATOR
from tests.mutate.equivalent.view import VIEW
from tests.mutate.mutants import Mutant

EQUIVALENT = {**CONTROL, **CHECKS, **LOGS, **DRIVER, **OPERATOR, **VIEW}


def why_equivalent(mutant: Mutant) -> str:
    """The reason, or nothing."""
    return EQUIVALENT.get(mutant.module, {}).get(mutant.key, "")


def unused_entries(module: str, mutants: Sequence[Mutant]) -> list[str]:
    """Entries that are no change to the module any more."""
    keys = {mutant.key for mutant in mutants}
    return [f"equivalent names no change: {key}" for key in EQUIVALENT.get(module, {}) if key not in keys]
