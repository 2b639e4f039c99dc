"""Completion as a shell asks for it: the words so far in, candidates out."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import typer

import configs
from agent.cli import complete
from agent.cli.main import whole
from agent.faults.catalogue import rows
from agent.faults.plan import NAMES
from tests.support.command import coop

SHIPPED = sorted(path.stem for path in configs.CELLS_DIR.glob("*.toml"))


Offered = Callable[[str], list[str]]


@pytest.fixture
def offered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Offered:
    """What bash is offered for the last word of a line, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def ask(line: str) -> list[str]:
        asked = {"_COOP_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
        for key, value in asked.items():
            monkeypatch.setenv(key, value)
        done = coop()
        assert (done.code, done.err) == (0, "")
        return done.out.split()

    return ask


def test_cells_are_offered_by_name(offered: Offered, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("")
    assert offered("coop check ") == [*SHIPPED, "mine.toml"]
    assert offered("coop run two_w") == ["two_wx200"]


def test_commands_and_options_are_offered(offered: Offered) -> None:
    assert offered("coop tel") == ["telemetry"]
    assert offered("coop motors s") == ["scan", "setup"]
    assert set(offered("coop tune paper --f")) == {"--form", "--force"}
    assert offered("coop tune paper --form r") == ["reality", "ratio", "rate"]


def test_arms_are_those_of_the_cell(offered: Offered, tmp_path: Path) -> None:
    assert offered("coop agent paper --arm ") == ["left", "right"]
    assert offered("coop telemetry paper --member ") == ["left", "right", "plant"]
    (tmp_path / "mine.toml").write_text('[[arms]]\nname = "north"\n[[arms]]\nname = "south"\n')
    assert offered("coop stop mine.toml --arm n") == ["north"]


def test_settings_are_those_of_the_cell(offered: Offered) -> None:
    assert offered("coop run paper --set rate") == ["rate_hz=200.0"]
    assert offered("coop motors setup --arm-model wx200 --joint e") == ["elbow"]


def test_arms_of_a_new_cell_are_the_described_models(offered: Offered) -> None:
    assert offered("coop new x.toml --arm wx2") == ["wx200", "wx250", "wx250s"]
    assert offered("coop new x.toml --arm wx200 --arm ") == sorted(
        path.stem for path in configs.ARMS_DIR.glob("*.toml")
    )


def test_faults_are_those_that_inject_knows_and_rows_that_it_can_show(offered: Offered) -> None:
    assert offered("coop faults inject paper servo-o") == [name for name in NAMES if name.startswith("servo-o")]
    found = offered("coop faults inject paper ")
    assert found == [*NAMES, *(row.id for row in rows() if row.faults or row.runs)]
    assert {"F1", "servo-off"} <= set(found)
    without = [row.id for row in rows() if not (row.faults or row.runs)]
    assert without
    assert not set(without) & set(found), "which it refuses"


def test_a_folder_named_like_a_cell_does_not_hide_it(offered: Offered, tmp_path: Path) -> None:
    (tmp_path / "paper").mkdir()
    assert offered("coop agent paper --arm l") == ["left"]


# The completers themselves, without a process


def context(**parameters: object) -> typer.Context:
    found = typer.Context(whole())
    found.params.update(parameters)
    return found


def test_settings_are_the_keys_of_the_cell_with_their_values() -> None:
    cell = context(cell=Path("paper"))
    assert complete.settings(cell, "rate") == ["rate_hz=200.0"]
    assert complete.settings(cell, "arms.left.load") == ["arms.left.load_share=0.5"]
    assert complete.settings(cell, "controller.friction_f") == ["controller.friction_feedforward=true"]
    assert complete.settings(cell, "world.gravity") == ["world.gravity_m_per_s2="], "a list is for the user to type"


def test_every_setting_offered_is_one_that_the_cell_takes() -> None:
    from agent.config.cell import load_cell

    for name in SHIPPED:
        pairs = complete.settings(context(cell=Path(name)), "")
        assert pairs
        load_cell(configs.CELLS_DIR / f"{name}.toml", [pair for pair in pairs if not pair.endswith("=")])


@pytest.mark.parametrize("text", [None, b"\xff\xfe", b"arms = 3", b"[[arms", b"[[arms]]\nname = 5\n[arms.x]\ny = 1"])
def test_a_cell_that_cannot_be_read_offers_nothing(tmp_path: Path, text: bytes | None) -> None:
    path = tmp_path / "broken.toml"
    if text is not None:
        path.write_bytes(text)
    assert complete.arms(context(cell=path), "") == []
    assert complete.arms(context(), "") == []
    assert all("=" in pair for pair in complete.settings(context(cell=path), ""))


def test_arm_models_and_their_joints() -> None:
    assert complete.arm_models("wx2") == ["wx200", "wx250", "wx250s"]
    assert complete.joints(context(arm_model="wx200"), "") == [
        "waist", "shoulder", "elbow", "wrist_angle", "wrist_rotate", "gripper",
    ]  # fmt: skip
    assert complete.joints(context(arm_file=str(configs.ARMS_DIR / "wx200.toml")), "el") == ["elbow"]
    assert complete.joints(context(arm_model="other"), "") == ["gripper"]
    assert complete.joints(context(), "grip") == ["gripper"]


# The scripts that shells load


@pytest.mark.parametrize(("shell", "says"), [("bash", "complete -o"), ("zsh", "#compdef coop"), ("fish", "complete ")])
def test_each_shell_has_a_script_for_this_program(monkeypatch: pytest.MonkeyPatch, shell: str, says: str) -> None:
    monkeypatch.setenv("_COOP_COMPLETE", f"source_{shell}")
    done = coop()
    assert (done.code, done.err) == (0, "")
    assert says in done.out
    assert "_COOP_COMPLETE=complete_" + shell in done.out


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_with_the_script_of_this_program(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "coop"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m agent.cli "$@"\n')
    program.chmod(0o755)
    script = (
        f'export PATH={program.parent}:$PATH\neval "$(_COOP_COMPLETE=source_bash coop)"\n'
        'COMP_WORDS=(coop check paper_a)\nCOMP_CWORD=2\n_coop_completion coop\necho "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(["bash", "--norc", "-c", script], capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.stdout == "paper_adaptive\n", done.stderr


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_installing_adds_to_the_shells_own_file_and_keeps_what_is_in_it(tmp_path: Path) -> None:
    (tmp_path / ".bashrc").write_text("alias mine=yes\n")
    command = f"{sys.executable} -m agent.cli --install-completion; true"
    done = subprocess.run(
        ["bash", "--norc", "-c", command], env=os.environ | {"HOME": str(tmp_path)}, capture_output=True, text=True,
        timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / ".bashrc").read_text().startswith("alias mine=yes\n")
    assert "coop.sh" in (tmp_path / ".bashrc").read_text()
    assert "_coop_completion" in (tmp_path / ".bash_completions" / "coop.sh").read_text()
