"""One line of a check's table; holds, decides nothing."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Verdict(enum.StrEnum):
    """Outcome of one check."""

    OK = "ok"
    WARNING = "warning"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the table."""

    what: str
    where: str  # arm or "cell"
    found: str
    limit: str
    verdict: Verdict
    remedy: str = ""


def judge(what: str, where: str, found: str, limit: str, ok: bool, remedy: str) -> Finding:
    """A finding that is refused unless it is `ok`; the remedy is said only then."""
    return Finding(what, where, found, limit, Verdict.OK if ok else Verdict.REFUSED, "" if ok else remedy)
