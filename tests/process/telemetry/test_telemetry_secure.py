"""With the files of `coop pki` (faults N3, N4): an arm's own telemetry alone gets into the log."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from agent.config.files import load_files
from agent.log.read import read_log
from agent.pki.make import Wish, make, renew
from agent.telemetry.link.endpoint import NetworkError
from agent.telemetry.link.publication import Pace
from agent.telemetry.link.session import Network, has_link, open_session
from agent.telemetry.link.wire import BatchHeader
from tests.support.few import long
from tests.support.ports import free_port
from tests.support.telemetry.telemetry_cell import ARMS, CELL, make_rows, recorder, sent_by, telemetry, writer

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="makes its certificates with openssl")

LEFT = {"left": ARMS["left"]}
FILES = load_files(Path(CELL))


def of(folder: Path, member: str) -> Network:
    """As a member of that folder's cell."""
    return Network(config_file=folder / member / "zenoh" / f"{member}.json5")


PORT = 7447
CellOf = Callable[[Path, int], Path]


def made(folder: Path, port: int) -> Path:
    """Another authority's."""
    make(Wish(FILES, folder, "localhost", "127.0.0.1", port, in_place=True))
    return folder


@pytest.fixture(scope="module")
def cell_of(tmp_path_factory: pytest.TempPathFactory) -> CellOf:
    """Copies of one set of certificates, for a place and a port."""
    first = made(tmp_path_factory.mktemp("certificates") / "cell", PORT)

    def copy(folder: Path, port: int) -> Path:
        for path in copy_of(first, folder).glob("*/zenoh/*.json5"):
            path.write_text(path.read_text().replace(f":{PORT}", f":{port}"))
        return folder

    return copy


def copy_of(cell: Path, folder: Path) -> Path:
    """The same certificates in another place, for somebody to spoil."""
    shutil.copytree(cell, folder)
    for path in folder.glob("*/zenoh/*.json5"):
        path.write_text(path.read_text().replace(str(cell), str(folder)))
    return folder


def expired(cell: Path, folder: Path) -> Path:
    """The left arm's certificate has ended."""
    copy_of(cell, folder)
    renew(Wish(FILES, folder, days=0), ["left"])
    time.sleep(1.1)  # the end is given in whole seconds
    return folder


def with_key_of_right(cell: Path, folder: Path) -> Path:
    """The left arm's certificate with the right arm's key."""
    shutil.copyfile(cell / "right/keys/right.pem", copy_of(cell, folder) / "left/keys/left.pem")
    return folder


@contextlib.contextmanager
def anybodys(network: Network) -> Iterator[zenoh.Session]:
    """The session of one who looks at no file of theirs first."""
    if network.config_file is None:
        with open_session(network) as opened:
            yield opened.session
        return
    with zenoh.open(zenoh.Config.from_file(network.config_file)) as session:
        yield session


def forge(network: Network, *, may_connect: bool) -> None:
    """Publish rows as the left arm would, from somewhere else."""
    rows = make_rows("left", 8)
    rows["sequence"] += 10_000
    with anybodys(network) as session:
        deadline = time.monotonic() + (10.0 if may_connect else 0.7)
        while not has_link(session) and time.monotonic() < deadline:
            time.sleep(0.02)
        for i in range(8):
            header = BatchHeader(4711, 8 * i, 8 * i + 8, 0).pack(sent_by("left", 4711))
            session.put("coop/paper/left/state", rows.tobytes(), attachment=header,
                               congestion_control=zenoh.CongestionControl.BLOCK)  # fmt: skip
        assert has_link(session) == may_connect


@pytest.mark.fault("N3")
def test_only_the_arm_itself_gets_into_the_log(tmp_path: Path, cell_of: CellOf) -> None:
    port = free_port()
    cell = cell_of(tmp_path / "cell", port)
    ring = tmp_path / "left.ring"
    with recorder(tmp_path / "run.mcap", arms=LEFT, network=of(cell, "recorder")) as rec:
        rec.ready()
        forge(Network(connect=(f"tcp/127.0.0.1:{port}",)), may_connect=False)
        forge(of(made(tmp_path / "other", port), "left"), may_connect=False)
        forge(of(expired(cell, tmp_path / "old"), "left"), may_connect=False)
        forge(of(with_key_of_right(cell, tmp_path / "swapped"), "left"), may_connect=False)
        forge(of(cell, "right"), may_connect=True)
        own = of(cell, "left")
        with telemetry(ring, "left", "", Pace.REAL_TIME, network=own) as tel, writer(ring, "left", 400, 500.0):
            assert tel.result().complete
        report = rec.stop()
    assert report.complete
    assert not [key for key in report.completeness if key.startswith("rejected.")]
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == make_rows("left", 400).tobytes()


