"""Whatever others send, before and while an arm publishes, its part of the log is what it is without them."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from agent.telemetry.link.intake import Intake
from agent.telemetry.link.wire import BatchHeader, End, Sent, seal_of
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.received import Rows
from agent.telemetry.row.topics import Address, Kind
from tests.support.telemetry.telemetry_cell import CELL, CONFIG_ID, layout_of, make_rows

Message = tuple[str, bytes, bytes]
FILES, RING, TEXTS = "c0ffee" * 10, 77, 78
KEYS = {kind: Address(CELL, "left", kind).key for kind in (Kind.STATE, Kind.EVENT, Kind.HEALTH)}
OWN = Sent(seal_of(CELL, FILES, "left", layout_of("left")), RING)
ROWS = make_rows("left", 40)
EVENT = Event(5, "left", Level.WARN, "HOLD").to_json()
FORGED = Event(6, "left", Level.ERROR, "FAULT").to_json()
COUNTS = st.integers(0, 60)
ENDS = st.sampled_from(End)


def own_messages() -> list[Message]:
    """What the arm sends: rows with one batch missing, an event, its end."""
    batches = [(0, 10), (10, 20), (25, 40)]
    rows = [(KEYS[Kind.STATE], ROWS[a:b].tobytes(), BatchHeader(RING, a, 40, 5).pack(OWN)) for a, b in batches]
    event = (KEYS[Kind.EVENT], EVENT, BatchHeader(TEXTS, 0, 1, 0).pack(OWN))
    end = (KEYS[Kind.STATE], b"", BatchHeader(RING, 40, 40, 5, End.FINISHED).pack(OWN))
    return [*rows[:2], event, rows[2], end]


def attachments(sent: st.SearchStrategy[Sent], sources: st.SearchStrategy[int]) -> st.SearchStrategy[bytes]:
    """Headers as the door wants them, of senders and sources."""

    def make(by: Sent, source: int, first: int, more: int, end: End) -> bytes:
        return BatchHeader(source, first, first + more, 0, end).pack(by)

    return st.builds(make, sent, sources, COUNTS, COUNTS, ENDS)


SEALS = st.sampled_from(
    [
        bytes(16),
        seal_of(CELL, "f00d", "left", layout_of("left")),  # other files
        seal_of(CELL, FILES, "right", layout_of("left")),  # another arm
        seal_of(CELL, FILES, "left"),  # another row layout
    ]
)
STRANGERS = st.one_of(
    st.binary(max_size=90),
    attachments(st.builds(Sent, SEALS, st.sampled_from([0, RING, 99])), st.sampled_from([1, RING, TEXTS, 99])),
)
INSIDERS = attachments(st.builds(Sent, st.just(OWN.seal), st.sampled_from([0, 99, 100])), st.sampled_from([99, 100]))
PAYLOADS = st.one_of(
    st.binary(max_size=200),
    st.builds(lambda a, b: ROWS[a : a + b].tobytes(), st.integers(0, 39), st.integers(0, 9)),
    st.sampled_from([b"", EVENT, FORGED]),
)


def messages(attachment: st.SearchStrategy[bytes]) -> st.SearchStrategy[list[Message]]:
    key = st.sampled_from([*KEYS.values(), f"coop/{CELL}/left/torque", "x"])
    return st.lists(st.tuples(key, PAYLOADS, attachment), max_size=8)


@dataclass
class Recorded:
    """What came of it."""

    rows: bytes
    texts: list[bytes]
    told: dict[str, str]


def record(parts: list[list[Message]]) -> Recorded:
    """What is in the log after a part of the strangers' messages before each of the arm's own."""
    door = Intake(CELL, {"left": 3}, has_plant=False, config_id=CONFIG_ID, fingerprint=FILES)
    rows, texts, now_s = b"", [], 0.0
    for strange, own in zip(parts, own_messages(), strict=True):
        for message in [*strange, own]:
            now_s += 0.01
            for item in door.take(*message, now_s):
                if isinstance(item, Rows):
                    rows += item.rows.tobytes()
                else:
                    texts.append(item.payload)
            assert not door.another_run
    told = door.completeness({})
    return Recorded(
        rows, texts, {key: value for key, value in told.items() if "reject" not in key and "refuse" not in key}
    )


QUIET = record([[]] * 5)


def test_the_undisturbed_arm_is_there() -> None:
    assert len(QUIET.rows) == 35 * ROWS.dtype.itemsize
    assert QUIET.texts == [EVENT]
    assert (QUIET.told["complete"], QUIET.told["left.gaps"]) == ("false", "[[20, 24]]")


@given(st.lists(messages(STRANGERS), min_size=5, max_size=5))
def test_strangers_change_nothing_before_the_run_nor_during_it(parts: list[list[Message]]) -> None:
    assert record(parts) == QUIET


@given(st.lists(messages(st.one_of(STRANGERS, INSIDERS)), min_size=3, max_size=3))
def test_who_has_the_cells_files_changes_nothing_while_the_arm_publishes(parts: list[list[Message]]) -> None:
    assert record([[], *parts, []]) == QUIET
