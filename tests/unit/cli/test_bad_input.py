"""Whatever a command is given that is no good: one line on standard error, an exit code, nothing on standard output."""

from __future__ import annotations

import os
import re
from itertools import product
from pathlib import Path
from typing import Any

import pytest

import configs
from tests.support.command import commands, coop
from tests.support.few import few

PAPER = str(configs.CELLS_DIR / "paper.toml")
BAD = "{bad}"
LEFT = ("--arm", "left", "--ring", "ring")

# every argument and option that names a file to read, of every command
READS = {
    "run": ("run", BAD),
    "check": ("check", BAD),
    "tune": ("tune", BAD),
    "study": ("study", BAD),
    "start": ("start", BAD, "--in", "1"),
    "stop": ("stop", BAD),
    "release": ("release", BAD),
    "status": ("status", BAD),
    "agent": ("agent", BAD, "--arm", "left"),
    "plant": ("plant", BAD),
    "emulate": ("emulate", BAD),
    "emulate --faults": ("emulate", PAPER, "--ports", "ports", "--ring", "ring", "--faults", BAD),
    "telemetry": ("telemetry", BAD, "--member", "left"),
    "telemetry --network-config": ("telemetry", PAPER, "--member", "left", "--ring", "ring", "--network-config", BAD),
    "record": ("record", BAD),
    "record --network-config": ("record", PAPER, "--out", "log.mcap", "--network-config", BAD),
    "ros2": ("ros2", BAD),
    "ros2 --network-config": ("ros2", PAPER, "--network-config", BAD),
    "layout": ("layout", BAD),
    "report": ("report", BAD),
    "compare, first": ("compare", BAD, BAD),
    "view": ("view", BAD, "--no-browser"),
    "view --live": ("view", BAD, "--live", "--no-browser"),
    "view --html": ("view", BAD, "--html", "page.html"),
    "view --film": ("view", BAD, "--film", "film.gif"),
    "view --network-config": ("view", PAPER, "--live", "--no-browser", "--network-config", BAD),
    "identify": ("identify", BAD),
    "calibrate": ("calibrate", BAD),
    "play": ("play", BAD, "--listen", "tcp/127.0.0.1:0"),
    "replay": ("replay", BAD),
    "replay --same-as": ("replay", BAD, "--same-as", BAD),
    "events": ("events", BAD),
    "grasps": ("grasps", BAD),
    "export": ("export", BAD),
    "recover": ("recover", BAD),
    "doctor": ("doctor", BAD),
    "float": ("float", BAD, "--arm", "left"),
    "faults inject": ("faults", "inject", BAD, "bus-off"),
    "motors restore": ("motors", "restore", BAD, "--port", "/dev/null"),
}

