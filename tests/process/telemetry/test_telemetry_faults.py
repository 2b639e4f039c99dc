"""What the fault matrix asks of telemetry (N1, N2, N5, D1, D4, P10, P1's black box): survive, refill, tell."""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import shutil
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import zenoh

from agent.atomic import write_atomically
from agent.log import file as log_file
from agent.log.file import LogFileError
from agent.log.read import LogError, read_log
from agent.log.scan import library_of
from agent.telemetry.link import record
from agent.telemetry.link.endpoint import NetworkError
from agent.telemetry.link.inbox import Inbox
from agent.telemetry.link.intake import Rejection
from agent.telemetry.link.publication import Pace, PublishReport
from agent.telemetry.link.record import RecordOptions, RecordReport
from agent.telemetry.link.session import Network, open_session
from agent.telemetry.link.wire import BatchHeader, End
from agent.telemetry.row.topics import BadName
from tests.support.telemetry.one_arm import (
    LEFT,
    RATE_HZ,
    one_arm,
    prefix,
    recorded,
    rows_in,
    somewhere,
    wait_for,
    wait_for_the_end,
    written,
)
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import (
    CELL,
    CONFIG_ID,
    Process,
    make_rows,
    recorder,
    sent_by,
    telemetry,
    writer,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path


@pytest.mark.fault("D4")
def test_a_killed_recorder_leaves_a_readable_log_and_the_next_one_gets_everything(folder: Path) -> None:
    """The agent has ended before the next one is there, as on a slow host: telemetry waits with all of it."""
    network = somewhere()
    with one_arm(folder, 100_000, network=network) as (rec, tel, agent, _):
        wait_for(lambda: recorded(folder / "run.mcap") > 0)
        time.sleep(random.uniform(0.0, 0.7))
        rec.kill()
        before = written(folder / "left.ring")
        kept = len(read_log(folder / "run.mcap").agents["left"])
        assert rows_in(folder / "run.mcap") == prefix(kept, kept)
        assert kept > 0
        wait_for(lambda: written(folder / "left.ring") > before + 200)
        total = agent.stop()
        with recorder(folder / "next.mcap", arms=LEFT, network=network) as second:
            second.ready()
            assert tel.result().complete
            wait_for(lambda: "recovery" in read_log(folder / "run.mcap").metadata)
            report = second.stop()
    assert report.complete
    assert [done.path for done in report.repaired] == [folder / "run.mcap"]
    assert rows_in(folder / "next.mcap") == prefix(total, total)
    told = [e.text for e in read_log(folder / "next.mcap").events if e.source == "left"]
    assert [text for text in told if text.startswith("link to the recorder was cut for ")]
    repaired = read_log(folder / "run.mcap")
    assert repaired.agents["left"].tobytes() == prefix(kept, total)
    assert not repaired.complete
    assert repaired.attachments["run.json"]
    assert kept <= before


@pytest.mark.fault("N2")
def test_a_recorder_that_stands_still_costs_no_row(folder: Path) -> None:
    with one_arm(folder, 2500) as (rec, tel, agent, _):
        wait_for(lambda: written(folder / "left.ring") > 200)
        rec.signal(signal.SIGSTOP)
        time.sleep(3.0)
        rec.signal(signal.SIGCONT)
        agent.result()
        assert tel.result().complete
        assert rec.stop().complete
    assert rows_in(folder / "run.mcap") == prefix(2500, 2500)


@pytest.mark.fault("N1")
def test_a_recorder_that_comes_late_gets_everything_the_ring_holds(folder: Path) -> None:
    ring, network = folder / "left.ring", somewhere()
    with recorder(folder / "first.mcap", arms=LEFT, network=network) as first:
        endpoint = first.ready()
    with (
        telemetry(ring, "left", endpoint, Pace.REAL_TIME) as tel,
        writer(ring, "left", 400, RATE_HZ) as agent,
    ):
        assert agent.result() == 400
        with recorder(folder / "run.mcap", arms=LEFT, network=network) as late:
            late.ready()
            assert tel.result().complete
            assert late.stop().complete
    assert rows_in(folder / "run.mcap") == prefix(400, 400)


@pytest.mark.fault("P10")
def test_telemetry_that_is_killed_and_started_again_leaves_no_gap(folder: Path) -> None:
    with one_arm(folder, 100_000) as (rec, tel, agent, endpoint):
        wait_for(lambda: recorded(folder / "run.mcap") > 0)
        tel.kill()
        gone = written(folder / "left.ring")
        wait_for(lambda: written(folder / "left.ring") > gone + 150)
        with telemetry(folder / "left.ring", "left", endpoint, Pace.REAL_TIME) as again:
            total = agent.stop()
            assert again.result().complete
        report = rec.stop()
    assert report.complete
    assert int(report.completeness["left.duplicates"]) > 0
    log = read_log(folder / "run.mcap")
    assert log.agents["left"].tobytes() == prefix(total, total)
    assert [e.text for e in log.events] == ["mode READY → TRACK"]


def test_a_killed_agent_leaves_its_last_rows_in_the_log(folder: Path) -> None:
    with one_arm(folder, 100_000) as (rec, tel, agent, _):
        wait_for(lambda: written(folder / "left.ring") > 200)
        agent.kill()
        count = written(folder / "left.ring")
        report = tel.result()
        assert (report.end, report.rows_written) == (End.DIED, count)
        told = rec.stop().completeness
    assert told["left.end"] == "died"
    assert told["left.rows_recorded"] == str(count)
    assert rows_in(folder / "run.mcap") == prefix(count, count)


def test_a_service_follows_the_agents_one_ring_after_the_other_and_passes_over_dead_ones(folder: Path) -> None:
    ring, network = folder / "left.ring", somewhere()
    with writer(ring, "left", 30, RATE_HZ) as gone:
        assert gone.result() == 30
    with recorder(folder / "first.mcap", arms=LEFT, network=network) as first:
        endpoint = first.ready()
        with telemetry(ring, "left", endpoint, Pace.REAL_TIME, follow=True) as service:
            service.ready()
            with writer(ring, "left", 200, RATE_HZ) as agent:
                assert agent.result() == 200
            wait_for_the_end(endpoint)
            assert first.stop().complete
            with recorder(folder / "second.mcap", arms=LEFT, network=network) as second:
                second.ready()
                with writer(ring, "left", 300, RATE_HZ) as agent:
                    assert agent.result() == 300
                wait_for_the_end(endpoint)
                report = second.stop()
                assert report.complete, report
            service.stop()
    assert rows_in(folder / "first.mcap") == prefix(200, 200)
    assert rows_in(folder / "second.mcap") == prefix(300, 300)


@pytest.mark.parametrize("pace", Pace)
def test_a_second_run_in_the_same_place_gets_no_row_of_the_first(folder: Path, pace: Pace) -> None:
    ring, rate_hz = folder / "left.ring", None if pace is Pace.LOCKSTEP else RATE_HZ
    with writer(ring, "left", 30, rate_hz) as gone:
        assert gone.result() == 30
    with recorder(folder / "run.mcap", arms=LEFT) as rec:
        with telemetry(ring, "left", rec.ready(), pace, fresh=True) as tel:
            tel.ready()
            time.sleep(0.2)  # the agent takes a while before it has its own ring
            with writer(ring, "left", 200, rate_hz) as agent:
                assert agent.result() == 200
            assert tel.result().complete
        assert rec.stop().complete
    assert rows_in(folder / "run.mcap") == prefix(200, 200)


def test_rows_overwritten_before_anybody_read_them_are_counted_and_named(folder: Path) -> None:
    ring = folder / "left.ring"
    with recorder(folder / "run.mcap", arms=LEFT) as rec:
        endpoint = rec.ready()
        with writer(ring, "left", 300, 5000.0, slots=100) as agent:
            assert agent.result() == 300
        with telemetry(ring, "left", endpoint, Pace.REAL_TIME) as tel:
            report = tel.result()
            assert (report.rows_written, report.rows_lost, report.complete) == (300, 200, False)
        told = rec.stop().completeness
    assert (told["left.rows_expected"], told["left.rows_recorded"]) == ("300", "100")
    assert (told["left.lost_in_ring"], told["left.lost_on_the_way"]) == ("200", "0")
    assert json.loads(told["left.gaps"]) == [[0, 199]]
    assert told["complete"] == "false"
    assert rows_in(folder / "run.mcap") == make_rows("left", 300)[200:].tobytes()


def test_a_stop_in_the_middle_finishes_the_file_and_says_that_it_is_not_whole(folder: Path) -> None:
    with one_arm(folder, 100_000) as (rec, tel, agent, _):
        wait_for(lambda: written(folder / "left.ring") > 300)
        report = rec.stop()
        agent.signal(signal.SIGTERM)
        tel.stop()
    assert not report.complete
    log = read_log(folder / "run.mcap")
    assert log.problems == ()
    assert not log.complete
    assert log.metadata["completeness"]["left.end"] == "open"
    assert log.agents["left"].tobytes() == prefix(len(log.agents["left"]), len(log.agents["left"]))


def test_an_arm_that_never_published_makes_the_log_incomplete(folder: Path) -> None:
    ring = folder / "left.ring"
    with recorder(folder / "run.mcap") as rec:
        endpoint = rec.ready()
        with telemetry(ring, "left", endpoint, Pace.REAL_TIME) as tel, writer(ring, "left", 50, RATE_HZ):
            assert tel.result().complete
        report = rec.stop()
    assert not report.complete
    assert report.completeness["right.rows_expected"] == "0"


def wrong_messages(good: bytes) -> list[tuple[str, bytes, bytes | None]]:
    """Key, payload, attachment of messages that do not belong in the log, as strangers and mistakes make them."""
    head = BatchHeader(4711, 0, 8, 0).pack(sent_by("left"))
    foreign = make_rows("left", 8)
    foreign["config_id"] += 1
    return [
        ("coop/paper/left/state", b"", None),
        ("coop/paper/left/state", os.urandom(999), head),
        ("coop/paper/left/state", good, None),
        ("coop/paper/left/state", good, head),
        ("coop/paper/left/state", good, BatchHeader(4711, 0, 8, 0).pack()),
        ("coop/paper/left/state", good, b"CB1\0" + os.urandom(36)),
        ("coop/paper/left/state", foreign.tobytes(), head),
        ("coop/paper/left/state", bytes(1 << 19), head),
        ("coop/paper/left/event", b"\xff" * 500, head),
        ("coop/paper/left/health", b"[" * 900, head),
        ("coop/paper/left/torque", good, head),
        ("coop/paper/stranger/state", good, head),
        ("coop/paper/recorder/event", b"{}", head),
    ]


@pytest.mark.fault("N5")
def test_a_flood_of_wrong_messages_neither_breaks_nor_pollutes_the_log(folder: Path) -> None:
    with one_arm(folder, 1000) as (rec, tel, agent, endpoint):
        wait_for(lambda: written(folder / "left.ring") > 100)
        with open_session(Network(connect=(endpoint,))) as stranger:
            wait_for(lambda: bool(stranger.session.info.links()))
            messages = wrong_messages(make_rows("left", 8).tobytes())
            for _ in range(100):
                for key, payload, attachment in messages:
                    stranger.session.put(
                        key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.BLOCK
                    )
            agent.result()
            assert tel.result().complete
        report = rec.stop()
    assert report.complete
    counts = {k.removeprefix("rejected."): int(v) for k, v in report.completeness.items() if k.startswith("rejected.")}
    assert sum(counts.values()) == 100 * len(messages)
    assert counts[Rejection.UNKNOWN_KEY.value] == 300
    assert counts[Rejection.TOO_LARGE.value] == counts[Rejection.WRONG_SEAL.value] == 100
    assert counts[Rejection.ANOTHER_PUBLISHER.value] == 300  # rows, an event and health of another run
    assert report.completeness["left.refused"] == str(100 * (len(messages) - 3))
    log = read_log(folder / "run.mcap")
    assert log.agents["left"].tobytes() == prefix(1000, 1000)
    assert {e.source for e in log.events} <= {"left", "recorder"}
    told = {str(e.data["reason"]) for e in log.events if e.source == "recorder" and "reason" in e.data}
    assert told == counts.keys()


def noted(path: Path, counts: Mapping[str, int]) -> None:
    write_atomically(path, json.dumps(dict(counts)).encode())


@pytest.mark.fault("N6")
def test_an_arm_of_which_a_stranger_alone_spoke_is_missing_in_the_log(folder: Path) -> None:
    note = folder / "left_out.json"
    with recorder(folder / "run.mcap", left_out=partial(noted, note)) as rec:
        endpoint = rec.ready()
        with open_session(Network(connect=(endpoint,))) as stranger:
            wait_for(lambda: bool(stranger.session.info.links()))
            end = BatchHeader(1, 0, 0, 0, End.FINISHED)
            for attachment in (end.pack(), end.pack(sent_by("right"))):
                stranger.session.put("coop/paper/right/state", b"", attachment=attachment)
            wait_for(note.exists)  # while the recorder is at work, as `coop status` shows it
            assert json.loads(note.read_bytes()) == {Rejection.WRONG_SEAL.value: 1}
            with (
                telemetry(folder / "left.ring", "left", endpoint, Pace.REAL_TIME) as tel,
                writer(folder / "left.ring", "left", 50, RATE_HZ),
            ):
                assert tel.result().complete
        report = rec.stop()
    assert not report.complete
    assert not read_log(folder / "run.mcap").complete
    assert (report.completeness["right.rows_expected"], report.completeness["right.refused"]) == ("0", "1")


def test_telemetry_of_another_cell_file_is_not_recorded_and_says_that_nobody_took_it(folder: Path) -> None:
    note = folder / "left_out.json"
    with recorder(folder / "run.mcap", arms=LEFT, fingerprint="ours", left_out=partial(noted, note)) as rec:
        endpoint = rec.ready()
        changes = {"pace": Pace.REAL_TIME, "fingerprint": "theirs", "follow": True}
        with telemetry(folder / "left.ring", "left", endpoint, **changes) as tel:
            tel.ready()
            with writer(folder / "left.ring", "left", 50, RATE_HZ) as agent:
                agent.result()
            wait_for(note.exists)  # it has come to the recorder and was left out
            report = tel.stop()
        kept = rec.stop()
    assert report.rows_unrecorded == 50
    assert not kept.complete
    assert int(kept.completeness["rejected.wrong_cell_or_layout"]) > 0


@pytest.mark.fault("N5")
def test_a_message_of_any_size_does_not_fill_the_recorders_memory(folder: Path) -> None:
    with one_arm(folder, 1000) as (rec, tel, agent, endpoint):
        wait_for(lambda: written(folder / "left.ring") > 100)
        with open_session(Network(connect=(endpoint,))) as stranger:
            for size_MB in (2, 64):
                stranger.session.put(
                    "coop/paper/left/state",
                    bytes(size_MB << 20),
                    attachment=BatchHeader(1, 0, 1, 0).pack(sent_by("left")),
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
        agent.result()
        assert tel.result().complete
        status = Path(f"/proc/{rec.process.pid}/status").read_text()
        peak_kB = int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])
        assert rec.stop().complete
    assert peak_kB < 200_000
    assert rows_in(folder / "run.mcap") == prefix(1000, 1000)


