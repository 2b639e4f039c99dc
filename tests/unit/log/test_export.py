"""Exported tables hold the numbers of the log, whole or not at all, and nothing is written over."""

from __future__ import annotations

import csv
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from agent.atomic import WriteError
from agent.log import export as module
from agent.log import load
from agent.log.export import Choice, Exported, Format, export
from agent.log.read import LogError, open_log
from agent.log.run import MissingPackage
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import MEMORY_LENGTH
from tests.support.command import coop
from tests.support.telemetry.log_maker import LogMaker, make_log
from tests.support.telemetry.telemetry_cell import make_rows

FILES = {"left", "right", "plant"}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    make_log(path, events=[Event(5, "left", Level.WARN, "mode, „TRACK“ → HOLD", {"limit": 1.5})])
    return path


def exported(log: Path, out: Path, kind: Format = Format.CSV, choice: Choice = Choice(), **options: bool) -> Exported:  # noqa: B008
    with open_log(log, any_layout=True) as opened:
        return export(opened, out, kind, choice, replace=options.get("replace", False))


def read_csv(path: Path) -> dict[str, list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, map(list, zip(*rows, strict=True)), strict=True))


def test_csv_holds_every_number_bit_for_bit(log: Path, tmp_path: Path) -> None:
    done = exported(log, tmp_path / "out")
    assert done.rows == {"left.csv": 100, "right.csv": 100, "plant.csv": 100, "events.csv": 1}
    for name in FILES:
        table = read_csv(tmp_path / "out" / f"{name}.csv")
        own = load(log)[name]
        expected = own.columns(*(f for f in own.fields if f != "memory"))
        assert list(table) == list(expected)
        for column, values in expected.items():
            found = np.array([values.dtype.type(text) for text in table[column]])
            assert found.tobytes() == np.ascontiguousarray(values).tobytes(), column


def test_what_is_no_number_is_empty_and_infinity_is_told(tmp_path: Path) -> None:
    rows = make_rows("left", 4)
    rows["sigma_min"] = [np.nan, np.inf, -np.inf, 1.5]
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    maker.write("left", rows)
    maker.finish()
    exported(tmp_path / "run.mcap", tmp_path / "out", choice=Choice(fields=("sigma_min",)))
    table = read_csv(tmp_path / "out" / "left.csv")
    assert list(table) == ["t_s", "sigma_min"], "no row is without its time"
    assert table["sigma_min"] == ["", "inf", "-inf", "1.5"]


def test_parquet_holds_every_number_with_its_unit(log: Path, tmp_path: Path) -> None:
    exported(log, tmp_path / "out", Format.PARQUET)
    for name in FILES:
        table = parquet.read_table(tmp_path / "out" / f"{name}.parquet")
        own = load(log)[name]
        expected = own.columns(*(f for f in own.fields if f != "memory"))
        assert table.column_names == list(expected)
        for column, values in expected.items():
            found = table[column].to_numpy()
            assert found.dtype == values.dtype
            assert found.tobytes() == np.ascontiguousarray(values).tobytes(), column
    assert parquet.read_schema(tmp_path / "out" / "left.parquet").field("t_s").metadata[b"unit"] == b"s"


def test_events_and_the_meaning_of_columns_lie_beside_them(log: Path, tmp_path: Path) -> None:
    exported(log, tmp_path / "out")
    events = read_csv(tmp_path / "out" / "events.csv")
    assert (events["level"], events["text"]) == (["WARN"], ["mode, „TRACK“ → HOLD"])
    assert json.loads(events["data"][0]) == {"limit": 1.5}
    columns = read_csv(tmp_path / "out" / "columns.csv")
    at = columns["column"].index("dq_joint_2_rad_per_s")
    assert (columns["table"][at], columns["unit"][at], columns["field"][at]) == ("left", "rad/s", "dq")
    assert columns["meaning"][at] == "joint velocities the law used"


