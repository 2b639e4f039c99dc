"""`make` on a host that lacks something: one line with the remedy, before pip starts."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.packages import SOURCE


def make_run(folder: Path, python: str) -> subprocess.CompletedProcess[str]:
    """`make run` in a folder that holds nothing but what make reads: pip would have nothing to install there."""
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy(SOURCE / name, folder)
    command = ["make", "run", f"PYTHON={python}"]
    outer = ("MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES")  # of the make that runs these tests
    environment = {name: value for name, value in os.environ.items() if name not in outer}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, env=environment)


def python_that(folder: Path, begins: str) -> str:
    """This Python as another one would be: it executes `begins` before anything else."""
    changed = folder / "changed"
    changed.mkdir()
    (changed / "sitecustomize.py").write_text(begins)
    wrapper = folder / "python"
    wrapper.write_text(f'#!/bin/sh\nPYTHONPATH={changed} exec {sys.executable} "$@"\n')
    wrapper.chmod(0o755)
    return str(wrapper)


@pytest.mark.parametrize(
    ("begins", "line"),
    [
        (
            "import sys; sys.version_info = (3, 9, 2, 'final', 0)",
            "coop: Python is 3.9, needed 3.11 or newer (Debian 12 has it): make run PYTHON=python3.11",
        ),
        (
            "import sys; sys.maxsize = 2**31 - 1",
            "coop: Python has 32 bits, pinocchio needs 64: install a 64-bit system",
        ),
        (
            "import sys; sys.modules['ensurepip'] = None",
            "coop: {python} cannot make an environment: apt install python3-venv",
        ),
    ],
)
def test_a_python_that_will_not_do_is_refused_in_one_line(tmp_path: Path, begins: str, line: str) -> None:
    python = python_that(tmp_path, begins)
    done = make_run(tmp_path, python)
    assert done.returncode != 0
    assert done.stderr.splitlines()[0] == line.format(python=python)
    assert not (tmp_path / ".venv").exists()
    assert done.stdout == ""


def test_no_python_is_refused_in_one_line(tmp_path: Path) -> None:
    done = make_run(tmp_path, "nosuchpython")
    assert done.returncode != 0
    assert done.stderr.splitlines()[0] == "coop: no nosuchpython here: apt install python3 python3-venv"
    assert not (tmp_path / ".venv").exists()


@pytest.mark.parametrize(
    ("works", "files", "made"),
    [
        (0, (".venv/pyvenv.cfg",), []),
        (1, (".venv/pyvenv.cfg",), ["-m venv --clear .venv"]),
        (1, (), ["-m venv .venv"]),  # a folder that is no environment keeps what is in it
    ],
)
def test_an_environment_that_works_keeps_the_python_it_began_with(
    tmp_path: Path, works: int, files: tuple[str, ...], made: list[str]
) -> None:
    said = tmp_path / "said"
    scripts = {
        "another": f'[ "$2" = venv ] && {{ echo "$@" >>{said}; exit 0; }}\nexec {sys.executable} "$@"',
        ".venv/bin/python": f"exit {works}",
        ".venv/bin/pip": f'echo "$1" >>{said}',
        ".venv/bin/coop": "exit 0",
    }
    (tmp_path / ".venv/bin").mkdir(parents=True)
    for name in files:
        (tmp_path / name).touch()
    for name, does in scripts.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n")
        (tmp_path / name).chmod(0o755)
    done = make_run(tmp_path, str(tmp_path / "another"))
    assert done.returncode == 0, done.stderr
    assert said.read_text().splitlines() == [*made, "install"]
