"""Where the processes of a cell meet on a host that nobody has prepared."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from agent.host import paths
from agent.host.paths import (
    PlaceError,
    barred,
    control_in,
    control_path,
    control_paths,
    emulated_port_in,
    foreign_folder,
    guard_in,
    guard_path,
    make_runtime_dir,
    plant_socket_in,
    plant_socket_path,
    ring_in,
    ring_path,
    ring_paths,
    runtime_dir,
)


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


def test_a_name_is_the_same_in_every_folder_in_which_processes_meet(session: Path) -> None:
    run, cell, unit = Path("/dev/shm/coop-run-x"), session / "coop" / "paper", Path("/run/coop/left")
    assert [p.name for p in (ring_in(run, "left"), control_in(run, "left"), guard_in(run, "left"))] == [
        "left.ring", "left.control", "left.guard",
    ]  # fmt: skip
    assert (plant_socket_in(run), emulated_port_in(run, "left")) == (run / "plant.sock", run / "left")
    assert ring_paths("paper", "left") == (ring_in(cell, "left"), ring_in(unit, "left"))
    assert control_paths("paper", "left") == (control_in(cell, "left"), control_in(unit, "left"))
    assert (guard_path("paper", "left"), plant_socket_path("paper")) == (guard_in(cell, "left"), plant_socket_in(cell))


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


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A host without session folders, on which this process is one of another user than all folders."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(paths, "SHARED_DIR", tmp_path)
    make_runtime_dir("paper").joinpath("left.ring").touch()
    monkeypatch.setattr(paths.os, "geteuid", lambda: 12345)
    return tmp_path / f"coop-{os.getuid()}"


def test_a_place_in_another_users_folder_is_barred(shared: Path) -> None:
    found = f"folder {shared} is one of uid {os.getuid()}, not of uid 12345"
    assert barred(ring_path("paper", "left")) == barred(control_path("paper", "left")) == found
    assert foreign_folder("paper") == found


def test_a_place_in_ones_own_folder_and_one_that_is_named_are_free(
    shared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert barred(paths.SERVICES_DIR / "left" / "left.ring") == barred(shared / "left.ring") == ""
    monkeypatch.setattr(paths.os, "geteuid", os.getuid)
    assert barred(ring_path("paper", "left")) == barred(ring_path("paper", "none")) == foreign_folder("paper") == ""


def test_a_folder_that_is_missing_is_not_looked_into_and_belongs_to_nobody(shared: Path) -> None:
    (shared / "coop" / "paper").rename(shared / "coop" / "other")
    (shared / "coop").rename(shared.with_name("coop"))
    shared.rmdir()
    assert barred(ring_path("paper", "left")) == "No such file or directory"
    assert foreign_folder("paper") == ""


@pytest.mark.parametrize("laid", ["coop", "coop/paper"])
def test_a_link_to_a_folder_of_ones_own_bars_a_place(shared: Path, monkeypatch: pytest.MonkeyPatch, laid: str) -> None:
    monkeypatch.setattr(paths.os, "geteuid", os.getuid)
    (shared / laid).rename(shared.with_name("own"))
    (shared / laid).symlink_to(shared.with_name("own"))
    assert (
        barred(control_path("paper", "left")) == f"folder {shared / laid} is a link or file, not of uid {os.getuid()}"
    )


def test_the_session_of_who_became_root_is_not_barred(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_runtime_dir("paper")
    monkeypatch.setattr(paths.os, "geteuid", lambda: 12345)
    assert barred(control_path("paper", "left")) == foreign_folder("paper") == ""