@pytest.mark.fault("N4")
def test_an_expired_certificate_costs_no_row_once_it_is_renewed(tmp_path: Path, cell_of: CellOf) -> None:
    cell = cell_of(tmp_path / "cell", free_port())
    ring, count = tmp_path / "left.ring", 900
    renew(Wish(FILES, cell, days=0), ["left"])
    with recorder(tmp_path / "run.mcap", arms=LEFT, network=of(cell, "recorder")) as rec:
        rec.ready()
        with (
            writer(ring, "left", count, 500.0) as agent,
            telemetry(ring, "left", "", Pace.REAL_TIME, network=of(cell, "left")) as refused,
        ):
            assert agent.result() == count, "the writer of the ring does not notice"
            assert not refused.stop().complete
        renew(Wish(FILES, cell), ["left"])
        with telemetry(ring, "left", "", Pace.REAL_TIME, network=of(cell, "left")) as again:
            assert again.result().complete
        assert rec.stop().complete
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == make_rows("left", count).tobytes()


@pytest.mark.fault("N4")
def test_a_recorder_comes_back_with_its_certificate_renewed_and_no_arms_telemetry_is_touched(
    tmp_path: Path, cell_of: CellOf
) -> None:
    cell = cell_of(tmp_path / "cell", free_port())
    ring, count = tmp_path / "left.ring", 400
    renew(Wish(FILES, cell, days=0), ["recorder"])
    time.sleep(1.1)  # the end is given in whole seconds
    with telemetry(ring, "left", "", Pace.REAL_TIME, network=of(cell, "left")) as tel:
        with recorder(tmp_path / "old.mcap", arms=LEFT, network=of(cell, "recorder")) as rec:
            rec.ready()
            with writer(ring, "left", count, 500.0) as agent:
                assert agent.result() == count
            assert rec.stop().completeness["left.rows_recorded"] == "0", "its certificate has ended"
        renew(Wish(FILES, cell), ["recorder"])
        with recorder(tmp_path / "run.mcap", arms=LEFT, network=of(cell, "recorder")) as rec:
            rec.ready()
            assert tel.result().complete
            assert rec.stop().complete
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == make_rows("left", count).tobytes()


def no_key(cell: Path) -> None:
    (cell / "left/keys/left.pem").unlink()


def key_of_right(cell: Path) -> None:
    shutil.copyfile(cell / "right/keys/right.pem", cell / "left/keys/left.pem")


def half_a_certificate(cell: Path) -> None:
    certificate = cell / "left/zenoh/left.pem"
    certificate.write_bytes(certificate.read_bytes()[:300])


def no_authority(cell: Path) -> None:
    (cell / "left/zenoh/ca.pem").write_bytes(b"")


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        long((no_key, "keys/left.pem: No such file or directory")),
        (key_of_right, "keys/left.pem: .*KEY_VALUES_MISMATCH"),
        (half_a_certificate, "zenoh/left.pem and "),
        long((no_authority, "ca.pem: ")),
    ],
)
def test_an_arms_files_that_cannot_be_used_are_named_before_it_dials(
    tmp_path: Path, cell_of: CellOf, spoil: Callable[[Path], None], found: str
) -> None:
    cell = cell_of(tmp_path / "cell", free_port())
    with open_session(of(cell, "left")):
        pass
    spoil(cell)
    with pytest.raises(NetworkError, match=f"left.json5: found .*{found}"), open_session(of(cell, "left")):
        pass


@pytest.mark.parametrize(
    "mistake", ['{"mode": "peer", "lissten": {}}', '{"transport": {"link": {"tls": {"enable_mtsl": 1}}}}', "{"]
)
def test_a_configuration_with_a_mistake_is_refused(tmp_path: Path, mistake: str) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text(mistake)
    with pytest.raises(NetworkError, match="Zenoh configuration"), open_session(Network(config_file=path)):
        pass
