"""The table of keys on the network and topics in the log: what members tell; no key commands anything.

    coop/<cell>/<member>/state      rows, in batches
    coop/<cell>/<member>/event      mode changes, faults, refusals (JSON)
    coop/<cell>/<member>/health     temperature, voltage, load of each servo (JSON), once a second; simulated arms: none
    coop/<cell>/<member>/info       queryable: what runs there (JSON)
    coop/<cell>/recorder/status     queryable: what the recorder has (JSON)
    replay/<key>                    the same, played back from a log

A member is an arm of the cell, or the plant.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from drivers.interface import Refusal

ROOT: Final = "coop"
REPLAY_PREFIX: Final = "replay"
PLANT: Final = "plant"
RECORDER: Final = "recorder"
RESERVED: Final = frozenset({PLANT, RECORDER, REPLAY_PREFIX, "object"})
_NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,31}")


class Kind(StrEnum):
    """What a key carries."""

    STATE = "state"
    EVENT = "event"
    HEALTH = "health"
    INFO = "info"


PUBLISHED: Final = (Kind.STATE, Kind.EVENT, Kind.HEALTH)


class BadName(Refusal):
    """A name that cannot be part of a key."""


@dataclass(frozen=True, slots=True)
class Address:
    """One key: cell, member, kind.  Names are checked on construction; raises BadName."""

    cell: str
    member: str
    kind: Kind

    def __post_init__(self) -> None:
        check_name(self.cell, "cell")
        check_name(self.member, "member")

    @property
    def key(self) -> str:
        """Key on the network."""
        return f"{ROOT}/{self.cell}/{self.member}/{self.kind.value}"

    @property
    def topic(self) -> str:
        """Topic in the log: the key with the leading slash that ROS tools want."""
        return "/" + self.key

    @property
    def replay_key(self) -> str:
        """Key under which the same is played back."""
        return f"{REPLAY_PREFIX}/{self.key}"


def check_name(name: str, what: str) -> str:
    """Return `name`; raise BadName unless it can be part of a key and of a ROS topic."""
    if not _NAME.fullmatch(name):
        raise BadName(
            f"name of a {what}",
            found=repr(name),
            expected="a small letter, then up to 31 small letters, digits or underscores",
            remedy="rename it in the cell file",
        )
    return name


def check_arm_name(name: str) -> str:
    """Return `name`; raise BadName unless an arm may have it."""
    check_name(name, "arm")
    if name in RESERVED:
        raise BadName(
            "name of an arm",
            found=repr(name),
            expected=f"none of {', '.join(sorted(RESERVED))}",
            remedy="rename it in the cell file",
        )
    return name


def parse_topic(topic: str) -> Address | None:
    """Address of a topic in a log, None for a topic that is not one of ours (the standard messages)."""
    parts = topic.removeprefix("/").split("/")
    if len(parts) != 4 or parts[0] != ROOT or parts[3] not in {kind.value for kind in Kind}:
        return None
    if not (_NAME.fullmatch(parts[1]) and _NAME.fullmatch(parts[2])):
        return None
    return Address(parts[1], parts[2], Kind(parts[3]))


def cell_keys(cell: str) -> str:
    """Key expression of everything the members of a cell publish."""
    return f"{ROOT}/{check_name(cell, 'cell')}/**"


def status_key(cell: str) -> str:
    """Key on which the recorder says what it has."""
    return f"{ROOT}/{check_name(cell, 'cell')}/{RECORDER}/status"