OTHERS = {
    "run --set without a value": ("run", PAPER, "--set", "rate_hz"),
    "new without an object": ("new", "new.toml", "--arm", "wx200"),
    "new of an unknown arm": ("new", "new.toml", "--arm", "wx2000", "--mass", "1", "--size", "1,1,1"),
    "pki over a file": ("pki", PAPER, "a_file"),
    "new over a file": ("new", "a_file", "--arm", "wx200", "--mass", "1", "--size", "1,1,1"),
    "schema of a cell": ("schema", PAPER),
    "run --set of no table": ("run", PAPER, "--set", "rate_hz.x.y=1"),
    "run --set of an unknown arm": ("run", PAPER, "--set", "arms.middle.load_share=1"),
    "run --duration nan": ("run", PAPER, "--duration", "nan"),
    "run --duration inf": ("run", PAPER, "--duration", "inf"),
    "run --duration -1": ("run", PAPER, "--duration", "-1"),
    "run --duration 0": ("run", PAPER, "--duration", "0"),
    "run --duration of no cycle": ("run", PAPER, "--duration", "0.001"),
    "run --seed text": ("run", PAPER, "--seed", "x"),
    "run --faults without --wire": ("run", PAPER, "--faults", "x"),
    "run --out under a file": ("run", PAPER, "--out", "a_file/out"),
    "run --out a file": ("run", PAPER, "--out", "a_file"),
    "study --runs 0": ("study", PAPER, "--runs", "0"),
    "study --duration nan": ("study", PAPER, "--duration", "nan"),
    "study --duration 0": ("study", PAPER, "--duration", "0"),
    "study --out under a file": ("study", PAPER, "--out", "a_file/out"),
    "study --force --out a file": ("study", PAPER, "--force", "--out", "a_file"),
    "study --scheduler nonsense": ("study", PAPER, "--runs", "1", "--out", "elsewhere", "--scheduler", "nonsense://x"),
    "view as two things": ("view", "log.mcap", "--html", "a.html", "--film", "a.gif"),
    "view --film over a file": ("view", "log.mcap", "--film", "a_file"),
    "view --html over a file": ("view", "log.mcap", "--html", "a_file"),
    "view --port 0": ("view", "log.mcap", "--port", "0"),
    "view --live without a recorder": ("view", PAPER, "--live", "--no-browser", "--connect", "tcp/127.0.0.1:9"),
    "compare of one": ("compare", "log.mcap"),
    "where of nothing": ("where", "nothing_here"),
    "faults list of something": ("faults", "list", "something"),
    "faults inject of nothing": ("faults", "inject", PAPER, "nothing-off"),
    "faults inject into an unknown arm": ("faults", "inject", PAPER, "bus-off", "--arm", "middle"),
    "faults inject into an unknown servo": ("faults", "inject", PAPER, "bus-off", "--servo", "99"),
    "faults inject --at nan": ("faults", "inject", PAPER, "bus-off", "--at", "nan"),
    "faults inject --for 0": ("faults", "inject", PAPER, "bus-off", "--for", "0"),
    "faults inject --size -1": ("faults", "inject", PAPER, "bus-delayed", "--size", "-1"),
    "faults inject --for 1e7": ("faults", "inject", PAPER, "servo-off", "--for", "1e7", "--duration", "4"),
    "faults inject --size of none": ("faults", "inject", PAPER, "servo-off", "--size", "5"),
    "faults inject after the end": ("faults", "inject", PAPER, "bus-off", "--at", "2", "--duration", "2"),
    "faults inject --duration nan": ("faults", "inject", PAPER, "bus-off", "--duration", "nan"),
    "faults inject --out a file": ("faults", "inject", PAPER, "bus-off", "--out", "a_file"),
    "faults inject on real arms": ("faults", "inject", PAPER, "bus-off", "--set", "driver=dynamixel"),
    "check --set": ("check", PAPER, "--set", ""),
    "tune --form": ("tune", PAPER, "--form", "other"),
    "tune --damping nan": ("tune", PAPER, "--form", "rate", "--damping", "nan"),
    "tune --write nowhere": ("tune", PAPER, "--form", "rate", "--write", "no/where.toml"),
    "tune --write a folder": ("tune", PAPER, "--form", "rate", "--write", "a_folder"),
    "start without an instant": ("start", PAPER),
    "start --at": ("start", PAPER, "--at", "25:61:00"),
    "start --in nan": ("start", PAPER, "--in", "nan"),
    "start --in inf": ("start", PAPER, "--in", "inf"),
    "start --in long": ("start", PAPER, "--in", "1e300"),
    "start without an agent": ("start", PAPER, "--in", "1", "--control", "nobody"),
    "latency-test --seconds nan": ("latency-test", "--seconds", "nan"),
    "latency-test --rate": ("latency-test", "--rate", "1"),
    "latency-test --out": ("latency-test", "--seconds", "1", "--priority", "0", "--no-load", "--out", "a_file/x"),
    "stop of an unknown arm": ("stop", PAPER, "--arm", "middle"),
    "stop without an agent": ("stop", PAPER, "--control", "a_file"),
    "release of an unknown arm": ("release", PAPER, "--arm", "middle"),
    "agent of an unknown arm": ("agent", PAPER, "--arm", "middle", "--ring", "ring"),
    "agent without an arm": ("agent", PAPER),
    "agent --driver": ("agent", PAPER, "--arm", "left", "--driver", "other"),
    "agent --ring nowhere": ("agent", PAPER, "--arm", "left", "--driver", "sim", "--ring", "no/where"),
    "agent --ring a file": ("agent", PAPER, "--arm", "left", "--driver", "sim", "--ring", "a_file"),
    "agent --ring a folder": ("agent", PAPER, "--arm", "left", "--driver", "sim", "--ring", "a_folder"),
    "agent --plant-socket": ("agent", PAPER, "--arm", "left", "--ring", "ring", "--plant-socket", "a_file"),
    "agent --port": ("agent", PAPER, *LEFT, "--driver", "dynamixel", "--port", "a_file", "--control", "socket"),
    "agent --control": ("agent", PAPER, *LEFT, "--driver", "dynamixel", "--port", "x", "--control", "a_file"),
    "agent --priority": ("agent", PAPER, "--arm", "left", "--priority", "100"),
    "agent without its guard": ("agent", PAPER, *LEFT, "--control", "socket", "--real-time", "--guard", "x"),
    "agent in lockstep with a guard": ("agent", PAPER, *LEFT, "--guard", "x"),
    "guard of an unknown arm": ("guard", PAPER, "--arm", "middle"),
    "guard --port": ("guard", PAPER, "--arm", "left", "--driver", "dynamixel", "--port", "a_file"),
    "guard --post-mortem": ("guard", PAPER, "--arm", "left", "--driver", "sim", "--post-mortem", "a_file/folder"),
    "guard --priority": ("guard", PAPER, "--arm", "left", "--priority", "0"),
    "plant --socket": ("plant", PAPER, "--socket", "a_file", "--ring", "ring"),
    "plant --socket nowhere": ("plant", PAPER, "--socket", "no/where", "--ring", "ring"),
    "plant --ring": ("plant", PAPER, "--socket", "socket", "--ring", "a_folder"),
    "emulate --ports a file": ("emulate", PAPER, "--ports", "a_file"),
    "emulate --ports with files": ("emulate", PAPER, "--ports", "names", "--ring", "ring"),
    "emulate --ports with links": ("emulate", PAPER, "--ports", "links", "--ring", "ring"),
    "emulate --seed": ("emulate", PAPER, "--ports", "ports", "--ring", "ring", "--seed", "-1"),
    "emulate --seed text": ("emulate", PAPER, "--ports", "ports", "--ring", "ring", "--seed", "x"),
    "emulate --control": ("emulate", PAPER, "--ports", "ports", "--ring", "ring", "--control", "a_file"),
    "emulate --control nowhere": ("emulate", PAPER, "--ports", "ports", "--ring", "ring", "--control", "no/where"),
    "telemetry of an unknown arm": ("telemetry", PAPER, "--member", "middle", "--ring", "ring"),
    "telemetry --connect": ("telemetry", PAPER, "--member", "left", "--ring", "ring", "--connect", "nonsense"),
    "record --out nowhere": ("record", PAPER, "--out", "no/where.mcap", "--listen", "tcp/127.0.0.1:0"),
    "record --out a file": ("record", PAPER, "--out", "a_file", "--listen", "tcp/127.0.0.1:0"),
    "record --listen": ("record", PAPER, "--out", "log.mcap", "--listen", "nonsense"),
    "record --seed": ("record", PAPER, "--out", "log.mcap", "--seed", "-1"),
    "record --seed text": ("record", PAPER, "--out", "log.mcap", "--seed", "x"),
    "record --split-mb": ("record", PAPER, "--out", "log.mcap", "--split-mb", "0"),
    "record --split-s": ("record", PAPER, "--out", "log.mcap", "--split-s", "nan"),
    "record --keep-mb": ("record", PAPER, "--out", "log.mcap", "--keep-mb", "-1"),
    "ros2 --telemetry": ("ros2", PAPER, "--telemetry", "nonsense"),
    "ros2 without a recorder": ("ros2", PAPER, "--telemetry", "tcp/127.0.0.1:1"),
    "ros2 --domain": ("ros2", PAPER, "--domain", "233"),
    "layout --viewer": ("layout", PAPER, "--viewer", "other"),
    "play --speed": ("play", "a_file", "--speed", "0"),
    "play --start": ("play", "a_file", "--start", "-1"),
    "export --format": ("export", "a_file", "--format", "xlsx"),
    "identify --cutoff-hz": ("identify", "a_file", "--cutoff-hz", "0"),
    "doctor of an unknown arm": ("doctor", PAPER, "--arm", "middle"),
    "run of arms that float": ("run", "two_wx200", "--set", 'floating.arms=["left"]'),
    "float without an arm": ("float", "two_wx200"),
    "float of an unknown arm": ("float", "two_wx200", "--arm", "middle"),
    "float --ports": ("float", "two_wx200", "--arm", "left", "--ports", "nothing_here", "--yes"),
    "float without a port": ("float", PAPER, "--arm", "left", "--yes"),
    "float without a yes": ("float", "two_wx200", "--arm", "left", "--ports", "names"),
    "float of too fast an arm": ("float", "two_wx200", "--arm", "left", "--set", "floating.speed_max_rad_per_s=9"),
    "approach of an unknown arm": ("approach", PAPER, "--arm", "middle"),
    "grasp of an unknown arm": ("grasp", PAPER, "--arm", "middle"),
    "park of an unknown arm": ("park", PAPER, "--arm", "middle"),
    "lower --at": ("lower", PAPER, "--at", "25:00:00"),
    "guide --ever": ("guide", PAPER, "--ever"),
    "motors setup --arm-model": ("motors", "setup", "--port", "/dev/null", "--arm-model", "other", "--joint", "elbow"),
    "motors setup of no arm": ("motors", "setup", "--port", "/dev/null", "--joint", "elbow"),
    "motors setup of two arms": (
        "motors", "setup", "--port", "/dev/null", "--arm-model", "wx200", "--arm-file", "a_file", "--joint", "elbow",
    ),
    "motors setup --arm-file": ("motors", "setup", "--port", "/dev/null", "--arm-file", "a_file", "--joint", "elbow"),
    "motors setup --joint": ("motors", "setup", "--port", "/dev/null", "--arm-model", "wx200", "--joint", "knee"),
    "motors setup --port": ("motors", "setup", "--port", "a_file", "--arm-model", "wx200", "--joint", "elbow"),
    "motors mark of an unknown arm": ("motors", "mark", "two_wx200", "--arm", "middle"),
    "motors mark of a cell without": ("motors", "mark", "two_wx200", "--arm", "left"),
    "motors mark --set": ("motors", "mark", "two_wx200", "--arm", "left", "--set", "arms.left.dynamixel.mark=10"),
    "motors mark --ports": (
        "motors", "mark", "two_wx200", "--arm", "left", "--set", "arms.left.dynamixel.mark=1", "--ports", "names",
    ),
    "motors dump --port": ("motors", "dump", "--port", "a_file", "--out", "dump.toml"),
    "motors dump --baud": ("motors", "dump", "--port", "a_file", "--out", "dump.toml", "--baud", "7"),
    "motors scan --baud": ("motors", "scan", "--port", "a_file", "--baud", "x"),
    "motors scan --port": ("motors", "scan", "--port", "nothing_here", "--json"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with things that are no good."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    (tmp_path / "a_file").write_text("something of mine\n")
    (tmp_path / "a_folder").mkdir()
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "binary").write_bytes(os.urandom(5000))
    (tmp_path / "names").mkdir()
    (tmp_path / "names" / "left").write_text("mine\n")
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / "left").symlink_to("../a_file")
    return tmp_path


