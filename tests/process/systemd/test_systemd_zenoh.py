"""The shipped Zenoh configurations: who gets through to the recorder, on which key, and who does not."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
import zenoh.ext

from agent.telemetry.row.topics import Address, Kind, cell_keys, status_key
from tests.support.ports import free_port
from tests.support.systemd.unit_files import SYSTEMD
from tests.support.telemetry.cell_certificates import fill_in, make_certificates

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl to make certificates")

CELL = "paper"
LEFT, RIGHT = (Address(CELL, arm, Kind.STATE).key for arm in ("left", "right"))
STATUS = status_key(CELL)
LINK_S = 60.0  # a machine that stalls takes its time
QUIET_S = 1.0  # long enough for a message that is let through: those take milliseconds


class Recorder:
    """A recorder's session with the shipped configuration, and what reached it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        self.heard: list[tuple[str, bytes]] = []
        self.session = zenoh.open(self._configured("recorder.json5", "recorder"))
        self._status = self.session.declare_queryable(STATUS, lambda query: query.reply(STATUS, b"fine"))
        self._subscriber = self.listen()

    def listen(self) -> zenoh.ext.AdvancedSubscriber:
        return zenoh.ext.declare_advanced_subscriber(
            self.session,
            cell_keys(CELL),
            lambda sample: self.heard.append((str(sample.key_expr), sample.payload.to_bytes())),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
            recovery=zenoh.ext.RecoveryConfig(heartbeat=True),
        )

    def deaf(self) -> None:
        self._subscriber.undeclare()

    def _configured(self, file: str, name: str, edit: Callable[[str], str] = str) -> zenoh.Config:
        """A shipped file, filled in; certificates and keys lie in a folder of the test instead of /etc and /run."""
        text = edit(fill_in((SYSTEMD / "several-hosts/zenoh" / file).read_text(), name))
        text = text.replace("/etc/coop/zenoh/ca.pem", f"{self.folder}/cell.pem")
        text = re.sub(r"/run/credentials/[^/]*/key.pem", f"{self.folder}/{name}.key", text)
        text = text.replace("/etc/coop/zenoh/", f"{self.folder}/").replace(":7447", f":{self.port}")
        text = text.replace("recorder.cell", "localhost")
        path = self.folder / f"{name}.json5"
        path.write_text(text)
        return zenoh.Config.from_file(path)

    @contextmanager
    def dialled(self, name: str, edit: Callable[[str], str] = str) -> Iterator[zenoh.Session]:
        session = zenoh.open(self._configured("arm.json5", name, edit))
        try:
            yield session
        finally:
            session.close()

    def wait_for(self, wanted: tuple[str, bytes]) -> None:
        deadline = time.monotonic() + LINK_S
        while wanted not in self.heard:
            assert time.monotonic() < deadline, self.heard
            time.sleep(0.02)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_certificates(tmp_path_factory.mktemp("cell") / "certificates")


@pytest.fixture
def recorder(certificates: Path) -> Iterator[Recorder]:
    recorder = Recorder(certificates)
    yield recorder
    recorder.session.close()


def linked(session: zenoh.Session, timeout_s: float) -> bool:
    deadline = time.monotonic() + timeout_s
    while not session.info.links():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def test_an_arm_is_heard_under_its_own_name_alone(recorder: Recorder) -> None:
    with recorder.dialled("left") as left:
        assert linked(left, LINK_S)
        for key in (RIGHT, STATUS, LEFT):  # one link keeps their order
            left.put(key, b"from left")
        recorder.wait_for((LEFT, b"from left"))
    assert recorder.heard == [(LEFT, b"from left")]


def test_an_arm_may_ask_what_the_recorder_has(recorder: Recorder) -> None:
    with recorder.dialled("left") as left:
        assert linked(left, LINK_S)
        deadline = time.monotonic() + LINK_S
        while not (replies := list(left.get(STATUS, timeout=LINK_S))):  # the recorder's queryable is not declared yet
            assert time.monotonic() < deadline
            time.sleep(0.02)
        (reply,) = replies
        assert reply.ok is not None
        assert reply.ok.payload.to_bytes() == b"fine"