def test_events_have_the_time_of_the_trajectory_and_are_those_of_the_arms_and_time_asked_for(tmp_path: Path) -> None:
    told = [
        Event(5, "left", Level.WARN, "early", {"t": 0.05}), Event(6, "left", Level.INFO, "begins", {"t": 0.1}),
        Event(7, "right", Level.INFO, "other", {"t": 0.15}), Event(8, "left", Level.INFO, "by the wall alone"),
        Event(9, "left", Level.INFO, "behind", {"t": 0.2}), Event(10, "recorder", Level.INFO, "of nobody's time"),
        Event(11, "left", Level.INFO, "by its clock", {"stamp_ns": 0}),
    ]  # fmt: skip
    make_log(tmp_path / "run.mcap", events=told)

    def texts(choice: Choice) -> list[str]:
        out = tmp_path / str(len(list(tmp_path.iterdir())))
        exported(tmp_path / "run.mcap", out, choice=choice)
        return read_csv(out / "events.csv")["text"]

    assert texts(Choice(from_s=0.1, to_s=0.2)) == ["begins", "other", "by the wall alone", "of nobody's time"]
    assert texts(Choice(("left",), from_s=0.1, to_s=0.2)) == ["begins", "by the wall alone"]
    assert texts(Choice(("plant", "right"))) == ["other"]
    exported(tmp_path / "run.mcap", tmp_path / "all")
    every = read_csv(tmp_path / "all" / "events.csv")
    assert list(every)[:3] == ["utc_ns", "t_s", "source"]
    first = 1e-9 * -int(make_rows("left", 1)["stamp_ns"][0]) + float(make_rows("left", 1)["t"][0])
    assert every["t_s"][:-1] == ["0.05", "0.1", "0.15", "", "0.2", ""]
    assert float(every["t_s"][-1]) == pytest.approx(first)


def test_a_field_that_is_named_twice_is_one_column(log: Path, tmp_path: Path) -> None:
    exported(log, tmp_path / "out", choice=Choice(("left",), ("q", "t", "q", "q")))
    with (tmp_path / "out" / "left.csv").open(newline="", encoding="utf-8") as file:
        head = next(csv.reader(file))
    assert head == ["q_joint_1_rad", "q_joint_2_rad", "q_joint_3_rad", "t_s"]


@pytest.mark.parametrize("kind", Format)
def test_an_arm_that_is_called_as_a_file_beside_it_keeps_its_rows(tmp_path: Path, kind: Format) -> None:
    arms = dict.fromkeys(("events", "columns"), ("waist", "shoulder", "elbow"))
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False, arms=arms)
    for name in arms:
        maker.write(name, make_rows(name, 4))
    maker.finish()
    done = exported(tmp_path / "run.mcap", tmp_path / "out", kind)
    own = "-arm.csv" if kind is Format.CSV else ".parquet"
    assert done.rows == {f"events{own}": 4, f"columns{own}": 4, "events.csv": 0}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*done.rows, "columns.csv"}
    if kind is Format.CSV:
        for name in arms:
            assert len(read_csv(tmp_path / "out" / f"{name}-arm.csv")["t_s"]) == 4
        tables = read_csv(tmp_path / "out" / "columns.csv")["table"]
        assert set(tables) == set(arms), "by the names of the arms"


def test_arms_fields_and_times_can_be_chosen(log: Path, tmp_path: Path) -> None:
    done = exported(log, tmp_path / "out", choice=Choice(("right",), ("t", "memory"), 0.1, 0.2))
    assert done.rows == {"right.csv": 20, "events.csv": 0}
    table = read_csv(tmp_path / "out" / "right.csv")
    assert list(table)[:2] == ["t_s", "memory_0"]
    assert len(table) == 1 + MEMORY_LENGTH
    assert (float(table["t_s"][0]), float(table["t_s"][-1])) == (0.1, 0.195)


def test_seconds_are_the_same_instants_in_all_tables(tmp_path: Path) -> None:
    """The arms wait a quarter of a second for the start; the plant's own time begins with the wait."""
    maker = LogMaker(tmp_path / "run.mcap")
    for member in FILES:
        rows = make_rows(member, 100)
        rows["t"] -= 0.0 if member == "plant" else 0.25
        maker.write(member, rows)
    maker.flush()
    maker.finish()
    exported(tmp_path / "run.mcap", tmp_path / "out", choice=Choice(from_s=0.0, to_s=0.1))
    left, plant = (read_csv(tmp_path / "out" / f"{name}.csv") for name in ("left", "plant"))
    assert left["stamp_ns"] == plant["stamp_ns"]
    assert [float(t) for t in plant["t_s"]] == pytest.approx([float(t) for t in left["t_s"]], abs=1e-12)
    assert plant["sequence"] == [str(k) for k in range(50, 70)]
    told = dict(zip(*(read_csv(tmp_path / "out" / "columns.csv")[key] for key in ("column", "meaning")), strict=True))
    assert told["t_s"] == "time since the trajectory's zero"


