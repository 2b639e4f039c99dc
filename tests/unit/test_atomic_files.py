"""Files that are whole or not there: what a person is told of a place that takes none."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from agent.atomic import (
    WriteError,
    copy_atomically,
    place_of,
    require_place,
    require_writable,
    write_atomically,
    write_together,
)
from tests.support.full_disk import full_for


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "expected room for it; make room there, or name another path"),
        (errno.EDQUOT, "expected room for it; make room there, or name another path"),
        (errno.EROFS, "expected a folder to write it into; name another path"),
    ],
)
def test_a_disk_that_is_full_wants_room_and_another_one_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, said: str
) -> None:
    def full(_: int) -> None:
        raise OSError(number, os.strerror(number))

    (tmp_path / "log").write_text("before")
    (tmp_path / "source").write_text("after")
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        for write in (lambda p: write_atomically(p, b"after"), lambda p: copy_atomically(tmp_path / "source", p)):
            with pytest.raises(WriteError, match=f"file {tmp_path}/log: found {os.strerror(number)}, {said}"):
                write(tmp_path / "log")
            assert (tmp_path / "log").read_text() == "before"
            assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "source"]
    copy_atomically(tmp_path / "source", tmp_path / "log")
    assert (tmp_path / "log").read_text() == (tmp_path / "source").read_text() == "after"


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_a_stop_while_the_disk_is_waited_for_leaves_what_was_there_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: type[BaseException]
) -> None:
    def stopped(_: int) -> None:
        raise stop

    (tmp_path / "log").write_text("before")
    monkeypatch.setattr("os.fsync", stopped)
    with pytest.raises(stop):
        write_atomically(tmp_path / "log", b"after")
    assert [path.name for path in tmp_path.iterdir()] == ["log"]
    assert (tmp_path / "log").read_text() == "before"


@pytest.fixture
def closed() -> Iterator[None]:
    before = os.umask(0o077)
    yield
    os.umask(before)


@pytest.mark.usefixtures("closed")
def test_a_new_file_follows_the_umask_and_one_that_is_replaced_keeps_its_mode(tmp_path: Path) -> None:
    source, path = tmp_path / "source", tmp_path / "file"
    source.write_text("content")
    for write in (lambda: write_atomically(path, b"content"), lambda: copy_atomically(source, path)):
        write()
        assert mode(path) == 0o600
        assert os.umask(0o077) == 0o077
        for kept in (0o664, 0o444):
            path.chmod(kept)
            write()
            assert mode(path) == kept
        path.unlink()
    os.umask(0o002)
    write_atomically(path, b"content")
    assert mode(path) == 0o664
    write_atomically(path, b"content", mode=0o600)
    assert mode(path) == 0o600


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_of_files_that_are_written_together_none_stays_that_is_new_where_one_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "old").write_text("before")
    files = {tmp_path / name: name.encode() for name in ("one", "old", "two", "three")}
    with monkeypatch.context() as patch:
        full_for(patch, "two")
        with pytest.raises(WriteError, match="two: found No space left"):
            write_together(files)
    assert [path.name for path in tmp_path.iterdir()] == ["old"]
    write_together(files)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == files


# What is no file, and what leads to one


def copy_of_it(path: Path) -> None:
    source = path.with_name("source")
    source.write_bytes(b"after")
    copy_atomically(source, path)
    source.unlink()


WRITERS = {
    "write": lambda path: write_atomically(path, b"after"),
    "copy": copy_of_it,
    "together": lambda path: write_together({path: b"after"}),
}
each_writer = pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS.keys())


@pytest.mark.parametrize("linked", [False, True], ids=["", "by a link"])
@pytest.mark.parametrize(("make", "kind"), [(os.mkfifo, "a pipe"), (os.mkdir, "a folder")], ids=["pipe", "folder"])
def test_what_is_no_file_is_refused_before_the_work_and_at_it_and_stays(
    tmp_path: Path, make: Callable[[Path], None], kind: str, linked: bool
) -> None:
    """A device, too: as root a command had replaced /dev/null by its page."""
    path = other = tmp_path / "out"
    make(other)
    if linked:
        path = tmp_path / "link"
        path.symlink_to("out")
    before = {found.name: found.lstat() for found in tmp_path.iterdir()}
    asked = lambda p: require_place(p, force=True)  # noqa: E731 - as those beside it
    for refused in (asked, require_writable, place_of, lambda p: write_atomically(p, b"after"),
                    lambda p: write_together({tmp_path / "new": b"after", p: b"after"})):  # fmt: skip
        with pytest.raises(WriteError, match=f"file {path}: found {kind}, expected a file, or nothing; name another"):
            refused(path)
        assert {found.name: found.lstat() for found in tmp_path.iterdir()}.keys() == before.keys()
        assert stat.S_IFMT(other.stat().st_mode) == stat.S_IFMT(before["out"].st_mode)


@each_writer
def test_a_file_at_the_end_of_a_link_is_replaced_whole_and_the_link_stays(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    far, link = tmp_path / "far" / "file", tmp_path / "link"
    far.parent.mkdir()
    far.write_bytes(b"before")
    far.chmod(0o640)
    inode = far.stat().st_ino
    link.symlink_to("far/file")
    write(link)
    assert (link.readlink(), far.read_bytes(), mode(far)) == (Path("far/file"), b"after", 0o640)
    assert far.stat().st_ino != inode, "another file with the name, so that nobody reads half of it"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["far", "file", "link"]


@each_writer
def test_a_link_to_nothing_gets_what_it_leads_to(tmp_path: Path, write: Callable[[Path], None]) -> None:
    link = tmp_path / "link"
    link.symlink_to("file")
    write(link)
    assert (link.readlink(), (tmp_path / "file").read_bytes()) == (Path("file"), b"after")
    assert not (tmp_path / "file").is_symlink()


def test_a_link_to_itself_leads_to_no_place(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to("link")
    with pytest.raises(WriteError, match="found Too many levels of symbolic links"):
        write_atomically(link, b"after")
    assert link.readlink() == Path("link")


def test_what_a_link_to_nothing_got_goes_too_where_another_file_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / "link"
    link.symlink_to("one")
    full_for(monkeypatch, "two")
    with pytest.raises(WriteError, match="two: found No space left"):
        write_together({link: b"1", tmp_path / "two": b"2"})
    assert list(tmp_path.iterdir()) == [link]
