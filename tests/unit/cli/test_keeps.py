"""Every command that writes a file keeps what is there, unless `--force` says otherwise or the file is its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from datetime import datetime, tzinfo
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from mcap.writer import Writer

import configs
from agent.atomic import WriteError
from agent.config.cell import load_cell
from agent.host.latency import newest
from agent.identify.equations import Options
from agent.identify.fit import fit
from agent.identify.result import Identified, identified
from agent.identify.run import write
from agent.log.file import LogInTheWay
from agent.process import folder
from agent.process.folder import LOG_NAME, RunError, output_folder, words_folder, words_of
from agent.process.unbegun import StoppedEarly
from agent.report.names import picture_files
from agent.report.page import figure_html
from agent.report.picture import Picture
from agent.verify import along
from tests.support.command import coop
from tests.support.drawn_once import drawn_once
from tests.support.few import few
from tests.support.full_disk import full_for
from tests.support.identify_rig import exact
from tests.support.servos.motor_emulator import loose_servos
from tests.support.telemetry.log_maker import LogMaker, make_log
from tests.support.telemetry.run_log import write_run
from tests.support.telemetry.synthetic_run import paper_run
from tests.support.telemetry.telemetry_cell import make_rows

PAPER = configs.CELLS_DIR / "paper.toml"
MINE = b"mine\n"


def write_mine(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(MINE)
    return path


# tune


def test_tune_keeps_the_file_it_is_told_to_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(along, "PLACES", 3)  # of the motion
    path = write_mine(tmp_path / "new.toml")
    done = coop("tune", PAPER, "--form", "rate", "--write", path)
    assert done.code == 2
    assert done.err == f"coop: file {path}: found one of that name, expected none; name another, or give --force\n"
    assert path.read_bytes() == MINE
    assert coop("tune", PAPER, "--form", "rate", "--write", path, "--force").code == 0
    assert load_cell(path).file.name == "paper"


def test_tune_does_not_write_over_its_own_input(tmp_path: Path) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_bytes(PAPER.read_bytes())
    done = coop("tune", cell, "--write", cell)
    assert done.code == 2
    assert "--force" in done.err
    assert cell.read_bytes() == PAPER.read_bytes()


@pytest.mark.parametrize("force", [(), ("--force",)], ids=["", "force"])
@pytest.mark.parametrize(
    "words",
    [
        ("tune", "nothing.toml", "--write", "no/file"),
        ("new", "no/file", "--arm", "no arm at all"),
        ("replay", "nothing.mcap", "--set", "controller.k_p_per_s=1.0", "--picture", "no/file"),
        ("compare", "nothing.mcap", "b.mcap", "--html", "no/file"),
        ("view", "nothing.mcap", "--html", "no/file"),
        ("view", "nothing.mcap", "--film", "no/file"),
        ("motors", "dump", "--port", "nothing", "--out", "no/file"),
    ],
    ids=lambda words: words[0],
)
def test_a_folder_that_is_not_there_is_told_before_the_work(
    tmp_path: Path, words: tuple[str, ...], force: tuple[str, ...]
) -> None:
    """And before what else is wrong, which only the work would find."""
    done = coop(*words, *force, cwd=tmp_path)
    expected = "file no/file: found no folder no, expected a folder to write it into; make it, or name another path"
    assert (done.code, done.err.replace(str(tmp_path) + "/", "")) == (2, f"coop: {expected}\n")


@pytest.mark.parametrize(
    "words",
    [
        ("tune", "nothing.toml", "--write", "pipe"),
        ("view", "nothing.mcap", "--html", "pipe"),
        ("view", "nothing.mcap", "--film", "pipe"),
        ("compare", "nothing.mcap", "b.mcap", "--html", "pipe"),
    ],
    ids=lambda words: words[-2],
)
def test_force_replaces_no_pipe_and_no_device(tmp_path: Path, words: tuple[str, ...]) -> None:
    os.mkfifo(tmp_path / "pipe")
    done = coop(*words, "--force", cwd=tmp_path)
    expected = "file pipe: found a pipe, expected a file, or nothing; name another path"
    assert (done.code, done.err) == (2, f"coop: {expected}\n")
    assert (tmp_path / "pipe").is_fifo()


def test_a_rehearsal_without_a_folder_for_its_log_does_not_begin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.faults.rehearse.rehearse", None)
    done = coop("faults", "inject", "paper", "servo-off", "--out", "no/log.mcap", cwd=tmp_path)
    assert done.code == 4
    assert done.err.startswith(
        "coop: file no/log.mcap: found no folder no, expected a folder to write it into; make it"
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        ("tune", PAPER, "--write", "link"),
        ("new", "link", "--arm", "wx200", "--arm", "wx200", "--mass", "0.06", "--size", "0.2,0.05,0.05"),
        ("replay", "run.mcap", "--set", "controller.k_p_per_s=1.0", "--picture", "link"),
        ("compare", "a.mcap", "b.mcap", "--html", "link"),
        ("view", "run.mcap", "--html", "link"),
        ("view", "run.mcap", "--film", "link"),
        ("motors", "dump", "--port", "port", "--out", "link"),
        ("pki", PAPER, "link"),
        ("latency-test", "--seconds", "1", "--priority", "0", "--no-load", "--out", "link"),
    ],
    ids=lambda words: words[0],
)
def test_a_link_that_leads_nowhere_is_something_too(tmp_path: Path, words: tuple[str | Path, ...]) -> None:
    link = tmp_path / "link"
    link.symlink_to("elsewhere.toml")
    done = coop(*words, cwd=tmp_path)
    assert done.code == 2
    assert " link: found " in done.err.replace(str(tmp_path) + "/", "")
    assert link.readlink() == Path("elsewhere.toml")
    assert list(tmp_path.iterdir()) == [link]


# latency-test


def test_a_latency_test_replaces_an_earlier_one_and_nothing_else(tmp_path: Path) -> None:
    path = write_mine(tmp_path / "latency.json")
    test = ("latency-test", "--seconds", "1", "--priority", "0", "--no-load", "--out", path)
    done = coop(*test)
    assert (done.code, path.read_bytes()) == (2, MINE)
    assert "found what is no latency test, expected" in done.err
    path.unlink()
    for _ in range(2):
        assert coop(*test).code == 1, "without real time and load a host is doubtful at best"
    assert newest([path]) is not None


# identify


each_of_its_files = pytest.mark.parametrize(
    "name", few(("wx200.toml", "identify_wx200.png", "identify_wx200.json"), "wx200.toml".__eq__)
)


@pytest.fixture(scope="module")
def found() -> Iterator[Identified]:
    cell = load_cell(configs.CELLS_DIR / "identify_wx200.toml")
    recording = exact(cell, 0.6, (0.3, 0.7, 1.3), 20.0)
    with drawn_once("agent.identify.run", "validation_figure"):
        yield identified(recording, Options(), fit(recording, Options()))


@each_of_its_files
def test_identify_keeps_each_of_its_files(
    found: Identified, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("agent.identify.run.identify", lambda *_, **__: found)
    out = tmp_path / "out"
    path = write_mine(out / name)
    done = coop("identify", "run.mcap", "--out", out)
    assert done.code == 2
    assert str(path) in done.err
    assert "--force" in done.err
    assert list(out.iterdir()) == [path], "nothing else was written either"
    assert path.read_bytes() == MINE
    assert coop("identify", "run.mcap", "--out", out, "--force").code == 0
    assert path.read_bytes() != MINE
    assert len(list(out.iterdir())) == 3


@each_of_its_files
def test_identify_leaves_nothing_new_on_a_disk_that_is_full_and_can_be_repeated(
    found: Identified, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("agent.identify.run.identify", lambda *_, **__: found)
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        full_for(patch, name)
        done = coop("identify", "run.mcap", "--out", out)
    assert done.code == 2
    assert f"file {out / name}: found No space left on device, expected room for it" in done.err
    assert not list(out.iterdir())
    assert coop("identify", "run.mcap", "--out", out).code == 0
    path = write_mine(out / "identify_wx200.png")
    with monkeypatch.context() as patch:
        full_for(patch, "wx200.toml")
        assert coop("identify", "run.mcap", "--out", out, "--force").code == 2
    assert len(list(out.iterdir())) == 3, "what was there is there"
    assert path.read_bytes() != MINE


def test_identify_writes_the_urdf_that_the_arm_file_had_beside_it(found: Identified, tmp_path: Path) -> None:
    arm, out = found.recording.arm, tmp_path / "out"
    own = replace(arm, urdf_xml=arm.urdf_xml.replace('<mass value="0.540142"/>', '<mass value="0.5"/>'), own_urdf=True)
    lighter = replace(found, recording=replace(found.recording, arm=own))
    write(found, tmp_path / "shipped")
    assert not list((tmp_path / "shipped").glob("*.urdf"))
    path = write_mine(out / "wx200.urdf")
    with pytest.raises(WriteError, match=r"wx200\.urdf: found one of that name"):
        write(lighter, out)
    with pytest.raises(WriteError, match=r"wx200\.urdf: found another one than that of this name which ships"):
        write(found, out, replace=True)
    assert [(file, file.read_bytes()) for file in out.iterdir()] == [(path, MINE)]
    path.unlink()
    write(lighter, out)
    text = (configs.CELLS_DIR / "identify_wx200.toml").read_text()
    (tmp_path / "cell.toml").write_text(
        text.replace('model = "wx200"\n', 'model = "wx200"\narm_file = "out/wx200.toml"\n')
    )
    assert load_cell(tmp_path / "cell.toml").arms[0].urdf_xml == own.urdf_xml != arm.urdf_xml


# report


@pytest.fixture
def a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, str]]:
    """`coop report` of a log that is quickly drawn."""
    monkeypatch.setattr("agent.log.read.open_log", lambda path: nullcontext(paper_run(path, duration_s=21.0)))
    monkeypatch.setattr("agent.report.report.pictures", lambda _: [])

    def report(*arguments: str | Path) -> tuple[int, str]:
        done = coop("report", *arguments)
        return done.code, done.err

    return report


def test_a_report_is_made_again_beside_its_log(tmp_path: Path, a_report: Callable[..., tuple[int, str]]) -> None:
    log = write_mine(tmp_path / "run.mcap")
    assert a_report(log) == (0, "")
    (tmp_path / "report.html").write_bytes(MINE)
    assert a_report(log) == (0, "")
    assert (tmp_path / "report.html").read_bytes() != MINE
    assert log.read_bytes() == MINE


@pytest.mark.parametrize("name", ["report.html", "results.json"])
def test_a_report_of_another_log_is_kept(tmp_path: Path, a_report: Callable[..., tuple[int, str]], name: str) -> None:
    log, other = write_mine(tmp_path / "a" / "run.mcap"), write_mine(tmp_path / "b" / name)
    code, error = a_report(log, "--out", other.parent)
    assert (code, other.read_bytes()) == (2, MINE)
    assert "--force" in error
    assert a_report(log, "--out", other.parent, "--force") == (0, "")
    assert other.read_bytes() != MINE


@pytest.mark.parametrize("name", ["errors.png", "start.png", "view.html"])
def test_pictures_that_no_report_made_are_kept(
    tmp_path: Path, a_report: Callable[..., tuple[int, str]], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    drawn = Picture("errors", "Errors", "", lambda: Figure((1.0, 1.0)))
    monkeypatch.setattr("agent.report.report.pictures", lambda _: [drawn])
    monkeypatch.setattr("agent.view.film.still", lambda _: b"drawn")
    monkeypatch.setattr("agent.cli.logs._write_view", lambda _, folder: (folder / "view.html").write_text("3D"))
    log, other = write_mine(tmp_path / "run.mcap"), write_mine(tmp_path / name)
    code, error = a_report(log, "--view")
    assert (code, sorted(path.name for path in tmp_path.iterdir())) == (2, sorted(["run.mcap", name]))
    assert f"{name}: found one of that name, expected none; name another folder with --out, or give --force" in error
    if name == "view.html":
        assert a_report(log) == (0, ""), "which is not made here"
        assert other.read_bytes() == MINE
    assert a_report(log, "--view", "--force") == (0, "")
    assert other.read_bytes() != MINE
    assert a_report(log, "--view") == (0, ""), "its own"


def test_of_two_logs_in_one_folder_none_takes_the_others_report(
    tmp_path: Path, a_report: Callable[..., tuple[int, str]]
) -> None:
    first, second = write_mine(tmp_path / "1.mcap"), write_mine(tmp_path / "2.mcap")
    assert a_report(first) == (0, "")
    before = (tmp_path / "results.json").read_bytes()
    assert a_report(second)[0] == 2
    assert (tmp_path / "results.json").read_bytes() == before
    assert a_report(second, "--out", tmp_path / "second") == (0, "")


# run


def test_a_run_keeps_the_results_in_its_folder(tmp_path: Path) -> None:
    path = write_mine(tmp_path / "out" / "results.json")
    done = coop("run", PAPER, "--duration", "1", "--out", path.parent)
    assert done.code == 2
    assert "found results.json from an earlier run, expected a folder without results" in done.err
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    "name", ["errors.png", "torque_terms_left.png", "start.png", "logs/plant.log", "logs/arm-left.log"]
)
def test_a_run_keeps_a_picture_or_a_log_that_no_earlier_run_has_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """`coop report` refuses the same picture."""
    path = write_mine(tmp_path / "out" / name)
    monkeypatch.setattr("agent.process.run._carry_out", None)  # nothing starts
    done = coop("run", PAPER, "--duration", "1", "--out", path.parent if "/" not in name else path.parents[1])
    expected = "expected a folder without what a run writes; name another with --out, or give --force"
    assert (done.code, done.err) == (
        2, f"coop: output folder {tmp_path}/out: found {name}, perhaps of no earlier run, {expected}\n"
    )  # fmt: skip
    assert [found for found in tmp_path.rglob("*") if found.is_file()] == [path]
    assert path.read_bytes() == MINE


def test_a_run_minds_neither_a_picture_that_it_does_not_draw_nor_files_it_does_not_write(tmp_path: Path) -> None:
    for name in ("errors.png", "holiday.png", "logs/notes.txt", "torque_terms_other.png"):
        write_mine(tmp_path / name)
    with output_folder(tmp_path, "paper", own=words_of(["left"])) as out:
        assert out == tmp_path
    with (
        pytest.raises(RunError, match=r"found errors\.png"),
        output_folder(tmp_path, "paper", own=picture_files(["left"])),
    ):
        pass
    with output_folder(tmp_path, "paper", own=picture_files(["left"]), replace=True):
        assert (tmp_path / "errors.png").read_bytes() == MINE, "the report replaces it, if there is one"


def test_what_processes_of_a_run_that_failed_have_said_may_be_written_over(tmp_path: Path) -> None:
    """It has left no log, and is begun again with the same command."""
    own = [*words_of(["left"]), *picture_files(["left"])]
    with output_folder(tmp_path, "paper", own=own) as out:
        write_mine(words_folder(out) / "recorder.log")
        write_mine(words_folder(out) / "arm-left.log")
    with output_folder(tmp_path, "paper", own=own):
        pass
    write_mine(tmp_path / "errors.png")
    with pytest.raises(RunError, match=r"found errors\.png"), output_folder(tmp_path, "paper", own=own):
        pass


@pytest.mark.parametrize(("rows", "kept"), [(0, False), (3, True)])
def test_a_run_that_is_stopped_before_its_first_row_may_be_given_again(tmp_path: Path, rows: int, kept: bool) -> None:
    """The remedy says so; a log that holds a row stays, as does one that cannot be read."""

    def stopped(out: Path, write: Callable[[Path], object]) -> None:
        with output_folder(out, "paper"):
            write(out / LOG_NAME)
            raise StoppedEarly.of("run")

    with pytest.raises(StoppedEarly):
        stopped(tmp_path, lambda log: write_run(log, load_cell(PAPER), {"left": make_rows("left", rows)}))
    assert (tmp_path / LOG_NAME).exists() is kept
    with pytest.raises(RunError) if kept else nullcontext(), output_folder(tmp_path, "paper"):
        pass
    with pytest.raises(StoppedEarly):
        stopped(tmp_path / "b", write_mine)
    assert (tmp_path / "b" / LOG_NAME).exists()


def test_a_file_by_the_name_of_the_folder_of_words_is_one_line(tmp_path: Path) -> None:
    path = write_mine(tmp_path / "logs")
    with pytest.raises(RunError, match=rf"folder {path}: found File exists, expected a folder that can be written"):
        words_folder(tmp_path)
    assert path.read_bytes() == MINE


def test_the_folder_of_a_run_is_empty_or_may_be_used_again(tmp_path: Path) -> None:
    new = tmp_path / "a" / "b"
    for _ in range(2):  # the second time it is there, and empty
        with output_folder(new, "paper") as out:
            assert out == new
    (new / "results.json").symlink_to("elsewhere")
    with pytest.raises(RunError, match=r"found results\.json from an earlier run"), output_folder(new, "paper"):
        pass
    (new / "results.json").unlink()
    log = write_mine(new / LOG_NAME)
    with pytest.raises(RunError, match=r"found run\.mcap from an earlier run") as refused, output_folder(new, "paper"):
        pass
    assert refused.value.exit_code == 2
    assert log.read_bytes() == MINE
    with output_folder(new, "paper", replace=True):
        assert not log.exists(), "the recorder makes a new one"


@pytest.mark.parametrize("gone", ["", "results.json", "errors.png", "report.html"])
def test_force_takes_what_was_told_of_the_earlier_run_and_no_file_of_somebody(tmp_path: Path, gone: str) -> None:
    """Or a run that fails, or draws no report, leaves its log beside figures of another."""
    pictures = [Picture(stem, "Errors", "", Figure) for stem in ("errors", "torque_terms_left")]
    page = "".join(figure_html(picture, MINE) for picture in pictures)
    (tmp_path / "report.html").write_text(f'{page}<figure id="holiday"><img src="holiday.png"></figure>')
    told = [write_mine(tmp_path / name) for name in ("run.mcap", "results.json", "errors.png", "torque_terms_left.png")]
    (tmp_path / gone if gone else tmp_path / "none").unlink(missing_ok=True)
    mine = [write_mine(tmp_path / name) for name in ("holiday.png", "noticed.png", "notes.txt", "logs/plant.txt")]
    with output_folder(tmp_path, "paper", replace=True):
        left = {path for path in tmp_path.rglob("*") if path.is_file()}
    if gone == "report.html":  # which is what says whose pictures they are
        assert left == {*mine, *told[2:]}
    else:
        assert left == set(mine)


def test_a_report_that_cannot_be_removed_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "results.json").mkdir()
    with (
        pytest.raises(RunError, match="found Is a directory, expected files that can be removed; remove them, or name"),
        output_folder(tmp_path, "paper", replace=True),
    ):
        pass


@pytest.mark.parametrize(
    ("words", "force"), [(("float", "--emulate", "--arm", "left"), False), (("run",), True)], ids=["float", "run"]
)
def test_a_command_offers_force_only_where_it_has_it(tmp_path: Path, words: tuple[str, ...], force: bool) -> None:
    write_mine(tmp_path / LOG_NAME)
    done = coop(words[0], "paper_real", *words[1:], "--out", tmp_path)
    assert done.code == 2
    remedy = "name another with --out" + (", or give --force" if force else "")
    assert done.err.endswith(f"found run.mcap from an earlier run, expected a folder without results; {remedy}\n")
    assert ("--force" in coop(words[0], "--help").out) is force


def test_force_does_not_take_the_log_of_a_living_recorder(tmp_path: Path) -> None:
    log = tmp_path / LOG_NAME
    maker = LogMaker(log)
    with pytest.raises(LogInTheWay, match="being written"), output_folder(tmp_path, "paper", replace=True):
        pass
    assert log.exists()
    maker.finish()
    with output_folder(tmp_path, "paper", replace=True):
        assert not log.exists()


@pytest.mark.parametrize("replace", [False, True])
def test_a_folder_belongs_to_one_run_until_that_has_ended(tmp_path: Path, replace: bool) -> None:
    """Two at once would each write over what the other's processes have to say, whoever has the log."""
    with output_folder(tmp_path, "paper"):
        with (
            pytest.raises(RunError, match=rf"found another run that .* lock of process {os.getpid()} \(") as refused,
            output_folder(tmp_path, "paper", replace=replace),
        ):
            pass
        assert refused.value.exit_code == 2
    with output_folder(tmp_path, "paper", replace=replace):
        assert list(tmp_path.iterdir()) == [], "nothing is left of the claim"


