"""One agent's torque is the same bits with the network absent, present, and flooded with wrong messages on its keys."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

from agent.log.read import read_log
from agent.telemetry.ring.ring import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from tests.process.conftest import PAPER_RUN_S
from tests.support.coop import PAPER, ready, start

COMPARED = [f.name for f in AGENT_STATE.fields if not f.timing and f.name != "config_id"]


def short_cell(folder: Path) -> str:
    path = folder / "cell.toml"
    path.write_text(PAPER.read_text().replace("duration_s = 100.0", f"duration_s = {PAPER_RUN_S}"))
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
    rows = {}
    for process in (*agents.values(), plant):
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
    for arm in agents:
        with RingReader(folder / f"{arm}.ring", AGENT_STATE) as ring:
            rows[arm] = AGENT_STATE.decode(ring.read_at(0, ring.written).payload)
    return rows


def flooded(folder: Path) -> dict[str, NDArray[np.void]]:
    """A whole run while a stranger floods the keys of both arms with wrong messages."""
    cell, socket = short_cell(folder), folder / "plant.sock"
    log = folder / "run.mcap"
    recorder = start("record", cell, "--out", str(log), "--listen", "tcp/127.0.0.1:0", "--driver", "sim", cwd=folder)
    endpoint = ready(recorder).split("endpoint=")[1].strip()
    stop, sent = threading.Event(), [0]

    def flood() -> None:
        config = zenoh.Config()
        config.insert_json5("connect/endpoints", f'["{endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        with zenoh.open(config) as session:
            while not stop.is_set():
                for arm in ("left", "right"):
                    for kind in ("state", "event", "health", "info", "command"):
                        session.put(f"coop/paper/{arm}/{kind}", bytes(range(256)) * (1 + sent[0] % 20))
                        sent[0] += 1
                time.sleep(0.001)

    stranger = threading.Thread(target=flood)
    stranger.start()
    try:
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
        stop.set()
        stranger.join()
        recorder.terminate()
        _, err = recorder.communicate(timeout=30)
    assert recorder.returncode == 0, err
    assert sent[0] > 1000
    read = read_log(log)
    assert read.complete
    return read.agents


@pytest.mark.fault("N1")
def test_torque_is_the_same_without_network_with_it_and_under_a_flood(
    paper_runs: tuple[Path, Path], tmp_path: Path
) -> None:
    folders = [tmp_path / name for name in ("absent", "flooded")]
    for folder in folders:
        folder.mkdir()
    absent, under_flood = without_network(folders[0]), flooded(folders[1])
    present = read_log(paper_runs[0] / "run.mcap").agents
    for arm in ("left", "right"):
        assert len(absent[arm]) == PAPER_RUN_S * 200
        for other in (present[arm], under_flood[arm]):
            for name in COMPARED:
                assert absent[arm][name].tobytes() == other[name].tobytes(), (arm, name)
