"""Who may sit down at the plant, and where it listens."""

from __future__ import annotations

import os
import socket
import stat
import threading
from pathlib import Path

import pytest

from drivers.interface import ConnectError
from sim_backend.physics.spec import PlantError
from sim_backend.served.driver import SimDriver
from sim_backend.served.listener import Listener
from sim_backend.served.protocol import MessageKind, header_only, words
from tests.support.plant.plant_cells import PLANAR_JOINTS
from tests.support.plant.served_plant import CONFIG_ID, ServedPlant, cycle, cycling


@pytest.mark.parametrize(
    ("arm", "settings", "message"),
    [
        ("middle", {}, r"refuses: arm: found middle, expected one of \['left', 'right'\]"),
        ("left", {"config_id": 1}, "cell of arm left: found 00000001, expected c0ffee42; .*the same cell file"),
        ("left", {"joints": PLANAR_JOINTS[::-1]}, "joints of arm left: found .*wrist_angle"),
    ],
)
def test_wrong_agent_is_refused_with_the_reason(
    tmp_path: Path, arm: str, settings: dict[str, object], message: str
) -> None:
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError, match=message):
        served.driver(arm, **settings).connect()


def test_occupied_arm_is_refused_while_the_run_goes_on(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        drivers = served.enabled()
        cycle(drivers, 3)
        with cycling(drivers[0]), cycling(drivers[1]), pytest.raises(ConnectError, match="already connected"):
            served.driver("right").connect()


def test_stranger_who_talks_nonsense_is_refused_and_does_no_harm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        for message in (
            b"x",
            b"\xff" * 300,
            header_only(MessageKind.STATE),
            words(MessageKind.HELLO, version=99, arm="left"),
        ):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as s:
                s.connect(os.fspath(served.path))
                s.send(message)
                assert b"plant protocol" in s.recv(4096)
        cycle(served.enabled(), 2)


def test_stranger_who_does_not_wait_for_the_refusal_does_no_harm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        for _ in range(3):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as s:
                s.connect(os.fspath(served.path))
                s.send(words(MessageKind.HELLO, version=99, arm="left"))
        cycle(served.enabled(), 2)


def test_other_protocol_version_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_backend.served.driver.VERSION", 7)
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError, match="found version 7, expected 4"):
        served.driver().connect()


def test_goodbye_before_the_start_frees_the_arm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        for _ in range(3):
            driver = served.driver("left")
            driver.connect()
            driver.enable()
            driver.close()
        cycle(served.enabled(), 2)


def test_socket_is_for_this_user_only_and_gone_afterwards(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        mode = served.path.stat().st_mode
        assert stat.S_ISSOCK(mode)
        assert stat.S_IMODE(mode) == 0o600
    assert not served.path.exists()


def test_living_plant_keeps_its_place(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        with pytest.raises(PlantError, match=r"another plant answers at .*; stop that run"):
            Listener(served.path)
        cycle(served.enabled(), 2)


def test_dead_socket_is_replaced_and_a_file_is_not(tmp_path: Path) -> None:
    path = tmp_path / "plant.sock"
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    dead.bind(os.fspath(path))
    dead.close()
    with Listener(path):
        assert stat.S_ISSOCK(path.stat().st_mode)
    path.write_text("important")
    with pytest.raises(PlantError, match="is not a socket"):
        Listener(path)
    assert path.read_text() == "important"


def test_path_that_a_socket_cannot_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match="at most 107 bytes"):
        Listener(tmp_path / ("x" * 120))
    with pytest.raises(PlantError, match="a path to listen on"):
        Listener(tmp_path / "no" / "such" / "directory")


def test_successor_keeps_its_socket_when_the_old_plant_leaves(tmp_path: Path) -> None:
    path = tmp_path / "plant.sock"
    with Listener(path):
        path.unlink()
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as successor:
            successor.bind(os.fspath(path))
            inode = path.stat().st_ino
    assert path.stat().st_ino == inode


def test_refusal_of_another_id_shows_both_as_fingerprints(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError) as caught:
        served.driver(config_id=CONFIG_ID - 1).connect()
    assert (caught.value.found, caught.value.expected) == ("c0ffee41", "c0ffee42")


@pytest.mark.parametrize(
    "answer", [b"", b"hello", header_only(MessageKind.STATE), words(MessageKind.INFO, lockstep=True)]
)
def test_server_that_is_no_plant_is_refused(tmp_path: Path, answer: bytes) -> None:
    path = tmp_path / "other.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as other:
        other.bind(os.fspath(path))
        other.listen()

        def serve_nonsense() -> None:
            with other.accept()[0] as connection:
                connection.recv(4096)
                connection.send(answer)

        thread = threading.Thread(target=serve_nonsense)
        thread.start()
        with pytest.raises(ConnectError, match="expected an introduction; check what serves that socket"):
            SimDriver(path, "left", PLANAR_JOINTS, CONFIG_ID).connect()
        thread.join()


def test_visitor_who_says_nothing_is_shown_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_backend.served.lobby.INTRODUCTION_S", 0.0)
    with ServedPlant(tmp_path) as served, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as silent:
        silent.connect(os.fspath(served.path))
        silent.settimeout(10.0)
        assert silent.recv(10) == b""


def test_visitor_who_only_looks_does_no_harm(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        for _ in range(3):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as s:
                s.connect(os.fspath(served.path))
        cycle(served.enabled(), 2)


def test_another_users_process_is_shown_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_backend.served.lobby.peer_uid", lambda _: os.geteuid() + 1)
    with ServedPlant(tmp_path) as served, pytest.raises(ConnectError, match="run plant and agents as the same user"):
        served.driver().connect()


def test_driver_connects_once(tmp_path: Path) -> None:
    with ServedPlant(tmp_path) as served:
        left = served.driver()
        left.connect()
        with pytest.raises(ConnectError, match="found an open connection"):
            left.connect()


@pytest.mark.parametrize("lockstep", [True, False])
def test_an_agent_of_another_pace_than_the_plants_is_refused(tmp_path: Path, lockstep: bool) -> None:
    """Its arm was READY, took a start, and never moved; status had nothing against it."""
    with ServedPlant(tmp_path, lockstep=lockstep) as served:
        with pytest.raises(ConnectError, match="give --real-time to plant and agents, or to none of them") as caught:
            served.driver(lockstep=not lockstep).connect()
        assert caught.value.found == ("an agent in real time" if lockstep else "an agent in lockstep")
        served.driver(lockstep=lockstep).connect()
