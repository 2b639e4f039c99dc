"""An agent's torque is the same bits without network, with it, under a flood, and with telemetry and recorder dead."""

from __future__ import annotations

import contextlib
import json
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

from agent.faults.judge import RowResult
from agent.host.ready_line import values_of
from agent.log.read import read_log
from agent.telemetry.link.session import has_link
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.coop import PAPER, ready, start
from tests.support.loaded import Loaded
from tests.support.ports import free_port

RUN_S = 0.6
REHEARSED = "tests.support.rehearsed_listeners"
COMPARED = [f.name for f in AGENT_STATE.fields if not f.timing and f.name != "config_id"]


def short_cell(folder: Path) -> str:
    path = folder / "cell.toml"
    path.write_text(PAPER.read_text().replace("duration_s = 100.0", f"duration_s = {RUN_S}"))
    return str(path)


def without_network(folder: Path) -> dict[str, NDArray[np.void]]:
    """Plant and agents alone; the rows are taken from the rings."""
    cell, socket = short_cell(folder), folder / "plant.sock"
    plant = start("plant", cell, "--socket", str(socket), "--ring", str(folder / "plant.ring"), cwd=folder)
    ready(plant)
    agents = {
        arm: start(
            "agent",
            cell,
            "--arm",
            arm,
            "--plant-socket",
            str(socket),
            "--ring",
            str(folder / f"{arm}.ring"),
            cwd=folder,
        )
        for arm in ("left", "right")
    }
    for process in (*agents.values(), plant):
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
    return {arm: in_ring(folder / f"{arm}.ring") for arm in agents}


def in_ring(path: Path) -> NDArray[np.void]:
    with RingReader(path, AGENT_STATE) as ring:
        return AGENT_STATE.decode(ring.read_at(0, ring.written).payload)


@contextlib.contextmanager
def flood(endpoint: str) -> Iterator[list[int]]:
    """A stranger floods the keys of both arms with wrong messages; yields how many a recorder was sent."""
    stop, sent = threading.Event(), [0]

    def pour() -> None:
        config = zenoh.Config()
        config.insert_json5("connect/endpoints", f'["{endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        # a recorder of such a run lives for a second
        retry = "{ period_init_ms: 20, period_max_ms: 20, period_increase_factor: 1 }"
        config.insert_json5("connect/retry", retry)
        with zenoh.open(config) as session:
            while not stop.is_set():
                linked = has_link(session)  # there is no recorder before a run, nor behind its end
                for arm in ("left", "right"):
                    for kind in ("state", "event", "health", "info", "command"):
                        session.put(f"coop/paper/{arm}/{kind}", bytes(range(256)) * (1 + sent[0] % 20))
                        sent[0] += linked
                time.sleep(0.001)

    stranger = threading.Thread(target=pour)
    stranger.start()
    try:
        yield sent
    finally:
        stop.set()
        stranger.join()


def bereft(folder: Path) -> dict[str, NDArray[np.void]]:
    """Under a flood; early in the run one arm's telemetry and the recorder are killed, the others' telemetry stands.

    Before that the one stood and went on, the other was killed and started anew, and strangers sent to both.
    """
    deeds = (
        ("telemetry-garbage", {"arm": "plant", "at_s": 0.06}),
        ("telemetry-wrong", {"arm": "right", "at_s": 0.06}),
        ("telemetry-stuck", {"arm": "right", "at_s": 0.08, "for_s": 0.04}),
        ("telemetry-off", {"arm": "left", "at_s": 0.08, "for_s": 0.04}),
        ("recorder-stuck", {"at_s": 0.14, "for_s": 0.04}),
        *(("telemetry-stuck", {"arm": member, "at_s": 0.2}) for member in ("right", "plant")),
        ("telemetry-off", {"arm": "left", "at_s": 0.2}),
        ("recorder-off", {"at_s": 0.2}),
    )
    endpoint, kept = f"tcp/127.0.0.1:{free_port()}", folder / "found.pickle"
    with flood(endpoint) as sent:
        run = Loaded(short_cell(folder), json.dumps(deeds), endpoint, kept, module=REHEARSED, cwd=folder)
        _, err = run.communicate(timeout=90)
        assert run.returncode == 0, err
    assert sent[0] > 1000
    rows, found = pickle.loads(kept.read_bytes())
    assert found.verdict is RowResult.MET
    assert not found.complete
    assert all(found.kept[arm].logged <= 60 for arm in ("left", "right"))  # of 120: what came before 0.2 s at most
    return {arm: rows[arm] for arm in ("left", "right")}


def flooded(folder: Path) -> dict[str, NDArray[np.void]]:
    """A whole run while a stranger floods the keys of both arms with wrong messages."""
    cell, socket = short_cell(folder), folder / "plant.sock"
    log = folder / "run.mcap"
    recorder = start("record", cell, "--out", str(log), "--listen", "tcp/127.0.0.1:0", "--driver", "sim", cwd=folder)
    endpoint = values_of(ready(recorder))["endpoint"]
    try:
        with flood(endpoint) as sent:
            plant = start("plant", cell, "--socket", str(socket), "--ring", str(folder / "plant.ring"), cwd=folder)
            ready(plant)
            members = []
            for arm in ("left", "right"):
                place = ["--ring", str(folder / f"{arm}.ring")]
                members.append(start("agent", cell, "--arm", arm, "--plant-socket", str(socket), *place, cwd=folder))
                members.append(
                    start("telemetry", cell, "--arm", arm, *place, "--connect", endpoint, "--lockstep", cwd=folder)
                )
            place = ["--ring", str(folder / "plant.ring")]
            members.append(
                start("telemetry", cell, "--member", "plant", *place, "--connect", endpoint, "--lockstep", cwd=folder)
            )
            for process in (*members, plant):
                _, err = process.communicate(timeout=90)
                assert process.returncode == 0, err
    finally:
        recorder.terminate()
        _, err = recorder.communicate(timeout=30)
    assert recorder.returncode == 0, err
    assert sent[0] > 1000
    read = read_log(log)
    assert read.complete
    return read.agents


@pytest.mark.fault("N1", "N5", "P10")
@pytest.mark.parametrize(
    "run",
    [bereft, *(pytest.param(run, marks=pytest.mark.long) for run in (without_network, flooded))],
    ids=lambda run: run.__name__,
)
def test_torque_is_the_same_with_network_without_it_under_a_flood_and_bereft_of_telemetry(
    paper_runs: tuple[Path, Path], tmp_path: Path, run: Callable[[Path], dict[str, NDArray[np.void]]]
) -> None:
    """The flood of a whole run is in `make long`; here it lasts until there is no recorder."""
    found, present = run(tmp_path), read_log(paper_runs[0] / "run.mcap").agents
    for arm in ("left", "right"):
        assert len(found[arm]) == round(RUN_S * 200)
        begin = present[arm][: len(found[arm])]  # of a longer run
        for name in COMPARED:
            assert begin[name].tobytes() == found[arm][name].tobytes(), (arm, name)
