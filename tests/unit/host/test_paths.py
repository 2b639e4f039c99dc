"""Where the processes of a cell meet on a host that nobody has prepared."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from agent.host import paths
from agent.host.paths import PlaceError, control_path, make_runtime_dir, plant_socket_path, ring_path, runtime_dir


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


def test_everything_of_a_cell_lies_in_one_folder(session: Path) -> None:
    folder = session / "coop" / "paper"
    assert runtime_dir("paper") == folder
    assert {p.parent for p in (ring_path("paper", "a"), control_path("paper", "a"), plant_socket_path("paper"))} == {
        folder
    }


def test_names_alone_make_nothing(session: Path) -> None:
    ring_path("paper", "left")
    assert list(session.iterdir()) == []


def test_the_folder_is_made_for_its_user_alone_and_may_be_there(session: Path) -> None:
    for _ in range(2):
        assert make_runtime_dir("paper") == session / "coop" / "paper"
    for folder in (session / "coop", session / "coop" / "paper"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.parametrize("value", [None, "", "/nonexistent/run/user/1"])
def test_without_a_session_folder_it_is_one_of_the_user_in_tmp(
    monkeypatch: pytest.MonkeyPatch, value: str | None
) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    if value is not None:
        monkeypatch.setenv("XDG_RUNTIME_DIR", value)
    assert runtime_dir("paper") == Path(f"/tmp/coop-{os.getuid()}/coop/paper")


def test_a_service_uses_the_folder_its_manager_made(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/coop/left:/run/other")
    assert make_runtime_dir("paper") == Path("/run/coop/left")
    assert list(session.iterdir()) == []


def test_another_users_folder_is_refused(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_runtime_dir("paper")
    monkeypatch.setattr(paths.os, "geteuid", lambda: 12345)
    with pytest.raises(
        PlaceError, match=rf"found one of uid {os.getuid()}, expected one of uid 12345; have it removed"
    ):
        make_runtime_dir("paper")


def test_a_link_that_somebody_else_has_laid_there_is_refused(session: Path) -> None:
    elsewhere = session / "elsewhere"
    elsewhere.mkdir()
    (session / "coop").symlink_to(elsewhere)
    with pytest.raises(PlaceError, match="found a link or file, expected a folder of your own"):
        make_runtime_dir("paper")


def test_a_folder_that_cannot_be_made_says_what_to_do(session: Path) -> None:
    (session / "coop").write_text("")
    with pytest.raises(PlaceError, match="set XDG_RUNTIME_DIR to a folder that you can write, or give every path"):
        make_runtime_dir("paper")
