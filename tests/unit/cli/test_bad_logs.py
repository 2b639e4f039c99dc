"""Every command that reads a log, given one that is no good in its own way: one line, or what can still be read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

import configs
from agent.config.cell import load_cell
from agent.log import load
from agent.log.scan import MAGIC
from agent.telemetry.row.sample import AGENT_STATE
from agent.view.staged import NEEDS
from tests.support.command import coop
from tests.support.few import few
from tests.support.plant.plant_arm import run_one
from tests.support.telemetry.run_log import write_other_release, write_run
from tests.support.telemetry.telemetry_cell import make_rows

CELL = load_cell(configs.CELLS_DIR / "identify_wx200.toml", ["duration_s=0.2", "report.transient_s=0.05"])
ARM = CELL.arms[0].name
LOG = "{log}"
READERS = {
    "report": ("report", LOG, "--out", "out"),
    "compare": ("compare", LOG, LOG),
    "events": ("events", LOG),
    "grasps": ("grasps", LOG),
    "replay": ("replay", LOG),
    "replay --set": ("replay", LOG, "--set", "object.mass_kg=0.5"),
    "replay --same-as": ("replay", LOG, "--same-as", LOG),
    "export": ("export", LOG, "--out", "out"),
    "play": ("play", LOG, "--listen", "tcp/127.0.0.1:0", "--speed", "1000"),
    "identify": ("identify", LOG, "--out", "out"),
    "calibrate": ("calibrate", LOG, "--out", "out"),
    "view": ("view", LOG, "--film", "out.png"),
    "view --from": ("view", LOG, "--film", "out.png", "--from", "0.05"),
}
REPAIR = ("recover", LOG)


@cache
def rows() -> np.ndarray:
    found: np.ndarray = run_one(CELL, 0.2).rows
    return found


def foreign(path: Path) -> None:
    """Of another program: a camera."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(
            "/camera", "cdr", writer.register_schema("x/Image", "ros2msg", b"uint8[] a\n")
        )
        writer.add_message(channel, 0, b"\0\1\0\0" + bytes(100), 0)
        writer.finish()


