"""`coop float` as processes: told to stop, the arm stands, sinks, and everything has ended with a complete log."""

from __future__ import annotations

import contextlib
import itertools
import json
import signal
from pathlib import Path

import numpy as np

from agent.log.read import read_log
from agent.modes import Mode
from tests.support.coop import TIMEOUT_S, start


def test_a_stop_by_signal_ends_in_off_with_a_complete_log_and_nothing_left(tmp_path: Path) -> None:
    process = start("float", "two_wx200", "--arm", "left", "--emulate", "--json", "--out", "log", cwd=tmp_path)
    assert process.stdout is not None
    for line in process.stdout:
        [seen] = json.loads(line)
        if seen["mode"] == "FLOAT" and seen["joints"]:
            break
    else:
        raise AssertionError(process.communicate())
    assert [joint["name"] for joint in seen["joints"]] == ["shoulder", "elbow", "wrist_angle"]
    assert all(0.3 < joint["room_rad"] < 2.0 for joint in seen["joints"])
    assert 0.1 < seen["p_m"][0] < 0.5
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, err
    told = [json.loads(line) for line in out.splitlines()]
    assert told[-1] == {"log": "log/run.mcap"}
    run = read_log(tmp_path / "log" / "run.mcap")
    assert run.complete
    modes = [Mode(mode).name for mode, _ in itertools.groupby(run.agents["left"]["mode"].tolist())]
    assert modes == ["FLOAT", "STAND", "SINK"]
    texts = [event.text for event in run.events]
    assert "run ended in OFF" in texts[-1]
    sank = run.agents["left"][run.agents["left"]["mode"] == Mode.SINK]
    assert np.nanmax(np.abs(sank["dq"])) < 0.5
    [port] = [text.split()[3] for text in texts if text.startswith("torque on, floating: ")]
    runtime = Path(port).parent
    assert not runtime.exists()
    assert not users(runtime)


def users(folder: Path) -> list[str]:
    """Processes whose command line names the folder."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if str(folder).encode() in file.read_bytes():
                found.append(file.parent.name)
    return found
