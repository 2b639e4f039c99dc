"""What our Markdown documents refer to: links, and code in back quotes or fences."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENTS = (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")))

_FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"^    (coop .+)$", re.MULTILINE)
_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Document:
    """One page: its links, and the pieces of code in it, each a span, a line of a fence or an indented command."""

    path: Path
    links: tuple[str, ...]
    code: tuple[str, ...]
    anchors: frozenset[str]


def read(path: Path) -> Document:
    """The page with fences and prose told apart: what stands in a fence is code and no link."""
    text = path.read_text()
    fenced = [line for fence in _FENCE.findall(text) for line in fence.splitlines()[1:-1]]
    prose = _FENCE.sub("", text)
    return Document(
        path,
        tuple(_LINK.findall(prose)),
        (*_SPAN.findall(prose), *fenced, *_INDENTED.findall(prose)),
        frozenset(_anchor(heading) for heading in _HEADING.findall(prose)),
    )


def _anchor(heading: str) -> str:
    kept = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower())
    return kept.replace(" ", "-")