def text_schema(path: Path) -> None:
    """Our topic and our schema's name, but rows of text."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("coop_msgs/msg/AgentState", "ros2msg", b"string all\n")
        writer.add_message(writer.register_channel(f"/coop/x/{ARM}/state", "cdr", schema), 0, b"\0\1\0\0hello", 0)
        writer.finish()


def other_release(path: Path) -> None:
    write_other_release(path, CELL, {ARM: rows()}, without=("shift", "e_p"), memory=51)


def without(*names: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        write_run(path, CELL, {ARM: rows()}, left_out=names)

    return write


def described(text: bytes) -> Callable[[Path], None]:
    """Our rows under a description that is none."""

    def write(path: Path) -> None:
        write_run(path, CELL, {ARM: rows()}, left_out=("run.json",))
        _add_description(path, text)

    return write


def _add_description(path: Path, text: bytes) -> None:
    with path.open("rb") as source:
        reader = make_reader(source)
        messages = [(schema, channel, message) for schema, channel, message in reader.iter_messages()]
        attachments = list(reader.iter_attachments())
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "widowx-coop")
        for a in attachments:
            writer.add_attachment(0, 0, a.name, a.media_type, a.data)
        writer.add_attachment(0, 0, "run.json", "application/json", text)
        known: dict[str, int] = {}
        for schema, channel, message in messages:
            if channel.topic not in known:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(known[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()


def no_rows(path: Path) -> None:
    write_run(path, CELL, {ARM: rows()[:0]})


def one_row(path: Path) -> None:
    write_run(path, CELL, {ARM: rows()[:1]})


def made_up(path: Path) -> None:
    """Rows that no law gave: every number is of a sine."""
    write_run(path, CELL, {ARM: make_rows("left", 40)})


BAD = {
    "another program's": foreign,
    "rows of text": text_schema,
    "another release's": other_release,
    "without a cell": without("cell.toml"),
    "without a description": without("run.json"),
    "a description that is no JSON": described(b"{"),
    "a description of nothing": described(b"[]"),
    "a description of wrong types": described(json.dumps({"rate_hz": "fast", "arms": 3, "cell": 1}).encode()),
    "a description of wrong numbers": described(json.dumps({"rate_hz": 0, "duration_s": -1, "arms": [{}]}).encode()),
    "no rows": no_rows,
    "one row": one_row,
    "made up": made_up,
}


def cases() -> list[Any]:
    """Each reader with two logs, each log with two readers; `make long` has every pair."""
    names = list(BAD)
    two = {(reader, names[(k + d) % len(names)]) for k, reader in enumerate(READERS) for d in (0, 5)}
    return few(product(READERS, BAD), two.__contains__)


@pytest.mark.parametrize(("reader", "bad"), cases())
def test_a_log_that_is_no_good_is_one_line_or_read_as_far_as_it_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: str, reader: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agent.report.report.pictures", lambda _: [])  # drawing takes seconds and reads no log
    BAD[bad](tmp_path / "run.mcap")
    done = coop(*(word.replace(LOG, "run.mcap") for word in READERS[reader]))
    assert "Traceback" not in done.err
    if done.code == 0:
        return
    if done.code == 1:
        assert reader.startswith("replay")
        assert "first difference" in done.out
        return
    last = done.err.splitlines()[-1]
    assert last.startswith("coop: ")
    assert ": found " in last
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir()), "nothing half is left"


@pytest.mark.parametrize("text", [b"{", b"[]", b"3", b'{"rate_hz": -1}', b'{"rate_hz": NaN}', b'{"arms": {"a": 1}}'])
def test_a_bad_description_is_told_and_the_rows_speak_for_themselves(tmp_path: Path, text: bytes) -> None:
    described(text)(tmp_path / "run.mcap")
    run = load(tmp_path / "run.mcap")
    assert "taken from the rows" in run.info.notes[0]
    assert run.info.rate_hz == pytest.approx(CELL.file.rate_hz)
    assert [arm.name for arm in run.info.arms] == [ARM]


@pytest.mark.parametrize(
    ("reader", "code"),
    [("report", 2), ("compare", 2), ("grasps", 2), ("play", 2), ("replay", 0), ("export", 0), ("events", 0)],
)
def test_a_log_of_another_release_says_what_can_still_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str, code: int
) -> None:
    monkeypatch.chdir(tmp_path)
    other_release(tmp_path / "run.mcap")
    done = coop(*(word.replace(LOG, "run.mcap") for word in READERS[reader]))
    assert done.code == code, done.err
    if code:
        assert "AgentState without e_p, memory, shift, with another memory, of release 0.0.7" in done.err
        assert "`coop export`, `coop replay` and `coop events` read it as it is" in done.err


@pytest.mark.parametrize("command", ["report", "compare"])
def test_what_a_log_cannot_tell_is_said_beside_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """The figure itself is a dash."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agent.report.report.pictures", lambda _: [])
    write_run(tmp_path / "run.mcap", CELL, {ARM: rows()[:8]})
    done = coop(*(word.replace(LOG, "run.mcap") for word in READERS[command]))
    assert done.code == 0
    said = done.err.splitlines()
    assert f"run.mcap: no usable row of {ARM} after the transient of 0.05 s" in said
    assert any(line.startswith("run.mcap: no simulation in the log") for line in said)
    assert not any(line.startswith("coop: ") for line in said), "that is no error"


# --------------------------------------------------------------------------------------- files that are damaged or none


@cache
def whole() -> bytes:
    """A good log, five rows in each chunk."""
    with TemporaryDirectory() as name:
        return write_run(Path(name) / "run.mcap", CELL, {ARM: rows()}, in_chunk=5).read_bytes()


def bit_changed() -> bytes:
    data = bytearray(whole())
    data[int(0.55 * len(data))] ^= 4
    return bytes(data)