def record_on_a_small_disk(
    options: RecordOptions, stop: Callable[[], bool], ready: Callable[[str], None]
) -> RecordReport:
    """The kernel refuses to let any file grow beyond 1 MB, with an error as a full disk gives."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, resource.RLIM_INFINITY))
    return record.run(replace(options, ended=lambda log, why: ready(f"{log.name}: {why}")), stop, ready)


def record_on_a_disk_that_is_full_at_once(
    options: RecordOptions, stop: Callable[[], bool], ready: Callable[[str], None]
) -> RecordReport:
    """Once the log has begun nothing more gets into it, which no look at the clock finds out."""
    log_file.FLUSH_S = 3600.0
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def begun(endpoint: str) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))
        ready(endpoint)

    return record.run(options, stop, begun)


def record_on_a_disk_nearly_full(
    options: RecordOptions, stop: Callable[[], bool], ready: Callable[[str], None]
) -> RecordReport:
    """There is room when the log begins, and none from then on."""
    log_file.free_bytes = lambda where: options.min_free_bytes if isinstance(where, Path) else 0
    return record.run(replace(options, ended=lambda log, why: ready(f"{log.name}: {why}")), stop, ready)


def send_all(ring: Path, total: int, endpoint: str) -> PublishReport:
    """So many rows of the left arm, in lockstep with a recorder."""
    with telemetry(ring, "left", endpoint, Pace.LOCKSTEP) as tel, writer(ring, "left", total, None) as agent:
        assert agent.result() == total
        report: PublishReport = tel.result()
        return report


@pytest.mark.fault("D1")
def test_a_disk_that_is_full_stops_the_log_and_nothing_else(folder: Path) -> None:
    total = 20_000
    options = RecordOptions(folder / "run.mcap", scene(CELL, LEFT), CONFIG_ID, min_free_bytes=1 << 20)
    with Process(record_on_a_small_disk, options) as rec:
        sent = send_all(folder / "left.ring", total, rec.ready())
        assert rec.ready() == "run.mcap: File too large", "told while it runs"
        report = rec.stop()
        with pytest.raises(EOFError):
            rec.ready()  # and once
    assert report.failure == "File too large"
    assert not report.complete
    log = read_log(folder / "run.mcap")
    kept = len(log.agents["left"])
    assert 0 < kept < total
    assert log.agents["left"].tobytes() == prefix(kept, total)
    assert report.completeness["left.rows_recorded"] == str(kept)
    assert report.completeness["left.lost_on_disk"] == str(total - kept)
    assert (sent.rows_unrecorded, sent.unrecorded_why, sent.complete) == (total - kept, "File too large", False)


@pytest.mark.fault("D1")
def test_the_end_of_a_run_is_not_confirmed_before_it_is_written(folder: Path) -> None:
    """Rows that wait for a chunk of them are lost with a disk that is full, and so few of them all wait."""
    options = RecordOptions(folder / "run.mcap", scene(CELL, LEFT), CONFIG_ID, min_free_bytes=1 << 20)
    with Process(record_on_a_disk_that_is_full_at_once, options) as rec:
        sent = send_all(folder / "left.ring", 50, rec.ready())
        rec.stop()
    assert (sent.rows_unrecorded, sent.unrecorded_why) == (50, "File too large")


@pytest.mark.fault("D1")
def test_a_disk_that_is_nearly_full_ends_the_log_with_its_reason(folder: Path) -> None:
    options = RecordOptions(folder / "run.mcap", scene(CELL, LEFT), CONFIG_ID)
    with Process(record_on_a_disk_nearly_full, options) as rec:
        sent = send_all(folder / "left.ring", 100, rec.ready())
        assert rec.ready() == "run.mcap: disk nearly full", "told while it runs"
        report = rec.stop()
    assert (report.failure, report.complete) == ("disk nearly full", False)
    assert sent.rows_unrecorded == 100 - len(read_log(folder / "run.mcap").agents["left"])
    assert "disk nearly full: the log ends here" in [event.text for event in read_log(folder / "run.mcap").events]


def record_and_tell(options: RecordOptions, stop: Callable[[], bool], ready: Callable[[str], None]) -> RecordReport:
    return record.run(replace(options, ended=lambda log, why: ready(f"{log.name}: {why}")), stop, ready)


@pytest.mark.fault("D1")
def test_rows_of_a_log_that_somebody_removed_are_unrecorded_and_the_next_recorder_gets_them(folder: Path) -> None:
    total, where = 1500, somewhere()
    (folder / "logs").mkdir()
    options = RecordOptions(
        folder / "logs/run.mcap", scene(CELL, LEFT), CONFIG_ID, min_free_bytes=1 << 20, network=where
    )
    ring, log = folder / "left.ring", folder / "logs/run.mcap"
    with (
        writer(ring, "left", total, RATE_HZ) as agent,
        Process(record_and_tell, options) as rec,
        telemetry(ring, "left", rec.ready(), Pace.REAL_TIME) as tel,
    ):
        wait_for(lambda: recorded(log) > 0)
        shutil.rmtree(log.parent)
        assert rec.ready() == "run.mcap: somebody has removed it"
        rec.stop()
        with recorder(folder / "again.mcap", arms=LEFT, network=where) as again:
            again.ready()
            assert agent.result() == total
            assert tel.result().complete
            assert again.stop().complete
    assert rows_in(folder / "again.mcap") == prefix(total, total)


@pytest.mark.fault("D1")
def test_no_row_of_a_log_that_somebody_removed_is_called_recorded(folder: Path) -> None:
    """Not those either that were in it before."""
    total, log = 700, folder / "logs/run.mcap"
    log.parent.mkdir()
    options = RecordOptions(log, scene(CELL, LEFT), CONFIG_ID, min_free_bytes=1 << 20)
    with (
        writer(folder / "left.ring", "left", total, RATE_HZ) as agent,
        Process(record_and_tell, options) as rec,
        telemetry(folder / "left.ring", "left", rec.ready(), Pace.REAL_TIME) as tel,
    ):
        wait_for(lambda: recorded(log) > 0)
        shutil.rmtree(log.parent)
        assert rec.ready() == "run.mcap: somebody has removed it"
        agent.result()
        sent = tel.result()
        rec.stop()
    assert (sent.rows_written, sent.rows_unrecorded, sent.unrecorded_why) == (total, total, "somebody has removed it")


def test_a_second_recorder_is_refused_before_anything_starts(folder: Path) -> None:
    with recorder(folder / "run.mcap", arms=LEFT) as rec:
        endpoint = rec.ready()
        with pytest.raises(LogFileError, match="another recorder is writing"):
            record.run(RecordOptions(folder / "run.mcap", scene(CELL, LEFT), CONFIG_ID), stop=lambda: True)
        taken = RecordOptions(folder / "second.mcap", scene(CELL, LEFT), CONFIG_ID, network=Network(listen=endpoint))
        with pytest.raises(NetworkError, match=r"expected an endpoint that is free, .* port 0 takes a free one"):
            record.run(taken, stop=lambda: True)
        rec.stop()
    assert not (folder / "second.mcap").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"path": Path("missing/run.mcap")}, "cannot write"),
        ({"min_free_bytes": 1 << 60}, "no room"),
        ({"scene": scene("Not A Name", LEFT)}, "name of a cell"),
        ({"scene": scene(CELL, {"plant": ("a",)})}, "name of an arm"),
        ({"network": Network(listen="nonsense")}, "endpoint"),
    ],
)
def test_what_cannot_be_recorded_is_refused_and_leaves_no_file(
    folder: Path, change: dict[str, Any], message: str
) -> None:
    options = {"path": Path("run.mcap"), "scene": scene(CELL, LEFT), "config_id": CONFIG_ID} | change
    options["path"] = folder / options["path"]
    with pytest.raises((LogFileError, NetworkError, BadName), match=message):
        record.run(RecordOptions(**options), stop=lambda: True)
    assert list(folder.iterdir()) == []


def test_a_signal_at_any_instant_does_not_hold_the_recorder_up() -> None:
    inbox = Inbox(frozenset())
    before = signal.signal(signal.SIGALRM, lambda *_: None)
    signal.setitimer(signal.ITIMER_REAL, 0.00097, 0.00097)
    try:
        for _ in range(1500):
            assert inbox.take(1, 0.001) == []
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_nothing_is_left_after_a_refusal_or_an_end(folder: Path) -> None:
    def sockets() -> set[str]:
        links = set()
        for fd in Path("/proc/self/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):  # threads of Zenoh's close theirs meanwhile
                links.add(str(fd.readlink()))
        return {link for link in links if link.startswith("socket:")}

    def attempt(name: str, **changes: Any) -> None:
        record.run(RecordOptions(folder / name, scene(CELL, LEFT), CONFIG_ID, **changes), stop=lambda: True)

    attempt("warm-up.mcap")  # Zenoh keeps a few descriptors of its own for the life of the process
    before = sockets()
    attempt("a.mcap")
    with pytest.raises(LogFileError, match="exists already"):
        attempt("a.mcap")
    with pytest.raises(LogFileError, match="no room"):
        attempt("b.mcap", min_free_bytes=1 << 60)
    wait_for(lambda: sockets() <= before)  # fewer: what an earlier test had still to close


def test_a_log_that_was_never_written_to_is_a_finished_file_without_rows(folder: Path) -> None:
    with recorder(folder / "run.mcap", arms=LEFT) as rec:
        rec.ready()
        assert not rec.stop().complete
    assert library_of(BytesIO((folder / "run.mcap").read_bytes())) == "widowx-coop"
    with pytest.raises(LogError, match="holds no rows"):
        read_log(folder / "run.mcap")
