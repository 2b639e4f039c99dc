"""Every recorded input through the same `step`: the row it gives must be the recorded one, bit for bit.

Compared is all that a row holds but timing: the memory it began with, every term of the law, torque, flags; and time
and stamp must fit.  What the driver tells is taken as recorded: the joints, which show in what `step` makes of them,
and measured and sent torque, on which nothing else in the row depends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agent.config.agent import build_agent
from agent.config.cell import Cell
from agent.log.columns import Table
from agent.log.read import ColumnLog
from agent.loop import Agent
from agent.modes import Mode, mode_of
from agent.replay.chain import Chain
from agent.replay.comparison import TORQUES, ArmComparison, Comparison, Difference
from agent.replay.misfits import of_the_plant, with_misnumbered
from agent.replay.rows import Readable, Window, arms_of, blocks
from agent.replay.source import ReplayError
from agent.replay.tick import Rows, is_fresh
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_FIELDS, AGENT_STATE
from drivers.interface import JointState, Vector


def verify(
    log: ColumnLog, cell: Cell, window: Window, arm: str | None = None, tell: Callable[[str], None] = lambda _: None
) -> Comparison:
    """Replay the rows of the window through agents of the log's own cell; of all arms with a look at the plant's.

    Raises ReplayError where nothing can be compared, ConfigError for an arm that the cell has not.
    """
    arms, notes = [], []
    for name in arms_of(log, arm):
        layout = log.layouts[name]
        readable = Readable.of(layout, f"{name} in {log.path}")
        if len(readable.fields) < len(AGENT_FIELDS):
            lacking = [f.name for f in AGENT_FIELDS if f.name not in readable.fields]
            notes.append(f"{name}: recorded by another release; not compared: {', '.join(lacking)}")
        tell(f"replaying {name}")
        rows = window.of(log.agents[name])
        looped = name in cell.file.looped
        checked = _Verifier(build_agent(cell, cell.arm(name)), cell.config_id, readable, in_the_loop=looped)
        compared = checked.run(rows, blocks(rows, layout, readable))
        arms.append(with_misnumbered(compared, log, window))
    if not any(compared.rows for compared in arms):
        raise ReplayError(
            f"nothing to replay{f' of {arm}' if arm else ''} in {log.path}", expected="rows of an arm", **window.lacking
        )
    return Comparison((*arms, *(of_the_plant(log, cell, window) if arm is None else ())), tuple(notes))


class _Verifier:
    """One arm."""

    def __init__(self, agent: Agent, config_id: int, readable: Readable, *, in_the_loop: bool = False) -> None:
        """in_the_loop: its rows have what a bridge told; those of others have zeros there."""
        self._agent, self._readable, self._in_the_loop = agent, readable, in_the_loop
        self._chain = Chain(agent)
        self._message = np.zeros(1, AGENT_STATE.dtype)
        self._row = AgentRow(self._message, agent.model.n, config_id)
        self._bytes = self._message.view(np.uint8).data
        self._compared = [f.name for f in AGENT_FIELDS if f.name in readable.fields and not f.timing]
        self._spans = _spans(self._compared)
        self._next: int | None = None  # sequence number that the chain is ready for
        self._rows = self._different = self._left_out = 0
        self._first: Difference | None = None
        self._largest_Nm = 0.0

    def run(self, table: Table, parts: Iterator[Rows]) -> ArmComparison:
        """The comparison of all rows of the table; parts: the same rows block by block."""
        clock = _Clock.of(table)
        with np.errstate(all="ignore"):  # a damaged number may be anything; what comes of it is compared
            for rows in parts:
                self._block(rows, clock)
        return ArmComparison(
            self._agent.name, self._rows, self._different, self._left_out, self._first, self._largest_Nm
        )  # fmt: skip

    def _block(self, rows: Rows, clock: _Clock) -> None:
        data, size = rows.tobytes(), rows.dtype.itemsize
        sequences, modes, flags = rows["sequence"].tolist(), rows["mode"].tolist(), rows["flags"].tolist()
        times, t_expected = rows["t"].tolist(), clock.times(rows)
        inputs = _inputs(rows, self._agent.model.n)
        for i, (sequence, state) in enumerate(zip(sequences, inputs, strict=True)):
            if not self._ready(sequence, rows, i):
                self._left_out += len(rows) - i
                return
            self._rows += 1
            mode = mode_of(modes[i])
            if mode is None:
                self._differs(rows, i, ("mode",), f"none of {len(Mode)} modes")
                continue
            fresh = is_fresh(flags[i])
            try:
                memory, outcome = self._chain.pass_row(state, times[i], mode, flags[i])
            except (ArithmeticError, ValueError) as error:
                self._differs(rows, i, ("t",), f"no torque at all: {error or type(error).__name__}")
                continue
            sent = rows["tau_sent"][i, : self._agent.model.n]
            told = state if fresh else self._lost(state)
            self._row.fill(sequence, times[i], int(rows["utc_ns"][i]), mode, told, memory, outcome, sent)
            if self._in_the_loop:
                self._row.fill_bridge(sent, *_bridged(rows[i], self._agent.model.n))
            at = i * size
            same = all(bytes(self._bytes[a:b]) == data[at + a : at + b] for a, b in self._spans)
            if not same or t_expected[i] != times[i]:
                self._compare(rows, i, t_expected[i])

    def _lost(self, state: JointState) -> JointState:
        """What the row of a cycle without a state says of the joints."""
        nothing = np.full(self._agent.model.n, np.nan)
        return JointState(state.stamp_ns, nothing, nothing, nothing)

    def _ready(self, sequence: int, rows: Rows, i: int) -> bool:
        """Bring the chain to this row; False where its memory cannot be had."""
        if sequence != self._next:
            if sequence == 0:
                self._chain.start()
            elif self._readable.memory:
                self._chain.restore(rows[i])
            else:
                return False
        self._next = sequence + 1
        return True

    def _compare(self, rows: Rows, i: int, t_expected: float) -> None:
        """Note which fields of a row differ; the next row then begins with what it has recorded itself."""
        recorded, replayed, n = rows[i], self._message[0], self._agent.model.n
        fields = [name for name in self._compared if not _same(recorded[name], replayed[name])]
        for name in TORQUES.intersection(fields):
            apart = np.abs(recorded[name][:n] - replayed[name][:n])
            self._largest_Nm = max(self._largest_Nm, float(np.nanmax(apart, initial=0.0)))
        if t_expected != float(recorded["t"]):
            self._differs(rows, i, ("t", *fields), t_expected)
        else:
            self._differs(rows, i, tuple(fields), None)

    def _differs(self, rows: Rows, i: int, fields: tuple[str, ...], instead: float | str | None) -> None:
        self._different += 1
        if self._readable.memory:
            self._next = None
        if self._first is not None:
            return
        row, name = rows[i], fields[0]
        index = _index(row[name], self._message[0][name])
        recorded, replayed = (np.ravel(of[name])[index or 0].item() for of in (row, self._message[0]))
        self._first = Difference(
            self._agent.name, int(row["sequence"]), float(row["t"]), name, index, recorded,
            replayed if instead is None else instead, fields,
        )  # fmt: skip


def _spans(names: list[str]) -> list[tuple[int, int]]:
    """Stretches of a message's bytes that hold these fields, in the order of the table."""
    spans: list[tuple[int, int]] = []
    fields = AGENT_STATE.dtype.fields
    assert fields is not None
    for name in names:
        dtype, begin, *_ = fields[name]
        if spans and spans[-1][1] == begin:
            spans[-1] = (spans[-1][0], begin + dtype.itemsize)
        else:
            spans.append((begin, begin + dtype.itemsize))
    return spans