def test_runs_that_begin_in_one_second_have_a_folder_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class StandingClock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> StandingClock:
            return cls(2026, 11, 23, 4, 6, tzinfo=tz)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(folder, "datetime", StandingClock)
    with output_folder(None, "paper") as one, output_folder(None, "paper") as two:
        found = one, two
    with output_folder(None, "paper") as three:  # what the first ones left is theirs
        names = [path.name for path in (*found, three)]
    assert names == [f"20261123T040600Z-paper{number}" for number in ("", "_2", "_3")]


def test_a_link_to_nothing_in_the_folder_of_a_run_is_no_free_name(tmp_path: Path) -> None:
    (tmp_path / "results.json").symlink_to(tmp_path / "nowhere")
    with pytest.raises(RunError, match=r"found results\.json"), output_folder(tmp_path, "paper"):
        pass
    (tmp_path / LOG_NAME).symlink_to(tmp_path / "nowhere")
    with output_folder(tmp_path, "paper", replace=True):
        assert not (tmp_path / LOG_NAME).is_symlink(), "or the recorder finds it in its way"


# record, recover


def test_a_recorder_keeps_a_log_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_mine(tmp_path / "run.mcap")
    monkeypatch.setattr("agent.process.recorder.described", None)  # half a second's work, for nothing
    done = coop("record", PAPER, "--out", path, "--listen", "tcp/127.0.0.1:0")
    assert done.code == 2
    assert "a log is never overwritten" in done.err
    assert path.read_bytes() == MINE