def test_a_field_is_taken_from_those_that_have_it(log: Path, tmp_path: Path) -> None:
    done = exported(log, tmp_path / "out", choice=Choice(fields=("t", "tau_sent")))
    assert set(done.rows) == {"left.csv", "right.csv", "plant.csv", "events.csv"}
    assert list(read_csv(tmp_path / "out" / "plant.csv")) == ["t_s"]
    done = exported(log, tmp_path / "some", choice=Choice(fields=("tau_sent",)))
    assert set(done.rows) == {"left.csv", "right.csv", "events.csv"}


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        (Choice(("middle",)), "found 'middle', expected one of left, right, plant"),
        (Choice(fields=("qq",)), "found 'qq', expected one of sequence"),
        (Choice(from_s=3.0, to_s=2.0), "nothing to export"),
        (Choice(from_s=99.0), "nothing to export"),
    ],
)
def test_a_choice_of_nothing_is_refused_and_leaves_nothing(
    log: Path, tmp_path: Path, choice: Choice, message: str
) -> None:
    with pytest.raises(LogError, match=message):
        exported(log, tmp_path / "out", choice=choice)
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_a_folder_with_something_in_it_is_kept(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    exported(log, out)
    (out / "left.csv").write_text("mine\n")
    (out / "notes").write_text("mine\n")
    with pytest.raises(WriteError, match="found something there"):
        exported(log, out)
    assert (out / "left.csv").read_text() == "mine\n"
    exported(log, out, replace=True)
    assert (out / "left.csv").read_text() != "mine\n"
    assert (out / "notes").read_text() == "mine\n"
    file = tmp_path / "file"
    file.write_text("mine\n")
    for replace in (False, True):
        with pytest.raises(WriteError):
            exported(log, file, replace=replace)
    assert file.read_text() == "mine\n"


def test_what_is_no_file_by_the_name_of_a_table_stays_and_nothing_is_written(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    os.mkfifo(out / "left.csv")
    with pytest.raises(WriteError, match=f"file {out}/left.csv: found a pipe, expected a file, or nothing"):
        exported(log, out, replace=True)
    assert list(out.iterdir()) == [out / "left.csv"]
    assert (out / "left.csv").is_fifo()


def test_no_table_of_an_earlier_export_stays_beside_new_ones(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    exported(log, out)
    (out / "third.csv").write_text("mine\n")
    exported(log, out, Format.PARQUET, Choice(members=("left",)), replace=True)
    assert {path.name for path in out.iterdir()} == {"left.parquet", "events.csv", "columns.csv", "third.csv"}
    assert set(read_csv(out / "columns.csv")["table"]) == {"left"}


def test_an_export_that_was_cut_off_still_names_what_is_to_go(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, replace = tmp_path / "out", Path.replace
    exported(log, out)
    listed = (out / "columns.csv").read_bytes()
    (out / "left.csv").write_text("")

    def cut_off(self: Path, target: Path) -> Path:
        if target.name == "columns.csv":
            raise OSError(5, "Input/output error")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", cut_off)
    with pytest.raises(WriteError, match="Input/output error"):
        exported(log, out, choice=Choice(members=("left",)), replace=True)
    assert (out / "columns.csv").read_bytes() == listed
    assert (out / "left.csv").read_text(), "all else is there by then"


@pytest.mark.parametrize("text", ["table,column\nright,q\n", "\0", "table,column,unit,field,meaning\n../mine,q,,,\n\n"])
def test_a_list_of_columns_that_is_another_s_removes_nothing(log: Path, tmp_path: Path, text: str) -> None:
    out, kept = tmp_path / "out", [tmp_path / "mine.csv", tmp_path / "out" / "right.csv"]
    out.mkdir()
    (out / "columns.csv").write_text(text)
    for path in kept:
        path.write_text("mine\n")
    exported(log, out, choice=Choice(members=("left",)), replace=True)
    assert [path.read_text() for path in kept] == ["mine\n", "mine\n"]


@pytest.mark.parametrize("kind", Format)
def test_a_disk_that_fails_leaves_no_half_file(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: Format
) -> None:
    write, seen = module._WRITERS[kind], []

    def fail_at_the_second(path: Path, *rest: object) -> None:
        seen.append(path)
        if len(seen) == 2:
            path.write_bytes(b"half")
            raise OSError(28, "No space left on device")
        write(path, *rest)  # type: ignore[arg-type]

    monkeypatch.setitem(module._WRITERS, kind, fail_at_the_second)
    with pytest.raises(WriteError, match="No space left on device"):
        exported(log, tmp_path / "out", kind)
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_without_pyarrow_parquet_is_refused_before_anything_is_written(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingPackage, match="or export CSV"):
        exported(log, tmp_path / "out", Format.PARQUET)
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_the_command_writes_beside_the_log_and_says_what(log: Path, tmp_path: Path) -> None:
    done = coop("export", log)
    out = tmp_path / "run-csv"
    assert (done.code, done.err) == (0, "")
    assert done.out.splitlines()[0] == f"{out / 'left.csv'}  100 rows"
    assert coop("export", log).code == 2
    assert coop("export", log, "--force").code == 0
    log.write_bytes(log.read_bytes()[:-100])
    done = coop("export", log, "--out", tmp_path / "cut")
    assert done.code == 0
    assert "the file ends without its index" in done.err