def refused(*arguments: str) -> str:
    """The line in which a command line is refused; the last of them where several things are wrong at once."""
    done = coop(*arguments)
    assert done.code not in (0, None), (done.out, done.err)
    lines = done.err.splitlines()
    assert lines, done.out
    told = [line for line in lines if line.startswith("coop: ")]
    assert told, done.err
    assert told == lines[-len(told) :], done.err
    assert len(told) == 1 or "empty" in arguments, done.err  # no key at all is many missing ones
    assert "Traceback" not in done.err
    for line in told:
        assert re.search(r": found .*, expected .+; .+|\(see `coop", line), line
    return lines[-1]


NO_FILES = ("nothing_here", "a_folder", "empty", "binary", "no/where/at/all")
NO_FAULTS = ("emulate --faults", "empty")  # is a file of no faults, with which the emulator runs


def cases() -> list[Any]:
    """A recorder finds it out in a process of its own, an emulator when it has its servos: half a second each."""
    pairs = [pair for pair in product(READS, NO_FILES) if pair != NO_FAULTS]
    once = {"record --network-config": "binary", "emulate --faults": "nothing_here"}
    return few(pairs, lambda pair: once.get(pair[0], pair[1]) == pair[1])


@pytest.mark.parametrize(("case", "bad"), cases())
@pytest.mark.fault("G1")
def test_a_file_that_is_none_is_one_line(folder: Path, case: str, bad: str) -> None:
    line = refused(*(word.replace(BAD, bad) for word in READS[case]))
    assert bad.rpartition("/")[2] in line, "says which file"
    assert (folder / "a_file").read_text() == "something of mine\n"


