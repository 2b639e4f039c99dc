"""What a stranger sends: random messages and forged rows, of which the recorder's door lets none in."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import numpy as np
import pytest
import zenoh

from agent.config.cell import Cell, load_cell
from agent.faults import stranger
from agent.faults.stranger import BURST, ALTERED_Nm, forged_messages, random_messages
from agent.telemetry.link.intake import Intake, Rejection
from agent.telemetry.link.session import Network, OpenSession, Role
from agent.telemetry.link.wire import HEADER_BYTES
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN


@pytest.fixture
def cell() -> Cell:
    return load_cell(Path("paper"))


def intake(cell: Cell, fingerprint: str) -> Intake:
    arms = {arm.name: arm.n for arm in cell.arms}
    return Intake(cell.file.name, arms, has_plant=True, config_id=cell.config_id, fingerprint=fingerprint)


def rows(cell: Cell) -> bytes:
    own = np.zeros(5, AGENT_STATE.dtype)
    own["encapsulation"], own["config_id"] = CDR_LITTLE_ENDIAN, cell.config_id
    own["joint_count"], own["sequence"], own["utc_ns"] = cell.arms[0].n, range(7, 12), range(5)
    return own.tobytes()


def test_random_messages_come_under_every_key_and_are_all_left_out(cell: Cell) -> None:
    sent = list(random_messages("paper", "left", seed=1))
    assert len(sent) == 5 * BURST
    assert {key for key, _, _ in sent} == {
        f"coop/paper/left/{kind}" for kind in ("state", "event", "health", "info", "command")
    }
    door = intake(cell, cell.fingerprint)
    assert not any(door.take(key, payload, header or b"") for key, payload, header in sent)
    assert sum(door.rejected.values()) == len(sent)
    assert {len(header) for _, _, header in sent if header is not None} == {HEADER_BYTES}
    assert any(header is None for _, _, header in sent)
    assert list(random_messages("paper", "left", seed=1)) == sent
    assert list(random_messages("paper", "left", seed=2)) != sent


def test_forged_rows_look_right_and_are_left_out_for_the_files_alone(cell: Cell) -> None:
    sent = list(forged_messages(cell, "left", rows(cell)))
    door = intake(cell, cell.fingerprint)
    assert not any(door.take(key, payload, header or b"") for key, payload, header in sent)
    assert door.rejected == {Rejection.WRONG_SEAL: 2}
    forger = intake(cell, cell.fingerprint[::-1])  # a cell with the stranger's files takes all of it
    (taken,), (event,) = (forger.take(key, payload, header or b"") for key, payload, header in sent)
    assert not forger.rejected
    assert taken.address.member == event.address.member == "left"  # type: ignore[union-attr]
    own = np.frombuffer(rows(cell), AGENT_STATE.dtype)
    assert (taken.rows["sequence"] == own["sequence"]).all()  # type: ignore[union-attr]
    assert (taken.rows["tau_limited"] == own["tau_limited"] + ALTERED_Nm).all()  # type: ignore[union-attr]


def test_each_is_sent_in_order_and_none_is_dropped_on_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    session: Any = Mock(get=Mock(return_value=["what the recorder has"]))

    @contextmanager
    def open_session(network: Network) -> Iterator[OpenSession]:
        assert network == Network(connect=("tcp/127.0.0.1:9",), role=Role.VIEWER)
        yield OpenSession(session, None)

    monkeypatch.setattr(stranger, "open_session", open_session)
    messages = [("coop/paper/left/state", b"rows", b"header"), ("coop/paper/left/command", b"word", None)]
    assert stranger.send("tcp/127.0.0.1:9", "paper", iter(messages)) == 2
    block = zenoh.CongestionControl.BLOCK
    assert session.method_calls == [
        *(call.put(key, data, attachment=header, congestion_control=block) for key, data, header in messages),
        call.get("coop/paper/recorder/status", timeout=stranger.HEARD_TIMEOUT_S),
    ]
