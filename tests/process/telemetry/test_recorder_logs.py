"""A recorder for real use: run after run, logs of bounded size, a bounded folder, one recorder at a time."""

from __future__ import annotations

import json
import os
import signal
import time
from functools import partial
from pathlib import Path

import pytest

from agent.log.collect import LogError
from agent.log.file import LogInTheWay
from agent.log.parts import Limits, make_room, only_recorder
from agent.log.read import read_log
from agent.telemetry.link.publication import Pace
from tests.support.telemetry.log_maker import LogMaker, make_log
from tests.support.telemetry.one_arm import LEFT, RATE_HZ, one_arm, prefix, rows_in, wait_for, written
from tests.support.telemetry.proxy import wire
from tests.support.telemetry.telemetry_cell import CELL, recorder, telemetry, writer


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path


def _holds(log: Path, rows: int) -> bool:
    try:
        return rows_in(log) == prefix(rows, rows)
    except LogError:  # not there yet, or without a row
        return False


def test_a_service_records_one_run_after_the_other_each_into_a_log_of_its_own(folder: Path) -> None:
    ring = folder / "left.ring"
    with recorder(folder / "run.mcap", arms=LEFT) as rec:
        endpoint = rec.ready()
        with telemetry(ring, "left", endpoint, Pace.REAL_TIME, follow=True) as service:
            service.ready()
            for rows, log_name in ((200, "run.mcap"), (300, "run_2.mcap"), (100, "run_3.mcap")):
                with writer(ring, "left", rows, RATE_HZ) as agent:
                    assert agent.result() == rows
                wait_for(partial(_holds, folder / log_name, rows))
            service.signal(signal.SIGSTOP)
            with writer(ring, "left", 50, None) as agent:  # a run that is over before the service looks
                assert agent.result() == 50
            service.signal(signal.SIGCONT)
            wait_for(partial(_holds, folder / "run_4.mcap", 50))
            service.stop()
        report = rec.stop()
    assert report.logs == tuple(folder / name for name in ("run.mcap", "run_2.mcap", "run_3.mcap", "run_4.mcap"))
    assert report.complete, report
    for path, rows in zip(report.logs, (200, 300, 100, 50), strict=True):
        log = read_log(path)
        assert log.complete
        assert log.agents["left"].tobytes() == prefix(rows, rows)
    assert read_log(report.logs[1]).metadata["recorder"]["previous"] == "run.mcap"


def test_a_long_run_is_split_by_size_without_losing_or_doubling_a_row(folder: Path) -> None:
    with one_arm(folder, 2000, limits=Limits(part_bytes=400_000)) as (rec, tel, agent, _):
        agent.result()
        assert tel.result().complete
        report = rec.stop()
    assert len(report.logs) > 2
    assert report.complete
    logs = [read_log(path) for path in report.logs]
    assert all(log.complete and log.attachments["run.json"] for log in logs)
    assert b"".join(log.agents["left"].tobytes() for log in logs) == prefix(2000, 2000)
    assert all(path.stat().st_size < 1_200_000 for path in report.logs)
    told = [log.metadata["completeness"] for log in logs]
    assert [t["left.end"] for t in told] == ["continued"] * (len(told) - 1) + ["finished"]
    assert sum(int(t["left.rows_expected"]) for t in told) == 2000


def test_a_run_is_split_by_time(folder: Path) -> None:
    with one_arm(folder, 900, limits=Limits(part_s=1.0)) as (rec, tel, agent, _):
        agent.result()
        assert tel.result().complete
        report = rec.stop()
    assert len(report.logs) >= 2
    assert b"".join(rows_in(path) for path in report.logs) == prefix(900, 900)


def test_the_oldest_logs_make_room_and_other_files_stay(folder: Path) -> None:
    make_log(folder / "old.mcap", 400)
    os.utime(folder / "old.mcap", (1, 1))
    (folder / "foreign.mcap").write_bytes(b"not ours" * 1_000_000)
    (folder / "notes.txt").write_text("keep")
    with one_arm(folder, 2000, limits=Limits(part_bytes=400_000, folder_bytes=700_000)) as (rec, tel, agent, _):
        agent.result()
        tel.result()
        report = rec.stop()
    left = sorted(path.name for path in folder.glob("*.mcap"))
    assert "old.mcap" not in left
    assert {"foreign.mcap", report.logs[-1].name} <= set(left)
    assert (folder / "notes.txt").exists()
    ours = sum(path.stat().st_size for path in folder.glob("run*.mcap"))
    assert ours < 700_000 + 600_000
    assert any(e.text.startswith("removed ") for path in report.logs if path.exists() for e in read_log(path).events)


def test_a_log_that_is_being_written_is_never_removed(folder: Path) -> None:
    being_written = LogMaker(folder / "run.mcap")
    make_log(folder / "other.mcap", 50)
    assert make_room(folder, 0) == (folder / "other.mcap",)
    assert (folder / "run.mcap").exists()
    being_written.finish()
    assert make_room(folder, 0) == (folder / "run.mcap",)


def test_two_recorders_of_a_cell_do_not_share_a_folder(folder: Path) -> None:
    with (
        only_recorder(folder, CELL),
        pytest.raises(LogInTheWay, match="is being recorded into"),
        only_recorder(folder, CELL),
    ):
        pass
    with only_recorder(folder, CELL), only_recorder(folder, "another"):
        pass


@pytest.mark.parametrize("slots", [pytest.param(8192, marks=pytest.mark.long), 500])
@pytest.mark.fault("N2")
def test_a_network_that_is_cut_for_five_seconds_costs_no_row_or_names_those_it_costs(folder: Path, slots: int) -> None:
    ring, total = folder / "left.ring", 4000
    with recorder(folder / "run.mcap", arms=LEFT) as rec, wire(rec.ready()) as line:
        with (
            telemetry(ring, "left", line.endpoint, Pace.REAL_TIME) as tel,
            writer(ring, "left", total, RATE_HZ, slots=slots) as agent,
        ):
            wait_for(lambda: written(ring) > 500)
            line.cut()
            time.sleep(5.0)
            line.mend()
            assert agent.result() == total
            sent = tel.result()
        told = rec.stop().completeness
    log = read_log(folder / "run.mcap")
    there = set(log.agents["left"]["sequence"].tolist())
    named = {n for first, last in json.loads(told["left.gaps"]) for n in range(first, last + 1)}
    assert there | named == set(range(total))
    assert not there & named
    assert log.complete == (not named) == sent.complete
    if slots > total:
        assert log.complete
