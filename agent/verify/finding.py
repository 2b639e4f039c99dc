"""One line of what a check or a tool found: what, where, found, wanted, verdict, remedy."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.interface import Refusal


class Verdict(enum.StrEnum):
    """What a finding means for a run."""

    OK = "ok"
    WARNING = "warning"  # the arm may run, but not as well or not as safely as it could
    REFUSED = "refused"  # the agent would refuse the arm, or something would go wrong


_SEVERITY = {Verdict.OK: 0, Verdict.WARNING: 1, Verdict.REFUSED: 2}


@dataclass(frozen=True, slots=True)
class Finding:
    """One line."""

    what: str
    where: str  # arm, "host" or "cell"
    found: str
    wanted: str
    verdict: Verdict = Verdict.OK
    remedy: str = ""
    by_gains: bool = False  # other gains may mend it

    @property
    def line(self) -> str:
        """The finding for a person."""
        if self.verdict is Verdict.OK:
            return f"{self.where}: {self.what}: {self.found}" + (f" (wanted {self.wanted})" if self.wanted else "")
        return f"{self.where}: {self.what}: found {self.found}, wanted {self.wanted}; {self.remedy}"

    def document(self) -> dict[str, str]:
        """The finding for a script."""
        return {
            "what": self.what, "where": self.where, "found": self.found, "wanted": self.wanted,
            "verdict": self.verdict.value, "remedy": self.remedy,
        }  # fmt: skip


def warning(what: str, where: str, found: str, wanted: str, remedy: str) -> Finding:
    """A finding that lets the arm run."""
    return Finding(what, where, found, wanted, Verdict.WARNING, remedy)


def refused(what: str, where: str, found: str, wanted: str, remedy: str) -> Finding:
    """A finding that does not."""
    return Finding(what, where, found, wanted, Verdict.REFUSED, remedy)


def judged(
    what: str, where: str, found: str, wanted: str, *, holds: bool, remedy: str, otherwise: Verdict = Verdict.REFUSED
) -> Finding:
    """A finding that is fine if `holds`, and `otherwise` with the remedy if not."""
    if holds:
        return Finding(what, where, found, wanted)
    return Finding(what, where, found, wanted, otherwise, remedy)


def from_refusal(error: Refusal, where: str) -> Finding:
    """What a driver or a file refused, as a finding."""
    return Finding(error.what, where, str(error.found), str(error.expected), Verdict.REFUSED, error.remedy)


def worst(findings: Iterable[Finding]) -> Verdict:
    """The gravest verdict; OK when there is none."""
    return max((f.verdict for f in findings), key=_SEVERITY.__getitem__, default=Verdict.OK)


def exit_code(findings: Iterable[Finding]) -> int:
    """0: all ok; 1: warnings; 2: refused."""
    return _SEVERITY[worst(findings)]