NONE_OF_OURS = {"empty": b"", "of text": b"time,q\n0,1\n", "a start alone": MAGIC, "an absent file": None}
DAMAGED = {"cut": ("the file ends without its index", lambda: whole()[: int(0.6 * len(whole()))]),
           "a bit changed": ("damaged at byte", bit_changed)}  # fmt: skip
TOO_SHORT = ("identify", "calibrate")  # these need more rows than a test has, damaged or not


@pytest.mark.parametrize("reader", [*READERS, "recover"])
def test_what_is_no_log_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str) -> None:
    monkeypatch.chdir(tmp_path)
    words = [word.replace(LOG, "run.mcap") for word in READERS.get(reader, REPAIR)]
    for what, data in NONE_OF_OURS.items():
        Path("run.mcap").unlink(missing_ok=True)
        if data is not None:
            Path("run.mcap").write_bytes(data)
        done = coop(*words)
        if (reader, what) == ("recover", "a start alone"):
            assert (done.code, "no row of an arm is in it, 0 messages" in done.out) == (1, True)
            continue
        assert done.code == 2, what
        assert "Traceback" not in done.err
        assert [line for line in done.err.splitlines() if line.startswith("coop: ")] == done.err.splitlines(), what
        assert "run.mcap" in done.err, what
        assert [path.name for path in Path().iterdir()] == (["run.mcap"] if data is not None else []), what


@pytest.mark.parametrize("reader", [*READERS, "recover"])
def test_a_pipe_in_the_place_of_a_log_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("run.mcap")
    done = coop(*(word.replace(LOG, "run.mcap") for word in READERS.get(reader, REPAIR)))
    assert done.code == 2
    assert "run.mcap: found no regular file" in done.err
    assert len(done.err.splitlines()) == 1


LEFT = [*product((name for name in (*READERS, "recover") if name not in TOO_SHORT), DAMAGED)]


@pytest.mark.parametrize(("reader", "damage"), few(LEFT, [*LEFT[::4], *LEFT[3::4]].__contains__))
def test_what_is_left_of_a_damaged_log_is_read_and_the_damage_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str, reader: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agent.report.report.pictures", lambda _: [])
    told, damaged = DAMAGED[damage]
    Path("run.mcap").write_bytes(damaged())
    done = coop(*(word.replace(LOG, "run.mcap") for word in READERS.get(reader, REPAIR)))
    assert done.code == ((reader, damage) == ("recover", "a bit changed")), done.err
    page = Path("out/report.html")
    assert told in done.err + done.out + (page.read_text() if page.exists() else ""), "a figure of a part says so"


def test_a_log_of_one_row_is_one_picture(tmp_path: Path) -> None:
    one_row(tmp_path / "run.mcap")
    done = coop("view", tmp_path / "run.mcap", "--film", tmp_path / "film.png")
    assert done.out == f"film     {tmp_path / 'film.png'}, 1 pictures\n", done.err


def test_another_release_is_shown_in_3d_if_it_has_what_a_picture_needs_and_named_if_not(tmp_path: Path) -> None:
    film, needs = tmp_path / "film.png", NEEDS[AGENT_STATE.ros_name]
    others = tuple(f.name for f in AGENT_STATE.fields if f.name not in {*needs, "config_id"})  # keeps the alignment
    write_other_release(tmp_path / "a.mcap", CELL, {ARM: rows()}, without=others)
    done = coop("view", tmp_path / "a.mcap", "--film", film)
    assert done.code == 0, done.err
    for name in needs - {"sequence", "utc_ns"}:  # a message itself has these
        pair = (name, "config_id") if name in {"mode", "flags", "joint_count"} else (name,)
        write_other_release(tmp_path / "b.mcap", CELL, {ARM: rows()[:1]}, without=pair)
        done = coop("view", tmp_path / "b.mcap", "--film", film, "--force")
        assert done.code == 2
        assert f"AgentState without {', '.join(sorted(pair))}, of release 0.0.7" in done.err
