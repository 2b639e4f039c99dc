"""What a list of equivalent changes is."""

from __future__ import annotations

from collections.abc import Mapping

Key = tuple[str, str, str]  # where, first line of the statement before and after
Entries = Mapping[str, Mapping[Key, str]]  # module: the change: why no test could see it