@pytest.mark.parametrize("kind", few(("a pipe", "a link to nothing", "a folder"), "a pipe".__eq__))
def test_a_recorder_does_not_write_into_what_is_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "run.mcap"
    if kind == "a pipe":
        os.mkfifo(path)
    elif kind == "a link to nothing":
        path.symlink_to("nothing")
    else:
        path.mkdir()
    done = coop("record", PAPER, "--out", path, "--listen", "tcp/127.0.0.1:0")
    assert (done.code, "a log is never overwritten" in done.err) == (2, True)
    assert [file.name for file in tmp_path.iterdir() if file.suffix == ".mcap"] == ["run.mcap"]


def test_recover_says_that_a_file_has_nothing_of_a_run(tmp_path: Path) -> None:
    other, start = tmp_path / "other.mcap", tmp_path / "start.mcap"
    with other.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "somebody else")
        schema = writer.register_schema("std_msgs/msg/Bool", "ros2msg", b"bool data")
        channel = writer.register_channel("/on", "cdr", schema)
        for k in range(3):
            writer.add_message(channel, k, b"\x00\x01\x00\x00\x01", k)
        writer.finish()
    make_log(start, finish=False)
    start.write_bytes(start.read_bytes()[:20])
    done = coop("recover", other)
    said = f"{other}: nothing to repair; no row of an arm is in it, 3 messages written by somebody else\n"
    assert (done.code, done.out) == (1, said)
    done = coop("recover", start)
    assert (done.code, done.out) == (1, f"{start}: repaired; no row of an arm is in it, 0 messages\n")


