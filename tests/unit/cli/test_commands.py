"""What every command has in common: help, version, typos, and how little is loaded for it."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import configs
from agent.cli import main
from tests.support.command import commands, coop

PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
PAPER = configs.CELLS_DIR / "paper.toml"


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("words", list(commands()), ids=" ".join)
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_every_command_has_help(words: tuple[str, ...], flag: str) -> None:
    done = coop(*words, flag)
    assert (done.code, done.err) == (0, "")
    assert f"Usage: coop {' '.join(words)} " in done.out
    assert "-h" in done.out


def test_the_program_itself_has_help_and_lists_every_command_in_full() -> None:
    done = coop("-h")
    assert done == coop("--help")
    assert done.code == 0
    listed = re.findall(r"^  (\w[\w-]*)  ", done.out, re.MULTILINE)
    assert sorted(listed) == sorted({words[0] for words in commands()}), "each once"
    assert "..." not in done.out.partition("\n")[2]
    assert "and verify the result." in " ".join(done.out.split()), "the end of a long line"
    headings = re.findall(r"^(\w.*):$", done.out, re.MULTILINE)
    assert headings == [
        "Options",
        "Simulate and examine",
        "Arms of this host",
        "Logs",
        "This installation",
        "Processes of a cell",
    ]


@pytest.mark.parametrize("words", [(), ("motors",)])
def test_without_a_command_the_help_is_shown(words: tuple[str, ...]) -> None:
    done = coop(*words)
    assert (done.code, done.out) == (2, "")
    assert done.err == coop(*words, "-h").out


def test_the_version_is_that_of_the_project() -> None:
    assert coop("--version").out == f"coop {PROJECT['version']}\n"


@pytest.mark.parametrize("words", list(commands()), ids=" ".join)
def test_a_mistyped_command_is_told_the_near_one(words: tuple[str, ...]) -> None:
    *group, name = words
    typo = name[:-2] + name[-1] + name[-2]
    done = coop(*group, typo)
    assert done.code == 2
    assert done.out == ""
    found = re.fullmatch(r"coop: No such command '([\w-]+)'\. Did you mean (.*)\? \(see `coop.* -h`\)\n", done.err)
    assert found is not None, done.err
    assert found[1] == typo
    assert f"'{name}'" in found[2]


def test_a_mistyped_option_is_told_the_near_one() -> None:
    done = coop("run", "paper", "--durtion", "5")
    assert done.code == 2
    assert done.err.startswith("coop: No such option: --durtion")
    assert "--duration" in done.err
    assert done.err.endswith("(see `coop run -h`)\n")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["check"], "Missing argument 'CELL' (see `coop check -h`)"),
        (["agent", "paper"], "Missing option '--arm' (see `coop agent -h`)"),
        (
            ["tune", "paper", "--form", "x"],
            "Invalid value for '--form': 'x' is not one of 'reality', 'ratio', 'rate' (see `coop tune -h`)",
        ),
        (["motors", "dump"], "Missing option '--port' (see `coop motors dump -h`)"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_wrong_command_line_is_one_line(words: list[str], line: str) -> None:
    done = coop(*words)
    assert (done.code, done.out, done.err) == (2, "", f"coop: {line}\n")


def test_the_installed_command_and_the_module_are_the_same(tmp_path: Path) -> None:
    assert PROJECT["scripts"] == {"coop": "agent.cli.__main__:main"}
    shown = [
        subprocess.run([sys.executable, *how, "--version"], capture_output=True, text=True, timeout=60).stdout
        for how in (["-m", "agent.cli"], ["-c", "from agent.cli.__main__ import main; main()"])
    ]
    assert shown == [f"coop {PROJECT['version']}\n"] * 2


@pytest.mark.parametrize(
    ("before", "ended"),
    [("", (130, "", "")), ("trap '' INT; ", (3, "goes on\n", ""))],  # as a script has what it runs in background
    ids=["heard", "ignored"],
)
def test_ctrl_c_while_the_command_loads_ends_it_without_a_word(
    tmp_path: Path, before: str, ended: tuple[int, str, str]
) -> None:
    loads = "import signal, sys\nsignal.raise_signal(signal.SIGINT)\nprint('goes on')\nsys.exit(3)\n"
    (tmp_path / "typer.py").write_text(loads)  # in the place of the first thing that takes long to load
    done = subprocess.run(
        ["sh", "-c", f'{before}exec "$0" -m agent.cli', sys.executable], env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == ended


def test_ctrl_c_before_a_line_is_read_ends_the_command_without_a_word() -> None:
    code = "import signal, agent.cli.main as m\nfrom agent.cli.__main__ import main\n"
    code += "m.settle = lambda: print(signal.raise_signal(signal.SIGINT))\nmain()\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_a_command_that_runs_hears_ctrl_c_as_python_does() -> None:
    code = "import signal, agent.cli.main as m\nfrom agent.cli.__main__ import main\n"
    code += "m.settle = lambda: print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)\nmain()\n"
    done = subprocess.run([sys.executable, "-c", code, "--version"], capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith("True\ncoop ")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (
            OSError(28, "No space left on device"),
            "this host: found No space left on device, expected it to do what was",
        ),
        (OSError(13, "Permission denied", "/x"), "/x: found Permission denied, expected a path that can be used; name"),
        (OSError(32, "Broken pipe"), "another process: found Broken pipe, expected it to go on listening; see why it"),
    ],
    ids=["host", "path", "another process"],
)
def test_what_the_system_refuses_is_one_line(monkeypatch: pytest.MonkeyPatch, error: OSError, line: str) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("agent.config.cell.load_cell", fail)
    done = coop("check", PAPER)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"coop: {line} ")
    assert done.err.count("\n") == 1


def test_a_defect_is_no_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.config.cell.load_cell", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        coop("check", PAPER)


def test_an_exit_code_reaches_the_caller() -> None:
    command = [sys.executable, "-m", "agent.cli", "where", "nothing"]
    assert subprocess.run(command, capture_output=True, timeout=60).returncode == 2


def test_libraries_start_as_a_command_needs_them_unless_the_user_says_otherwise() -> None:
    code = "import gc, os; from agent.cli.main import main\ntry: main(['--version'])\nexcept SystemExit: pass\n"
    code += "print('found', os.environ['OPENBLAS_NUM_THREADS'], os.environ['OMP_NUM_THREADS'],"
    code += " os.environ['PYDANTIC_DISABLE_PLUGINS'], gc.isenabled(), gc.get_threshold()[0])"
    assert "found 1 1 __all__ True 50000" in python(code)
    assert "found 3 1 none True" in python(
        f"import os; os.environ |= {{'OPENBLAS_NUM_THREADS': '3', 'PYDANTIC_DISABLE_PLUGINS': 'none'}}\n{code}"
    )


@pytest.mark.parametrize(
    ("line", "never"),
    [
        (
            ["--help"],
            {
                "agent.process.commands",
                "numpy",
                "pydantic",
                "rich",
                "pinocchio",
                "scipy",
                "zenoh",
                "matplotlib",
                "mcap",
            },
        ),
        (["run", "--help"], {"numpy", "pinocchio", "scipy", "zenoh", "matplotlib", "mcap"}),
        (["check", str(PAPER)], {"scipy.linalg", "scipy.interpolate", "zenoh", "matplotlib", "mcap", "dynamixel_sdk"}),
    ],
    ids=["help", "run help", "check"],
)
def test_a_quick_command_loads_nothing_heavy(line: list[str], never: set[str]) -> None:
    loaded = python(
        "import sys; from agent.cli.main import dispatch\n"
        f"assert dispatch({line!r}) == 0\nprint('LOADED', *sys.modules)"
    ).rpartition("LOADED")[2]
    assert not never & set(loaded.split())


def test_a_process_of_a_run_loads_nothing_that_it_does_not_use() -> None:
    """One after the other where what an earlier one loads is nothing that a later one must not."""
    heavy = {"typer", "pinocchio", "scipy"}
    ours = {"typer", "rich", "zenoh", "mcap", "agent.verify.thorough"}
    for chain in (
        {
            "started": {"typer", "numpy", "pydantic", "pinocchio", "zenoh"},
            "telemetry": {*heavy, "pydantic", "agent.config.files"},
            "recorder": heavy,
        },
        {"agent": ours, "plant": ours, "guard": ours, "run": {"matplotlib", "PIL"}},  # figures come with the report
    ):
        code = "import sys, agent.process.commands\n" + "".join(
            f"import agent.process.{module}; print({module!r}, *sys.modules)\n" for module in chain
        )
        for line, (module, never) in zip(python(code).splitlines(), chain.items(), strict=True):
            name, *loaded = line.split()
            assert (name, never & set(loaded)) == (module, set())


def test_a_line_is_read_by_the_command_that_it_names_or_by_all() -> None:
    for name in ("run", "latency-test", "motors"):
        assert list(main._command(name).commands) == [name]  # type: ignore[attr-defined]
    assert main._command("run") is main._command("run")
    for word in ("", "rnu", "--version"):
        assert len(main._command(word).commands) > 30  # type: ignore[attr-defined]


@pytest.mark.parametrize("found", [True, False])
def test_garbage_is_looked_for_again_after_a_check_and_after_one_that_refuses(found: bool) -> None:
    done = coop("check", str(PAPER) if found else "nowhere.toml")
    assert (done.code == 0) is found
    assert gc.isenabled()