def test_an_arm_does_not_hear_another(recorder: Recorder) -> None:
    with recorder.dialled("left") as left, recorder.dialled("right") as right:
        assert linked(left, LINK_S)
        assert linked(right, LINK_S)
        heard: list[str] = []
        left.declare_subscriber("coop/**", lambda sample: heard.append(str(sample.key_expr)))
        time.sleep(QUIET_S / 4)
        right.put(RIGHT, b"from right")
        recorder.wait_for((RIGHT, b"from right"))
        time.sleep(QUIET_S)
        assert heard == []


def test_a_recorder_that_comes_late_gets_the_history(recorder: Recorder) -> None:
    recorder.deaf()
    with recorder.dialled("left") as left:
        assert linked(left, LINK_S)
        with zenoh.ext.declare_advanced_publisher(
            left,
            LEFT,
            cache=zenoh.ext.CacheConfig(max_samples=300),
            sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=0.5),
            publisher_detection=True,
        ) as publisher:
            for number in range(300):
                publisher.put(str(number).encode())
            late = recorder.listen()
            recorder.wait_for((LEFT, b"299"))
            deadline = time.monotonic() + LINK_S
            while len(recorder.heard) < 300 and time.monotonic() < deadline:
                time.sleep(0.02)
            late.undeclare()
    assert sorted(int(payload) for _, payload in recorder.heard) == list(range(300))


def test_a_stranger_of_this_cell_gets_a_link_and_nothing_else(recorder: Recorder) -> None:
    with recorder.dialled("unknown") as stranger:
        assert linked(stranger, LINK_S)
        stranger.put(LEFT, b"forged")
        assert list(stranger.get(STATUS, timeout=QUIET_S)) == []
    assert recorder.heard == []


@pytest.mark.parametrize(
    ("name", "edit"),
    [
        pytest.param("foreign", str, id="certificate of another authority"),
        pytest.param(
            "left", lambda text: re.sub(r".*connect_(certificate|private_key).*\n", "", text), id="no certificate"
        ),
        pytest.param("left", lambda text: text.replace("tls/", "tcp/").replace('"tls"', '"tcp"'), id="clear text"),
    ],
)
def test_who_is_not_of_this_cell_gets_no_link(recorder: Recorder, name: str, edit: Callable[[str], str]) -> None:
    with recorder.dialled(name, edit) as stranger:
        stranger.put(LEFT, b"forged")
        assert not linked(stranger, 1.5 * QUIET_S)  # an arm needs a tenth of it
    assert recorder.heard == []


def test_a_message_too_large_is_dropped_and_the_link_stays(recorder: Recorder) -> None:
    with recorder.dialled("left") as left:
        assert linked(left, LINK_S)
        with left.declare_publisher(LEFT, congestion_control=zenoh.CongestionControl.BLOCK) as publisher:
            for size in (60_000, 300_000, 2_000_000, 1):
                publisher.put(b"x" * size)
            recorder.wait_for((LEFT, b"x"))
    assert [len(payload) for _, payload in recorder.heard] == [60_000, 1]


@pytest.mark.parametrize("file", ["arm.json5", "recorder.json5"])
def test_a_misspelt_key_is_refused(tmp_path: Path, file: str) -> None:
    text = (SYSTEMD / "several-hosts/zenoh" / file).read_text()
    assert zenoh.Config.from_json5(text)
    with pytest.raises(zenoh.ZError, match="enable_mtsl"):
        zenoh.Config.from_json5(text.replace("enable_mtls", "enable_mtsl"))


def test_no_configuration_scouts_or_shares_memory() -> None:
    for file in ("arm.json5", "recorder.json5"):
        config = zenoh.Config.from_json5((SYSTEMD / "several-hosts/zenoh" / file).read_text())
        for key in ("scouting/multicast/enabled", "scouting/gossip/enabled", "transport/shared_memory/enabled",
                    "adminspace/enabled"):  # fmt: skip
            assert config.get_json(key) == "false", key
        assert config.get_json("transport/link/tls/enable_mtls") == "true"
    arm = zenoh.Config.from_json5((SYSTEMD / "several-hosts/zenoh/arm.json5").read_text())
    assert arm.get_json("listen/endpoints") == "[]"