# another of a recorder, and of emulated servos, is in `make test`
PROCESSES = ("record --out nowhere", "record --listen", "emulate --control", "emulate --ports with files")


@pytest.mark.parametrize("case", few(OTHERS, lambda case: case not in PROCESSES))
def test_any_other_bad_word_is_one_line(folder: Path, case: str) -> None:
    refused(*OTHERS[case])
    assert (folder / "a_file").read_text() == "something of mine\n"
    assert (folder / "names" / "left").read_text() == "mine\n"
    assert (folder / "links" / "left").readlink() == Path("../a_file")
    assert list((folder / "a_folder").iterdir()) == []


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--priority", "5"], "--priority: found a run without --real-arms"),
        (["--gripper-empty", "--emulated"], "--gripper-empty, --emulated: found a run without --real-arms"),
        (["--hil", "left", "--allow-no-realtime"], "--allow-no-realtime: found a run without --real-arms"),
        (["--real-time", "--wire"], "--real-time with --wire: found 2 ways to run the cell, expected one of them"),
        (["--wire", "--hil", "left"], "--wire with --hil: found 2 ways"),
        (["--hil", "left,"], "--hil: found 'left,', expected names of arms with a comma between two"),
        (["--hil", 'left", "right'], "--hil: found 'left\", \"right', expected names of arms"),
        (["--real-time", "--real-arms"], "--real-time with --real-arms: found 2 ways"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_an_option_of_a_run_that_would_change_nothing_is_refused(folder: Path, options: list[str], told: str) -> None:
    done = coop("run", PAPER, "--duration", "0.001", *options)  # which is refused later
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"coop: {told}")


