"""The commands of the ladder in docs/hil.md, as they stand there."""

from __future__ import annotations

import re
from typing import Final

from tests.support.documents import ROOT

_PAGE: Final = (ROOT / "docs/hil.md").read_text()
STEPS: Final = tuple(
    tuple(command.replace("CELL", "two_wx200").split())
    for command in re.findall(r"^\| \d [^|]+\| `coop (run CELL[^`]*)` \|", _PAGE, re.MULTILINE)
)
(_compared,) = re.findall(r"`coop (compare [^`]+)`", _PAGE)
COMPARED: Final = tuple(_compared.split())
