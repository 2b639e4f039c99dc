"""The rows of one arm on their way through `step`: read block by block, and which of them are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.log.columns import BLOCK_ROWS, Table
from agent.log.layout import differences
from agent.log.read import ColumnLog
from agent.replay.source import ReplayError
from agent.replay.tick import Rows
from agent.telemetry.row.sample import AGENT_FIELDS, AGENT_STATE, Layout

# what a step is computed from; without one of these nothing can be computed again
INPUTS: Final = ("sequence", "stamp_ns", "mode", "flags", "joint_count", "t", "q_measured", "dq_measured")
OF_THE_MEMORY: Final = ("memory", "theta_arm", "theta_object")


@dataclass(frozen=True, slots=True)
class Window:
    """Which rows to replay: from a time of the trajectory or from a row number on, all of them without either."""

    from_s: float | None = None
    from_row: int | None = None

    @property
    def lacking(self) -> dict[str, str]:
        """Where it has no row: what was found, and what to do about it."""
        if self.from_row is None and self.from_s is None:
            return {"found": "no row at all", "remedy": "name another arm with --arm, or take another log"}
        return {"found": "no row from there on", "remedy": "begin earlier"}

    def of(self, rows: Table) -> Table:
        """The rows of the window."""
        if self.from_row is not None:
            return rows[rows["sequence"] >= self.from_row]
        if self.from_s is not None:
            return rows[rows["t"] >= self.from_s]
        return rows


@dataclass(frozen=True)
class Readable:
    """What of a log's rows this release can compare: the fields that both have in the same form."""

    fields: tuple[str, ...]
    memory: bool  # whether a replay may begin at any row

    @classmethod
    def of(cls, layout: Layout, what: str) -> Readable:
        """Raises ReplayError where an input of `step` is not there."""
        theirs = {(f.name, f.ros_type, f.length) for f in layout.fields}
        common = tuple(f.name for f in AGENT_FIELDS if (f.name, f.ros_type, f.length) in theirs)
        lacking = [name for name in INPUTS if name not in common]
        if lacking:
            raise ReplayError(
                f"rows of {what} cannot be replayed",
                found=differences(layout.fields, AGENT_FIELDS),
                expected=f"at least {', '.join(INPUTS)}",
                remedy=f"they lack {', '.join(lacking)}: replay them with the release that recorded them",
            )
        return cls(common, all(name in common for name in OF_THE_MEMORY))


def blocks(table: Table, layout: Layout, readable: Readable) -> Iterator[Rows]:
    """The rows in stretches, in the layout of this release; fields that the log has not are zero."""
    for part in table.blocks(BLOCK_ROWS):
        messages = np.ascontiguousarray(part.messages()).reshape(-1).view(layout.dtype)
        if layout.dtype == AGENT_STATE.dtype:
            yield messages
            continue
        rows = np.zeros(len(messages), AGENT_STATE.dtype)
        for name in ("encapsulation", *readable.fields):
            rows[name] = messages[name]
        yield rows


def arms_of(log: ColumnLog, wanted: str | None) -> list[str]:
    """The arms to replay.  Raises ReplayError for one that the log has not."""
    if wanted is None:
        return list(log.agents)
    if wanted not in log.agents:
        raise ReplayError(
            f"arm of {log.path}", found=repr(wanted), expected=" or ".join(log.agents), remedy="name one of them"
        )
    return [wanted]
