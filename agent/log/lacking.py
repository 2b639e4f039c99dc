"""What a log has not: rows, an arm, the end of one; from what its recorder said and from the rows themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

_WHERE: Final = {"lost_in_ring": "in the ring", "lost_on_the_way": "on the way", "lost_on_disk": "on the disk"}
_EXPECTED: Final = ".rows_expected"
_RECORDED: Final = ".rows_recorded"


def missing(completeness: Mapping[str, str]) -> list[str]:
    """What is not in a log and why, by member; from its last metadata record."""
    found = []
    for key, expected in completeness.items():
        if not key.endswith(_EXPECTED):
            continue
        member = key.removesuffix(_EXPECTED)
        names = ("rows_before", "missing_before", "rows_recorded", "end", *_WHERE)
        of = {name: completeness.get(f"{member}.{name}", "0") for name in names}
        if of["missing_before"] != "0":
            found.append(f"{of['missing_before']} rows of {member} are missing in the logs before")
        if expected == of["rows_before"] == "0":
            found.append(f"no row of {member} came")
        elif of["rows_recorded"] != expected:
            where = ", ".join(f"{of[name]} lost {words}" for name, words in _WHERE.items() if of[name] != "0")
            found.append(f"{of['rows_recorded']} of {expected} rows of {member}" + (f", {where}" if where else ""))
        elif of["end"] == "open":
            found.append(f"{member} had not ended")
    return found


def lacking(
    completeness: Mapping[str, str], rows: Mapping[str, int], absent: Mapping[str, int], members: Sequence[str]
) -> dict[str, str]:
    """Rows that are not in a file although nothing that its recorder said is the reason, in words by member.

    rows: of each member that the file names; absent: how many their numbers leave out, which says something only where
    the recorder counted none, for a row that came late is in a later log than its neighbours; members: of the run, as
    far as it is described, beside those that its recorder counted rows of.
    """
    found = {}
    counted = [key.removesuffix(_RECORDED) for key in completeness if key.endswith(_RECORDED)]
    for member in dict.fromkeys((*rows, *members, *counted)):
        have, told = rows.get(member, 0), f"{member}.rows_recorded" in completeness
        recorded = sum(_count(completeness.get(f"{member}.{key}", "0")) for key in ("rows_recorded", "late_rows"))
        if have < recorded:
            found[member] = f"{recorded - have} of the {recorded} rows of {member} that were recorded are not in it"
        elif not have and not told:
            found[member] = f"no row of {member} is in it"
        elif absent.get(member) and not told:
            found[member] = f"{absent[member]} rows of {member} are not in it"
    return found


def _count(text: str) -> int:
    return int(text) if text.isdecimal() and len(text) < 20 else 0  # a damaged file may say anything
