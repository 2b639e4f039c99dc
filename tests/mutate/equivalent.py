"""Changes that change nothing a test could see, each with the reason; whoever adds one has tried to write the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tests.mutate.mutants import Mutant

Key = tuple[str, str, str]  # where, first line of the statement before and after

EQUIVALENT: Mapping[str, Mapping[Key, str]] = {}


def why_equivalent(mutant: Mutant) -> str:
    """The reason, or nothing."""
    return EQUIVALENT.get(mutant.module, {}).get(mutant.key, "")


def unused_entries(module: str, mutants: Sequence[Mutant]) -> list[str]:
    """Entries that are no change to the module any more."""
    keys = {mutant.key for mutant in mutants}
    return [f"equivalent.py names no change: {key}" for key in EQUIVALENT.get(module, {}) if key not in keys]