def _inputs(rows: Rows, n: int) -> Iterator[JointState]:
    """The measured joints of each row."""
    arrays = (np.ascontiguousarray(rows[name][:, :n]) for name in ("q_measured", "dq_measured", "tau_measured"))
    return (JointState(*row) for row in zip(rows["stamp_ns"].tolist(), *arrays, strict=True))


def _bridged(row: np.void, n: int) -> tuple[Vector, Vector, float]:
    """What the bridge of an arm in the loop told, which is taken as recorded, as all that a driver tells."""
    return row["tau_bridge"][:n], row["q_twin"][:n], float(row["twin_age_s"])


def _same(a: NDArray[np.generic] | np.generic, b: NDArray[np.generic] | np.generic) -> bool:
    return a.tobytes() == b.tobytes()


def _index(a: NDArray[np.generic] | np.generic, b: NDArray[np.generic] | np.generic) -> int | None:
    """The first place at which two arrays differ by a bit; None for single numbers."""
    if not isinstance(a, np.ndarray):
        return None
    bits = (np.ascontiguousarray(x).view(np.uint64) for x in (a, b))
    return int(np.flatnonzero(np.not_equal(*bits))[0])


@dataclass(frozen=True, slots=True)
class _Clock:
    """Stamp and time of a row say the same of one another; between one wait in READY and the next by one zero."""

    begins: NDArray[np.int64]  # sequence numbers, of the first rows of what is between two waits
    zeros_ns: tuple[int, ...]  # on the driver's clock, by which each of these counts

    @classmethod
    def of(cls, table: Table) -> _Clock:
        waits = table["mode"] == Mode.READY
        edges = [*np.flatnonzero(np.diff(waits, prepend=True)).tolist(), len(waits)]
        spans = [slice(k, end) for k, end in pairwise(edges) if not waits[k]]
        zeros = [Counter(_zeros(table["stamp_ns"][span], table["t"][span])) for span in spans]
        begins = np.array([table["sequence"][span.start] for span in spans], dtype=np.int64)
        return cls(begins, tuple(zero.most_common(1)[0][0] for zero in zeros))

    def times(self, rows: Rows) -> list[float]:
        """The time (s) that each row should have."""
        zeros = _zeros(rows["stamp_ns"], rows["t"])
        ready = (rows["mode"] == Mode.READY).tolist()
        stamps = rows["stamp_ns"].tolist()
        spans = (np.searchsorted(self.begins, rows["sequence"], side="right") - 1).tolist()
        return [
            (stamp - (own if waits or span < 0 else self.zeros_ns[span])) * 1e-9
            for stamp, own, waits, span in zip(stamps, zeros, ready, spans, strict=True)
        ]


def _zeros(stamp_ns: NDArray[np.int64], t: NDArray[np.float64]) -> list[int]:
    """The instant that each row counts from; for a time that is no time, the stamp itself."""
    return [
        stamp - round(time * 1e9) if -1e9 < time < 1e9 else stamp
        for stamp, time in zip(stamp_ns.tolist(), t.tolist(), strict=True)
    ]