NO_FILM = "found a view without --film, expected a film; add --film, or leave it out"
NOT_LIVE = "found a view without --live, expected a run as it goes on; add --live, or leave it out"
NO_PAGE = "expected a page that is served; leave it out"
RIGID = "found --form reality, expected --form ratio or rate; ask for one of these, or leave it out"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("view", "no.mcap", "--html", "h.html", "--from", 0), f"--from: {NO_FILM}"),
        (("view", "no.mcap", "--to", 5, "--speed", 2.5), f"--to, --speed: {NO_FILM}"),
        (("view", PAPER, "--live", "--speed", 1), f"--speed: {NO_FILM}"),
        (("view", "no.mcap", "--html", "h.html", "--port", 8080), f"--port: found a view with --html, {NO_PAGE}"),
        (("view", "no.mcap", "--film", "f.gif", "--browser"), f"--browser: found a view with --film, {NO_PAGE}"),
        (("view", "no.mcap", "--connect", "tcp/127.0.0.1:7448"), f"--connect: {NOT_LIVE}"),
        (("view", "no.mcap", "--html", "h.html", "--set", "rate_hz=1.0"), f"--set: {NOT_LIVE}"),
        (("view", "no.mcap", "--film", "f.gif", "--network-config", "n.json5"), f"--network-config: {NOT_LIVE}"),
        (("tune", PAPER, "--damping", 0.05), f"--damping: {RIGID}"),
        (("tune", PAPER, "--form", "reality", "--radius", 0.99, "--damping", 0), f"--damping, --radius: {RIGID}"),
        (
            ("tune", PAPER, "--form", "rate", "--worst", 0.9),
            "--worst: found --form rate, expected --form reality; ask for that form, or leave it out",
        ),
        (
            ("tune", PAPER, "--form", "ratio", "--worst", 0.985),
            "--worst: found --form ratio, expected --form reality; ask for that form, or leave it out",
        ),
    ],
    ids=lambda value: " ".join(map(str, value[2:])) if isinstance(value, tuple) else "",
)
def test_an_option_of_a_view_or_a_search_that_would_change_nothing_is_refused(
    folder: Path, words: tuple[object, ...], told: str
) -> None:
    """Whatever its value is, the usual one too."""
    before = sorted(folder.iterdir())
    done = coop(*words)
    assert (done.code, done.out, done.err) == (2, "", f"coop: {told}\n")
    assert sorted(folder.iterdir()) == before