def test_recover_replaces_only_a_log_that_was_not_finished(tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole.mcap", tmp_path / "broken.mcap"
    make_log(whole)
    make_log(broken, finish=False)
    before = whole.read_bytes()
    done = coop("recover", whole)
    assert (done.code, "nothing to repair" in done.out, "read back" in done.out) == (0, True, True)
    assert whole.read_bytes() == before
    assert "repaired" in coop("recover", broken).out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["broken.mcap", "whole.mcap"]


def test_recover_leaves_a_damaged_finished_log_and_keeps_it_when_forced(tmp_path: Path) -> None:
    path, original = tmp_path / "run.mcap", tmp_path / "run.mcap.damaged"
    make_log(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    done = coop("recover", path)
    assert (done.code, path.read_bytes()) == (1, data)
    assert "damaged at byte" in done.err
    assert "left as it is" in done.out
    done = coop("recover", path, "--force")
    assert (done.code, original.read_bytes()) == (1, data)
    assert f"the damaged original is kept as {original}" in done.out


# motors dump


def test_a_dump_keeps_an_older_one(tmp_path: Path) -> None:
    path = write_mine(tmp_path / "arm.toml")
    with loose_servos(tmp_path / "port", {"model": "XM430-W350", "servo_id": 2, "Baud_Rate": 3}):
        dump = ("motors", "dump", "--port", tmp_path / "port", "--baud", "1000000", "--out", path)
        done = coop(*dump)
        assert (done.code, path.read_bytes()) == (2, MINE)
        assert "--force" in done.err
        done = coop(*dump, "--force")
        assert done.code == 0, done.err
    assert b"XM430-W350" in path.read_bytes()


# What processes of a cell leave in the file system is their own kind of file, and they replace no other


@pytest.mark.parametrize(
    "words",
    [
        ("agent", PAPER, "--arm", "left", "--driver", "sim", "--ring", "mine"),
        ("agent", PAPER, "--arm", "left", "--driver", "dynamixel", "--port", "x", "--ring", "r", "--control", "mine"),
        ("plant", PAPER, "--socket", "socket", "--ring", "mine"),
        ("plant", PAPER, "--socket", "mine", "--ring", "ring"),
        ("emulate", PAPER, "--ports", "ports", "--ring", "mine"),
        ("emulate", PAPER, "--ports", "ports", "--ring", "ring", "--control", "mine"),
        ("emulate", PAPER, "--ports", ".", "--ring", "ring"),
    ],
    ids=lambda words: f"{words[0]} {words[-2]}",
)
def test_no_process_replaces_a_file_that_is_none_of_its_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str | Path, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    mine = [write_mine(tmp_path / name) for name in ("mine", "left")]
    done = coop(*words)
    assert done.code != 0
    assert os.linesep not in done.err.rstrip()
    assert [path.read_bytes() for path in mine] == [MINE, MINE]
