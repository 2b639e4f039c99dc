"""A host per arm and one for the recorder, TLS and access control of `coop pki`; cables cut, slow, and of strangers."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from agent.config.files import load_files
from agent.log.read import read_log
from agent.pki.make import Wish, make
from agent.telemetry.link import publish, record
from agent.telemetry.link.publication import Pace, PublishOptions
from agent.telemetry.link.record import RecordOptions
from agent.telemetry.link.session import Network, has_link, open_session
from agent.telemetry.link.wire import BatchHeader
from tests.support.telemetry.namespaces import RECORDER, Hosts, Inside, hosts, run_inside, unavailable
from tests.support.telemetry.one_arm import wait_for, written
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import ARMS, CELL, CONFIG_ID, Process, make_rows, sent_by, writer

ROWS, RATE_HZ = 1400, 200.0
CUT = {"rejected.damaged", "rejected.no_batch_header"}
"""What a message is refused for of which a cut link lost a piece; what a forger here sends is whole."""


@pytest.fixture(scope="module", autouse=True)
def namespaces() -> None:
    if why := unavailable() or ("" if shutil.which("openssl") else "needs openssl to make certificates"):
        pytest.skip(why)


@dataclass(frozen=True)
class Forger:
    """Somebody who publishes as the left arm."""

    network: Network
    seconds: float  # at most; it ends a second after it has a link


def forge(options: Forger, _: Callable[[], bool], ready: Callable[[Any], None]) -> bool:
    """Whether it had a link."""
    ready(True)
    linked, rows, since_s = False, make_rows("left", 8), 0.0
    with open_session(options.network) as opened:
        end_s = time.monotonic() + options.seconds
        for i in range(10_000):
            linked |= has_link(opened.session)
            header = BatchHeader(4711, 8 * i, 8 * i + 8, 0).pack(sent_by("left", 4711))
            opened.session.put(f"coop/{CELL}/left/state", rows.tobytes(), attachment=header,
                               congestion_control=zenoh.CongestionControl.DROP)  # fmt: skip
            time.sleep(0.02)
            if linked and not since_s:
                since_s = time.monotonic()
            if time.monotonic() > end_s or (since_s and time.monotonic() > since_s + 1.0):
                break
    return linked


def of(folder: Path, member: str) -> Network:
    return Network(config_file=folder / member / "zenoh" / f"{member}.json5")


def cell_of(folder: Path) -> Path:
    make(Wish(load_files(Path(CELL)), folder, RECORDER, RECORDER, in_place=True))
    return folder


def recorder_on(net: Hosts, folder: Path, cell: Path) -> Process:
    options = RecordOptions(
        folder / "run.mcap", scene(CELL, ARMS), CONFIG_ID, network=of(cell, "recorder"), min_free_bytes=1 << 20
    )
    return Process(run_inside, Inside(net.names["recorder"], record.run, options))


def telemetry_on(net: Hosts, folder: Path, cell: Path, arm: str) -> Process:
    options = PublishOptions(CELL, arm, folder / f"{arm}.ring", network=of(cell, arm), pace=Pace.REAL_TIME)
    return Process(run_inside, Inside(net.names[arm], publish.run, options))


def forger_on(net: Hosts, host: str, network: Network, seconds: float = 1.5) -> Process:
    return Process(run_inside, Inside(net.names[host], forge, Forger(network, seconds)))


@pytest.mark.fault("N1", "N3")
def test_hosts_whose_cables_are_cut_slow_or_strange_lose_no_row_and_gain_none(tmp_path: Path) -> None:
    cell, other = cell_of(tmp_path / "cell"), cell_of(tmp_path / "other")
    with hosts("left", "right", "stranger") as net, recorder_on(net, tmp_path, cell) as rec:
        rec.ready()
        with (
            telemetry_on(net, tmp_path, cell, "left") as left,
            telemetry_on(net, tmp_path, cell, "right") as right,
            writer(tmp_path / "left.ring", "left", ROWS, RATE_HZ) as one,
            writer(tmp_path / "right.ring", "right", ROWS, RATE_HZ) as two,
            forger_on(net, "stranger", of(other, "left")) as foreign,
            forger_on(net, "stranger", Network(connect=(f"tcp/{RECORDER}:7447",))) as plain,
            forger_on(net, "right", of(cell, "right"), 30.0) as neighbour,
        ):
            wait_for(lambda: min(written(tmp_path / f"{arm}.ring") for arm in ARMS) > 100)
            net.unplug("left")
            net.slow("right", "3mbit")  # its rows need about 6
            assert [each.result() for each in (foreign, plain, neighbour)] == [False, False, True]
            net.plug("left")
            net.fast("right")
            assert [one.result(), two.result()] == [ROWS, ROWS]
            assert left.result().complete
            assert right.result().complete
        report = rec.stop()
    assert report.complete
    assert {key for key in report.completeness if key.startswith("rejected.")} <= CUT, "somebody else's row came in"
    log = read_log(tmp_path / "run.mcap")
    for arm in ARMS:
        rows = log.agents[arm]  # what was sent again comes behind what was not lost
        assert rows[np.argsort(rows["sequence"], kind="stable")].tobytes() == make_rows(arm, ROWS).tobytes()