def test_the_help_names_the_margin_that_a_search_keeps_unasked() -> None:
    from agent.verify.tune import Margin

    said, usual = " ".join(coop("tune", "-h").out.split()), Margin()
    for text in (f"form reality ({usual.worst})", f"swings, other forms ({usual.damping})",
                 f"radius, other forms ({usual.radius})"):  # fmt: skip
        assert text in said


def test_no_command_is_forgotten() -> None:
    seen = {
        tuple(words[: 2 if words[0] in ("motors", "faults") else 1]) for words in (*READS.values(), *OTHERS.values())
    }
    assert seen == set(commands())


@pytest.mark.parametrize(
    ("command", "option"),
    [
        ("events", "--from"),
        ("events", "--to"),
        ("export", "--from"),
        ("export", "--to"),
        ("replay", "--from"),
        ("view", "--to"),
    ],
)
def test_an_instant_that_is_no_number_is_refused_by_its_option_and_not_by_the_log(command: str, option: str) -> None:
    done = coop(command, "log.mcap", option, "nan")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert f"Invalid value for '{option}': seconds are a number" in done.err


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("-1", "0.1,0.05,0.05"), "--mass: found -1, expected 1e-06 to 100 kg"),
        (("inf", "0.1,0.05,0.05"), "--mass: found inf, expected 1e-06 to 100 kg"),
        (("nan", "0.1,0.05,0.05"), "--mass: found nan, expected 1e-06 to 100 kg"),
        (("0.2", "0.1,0,0.05"), "--size: found 0.1,0,0.05, expected 1e-06 to 10 m"),
        (("0.2", "1e308,0.1,0.05"), "--size: found 1e+308,0.1,0.05, expected 1e-06 to 10 m"),
        (("99", "9,9,0.1"), "moments of inertia by --mass and --size: found 668.33"),
        (("0.2", "0.1,0.1,0.1", "--inertia", "1,1,1e300"), "--inertia: found 1,1,1e+300, expected 1e-12 to 100 kg·m²"),
    ],
)
def test_an_object_that_no_cell_may_have_is_refused_by_its_option(
    words: tuple[str, ...], found: str, tmp_path: Path
) -> None:
    arms, (mass, size, *more) = ("--arm", "wx200", "--arm", "wx200"), words
    done = coop("new", tmp_path / "cell.toml", *arms, "--mass", mass, "--size", size, *more)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert f"coop: {found}" in done.err
    assert not (tmp_path / "cell.toml").exists()
