"""Code and commands of a documentation page, as a reader would copy them."""

from __future__ import annotations

import re
from pathlib import Path

from tests.support.documents import ROOT


def fences(page: str, language: str) -> list[str]:
    """The blocks of a page under docs/ in this language, in their order."""
    text = (ROOT / "docs" / page).read_text()
    found = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [block for said, block in found if said == language]


def told(page: str) -> set[str]:
    """The names that a page under docs/ gives in back quotes, such as the keys of a document."""
    return set(re.findall(r"`(\w+)`", (ROOT / "docs" / page).read_text()))


def commands(page: str, language: str = "") -> list[list[str]]:
    """The command lines of `coop` in its blocks, by words, without comments."""
    lines = (line.partition("  #")[0].strip() for block in fences(page, language) for line in block.splitlines())
    return [line.split() for line in lines if line.startswith("coop ")]


def here(folder: Path, files: dict[str, Path]) -> Path:
    """The folder, with these files under the names that the page gives them."""
    for name, path in files.items():
        (folder / name).symlink_to(path)
    return folder
