"""Certificates of a cell: whole or not at all, keys for their owner alone, configurations equal to the shipped ones."""

from __future__ import annotations

import datetime
import errno
import ipaddress
import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

from agent.config.files import load_files
from agent.host.openssl import PkiError
from agent.pki.certificates import hosts
from agent.pki.make import Wish, ends, make, renew
from agent.pki.zenoh import Paths, recorder_config
from tests.support.command import coop
from tests.support.systemd.unit_files import SYSTEMD

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl to make certificates")

CELL = load_files(Path("paper_real"))
PARTS = ("transport", "listen", "connect", "mode", "scouting", "access_control", "low_pass_filter", "adminspace",
         "plugins_loading")  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pki") / "cell"
    make(Wish(CELL, folder))
    return folder


@pytest.fixture(scope="module")
def of_address(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates of a recorder that is named by an address of six parts."""
    folder = tmp_path_factory.mktemp("pki") / "cell"
    make(Wish(CELL, folder, recorder="fd00::1", listen="::"))
    return folder


def named(recorder: Path) -> list[ipaddress.IPv4Address | ipaddress.IPv6Address]:
    return [ipaddress.ip_address(host) for host in hosts(recorder / "zenoh/recorder.pem")]


def openssl(*words: str | Path) -> str:
    return subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True, text=True).stdout


def test_every_member_has_what_its_host_needs_and_no_other_key(made: Path) -> None:
    found = {str(path.relative_to(made)) for path in made.rglob("*") if path.is_file()}
    members = ("recorder", "left", "right", "plant")
    assert found == {"authority/ca.key", "authority/ca.pem"} | {
        f"{name}/{file}"
        for name in members
        for file in ("zenoh/ca.pem", f"zenoh/{name}.pem", f"zenoh/{name}.json5", f"keys/{name}.pem")
    }


def test_keys_are_read_by_their_owner_alone(made: Path) -> None:
    keys = [made / "authority/ca.key", *made.glob("*/keys/*")]
    assert len(keys) == 5
    for path in [*keys, *(key.parent for key in keys)]:
        assert path.stat().st_mode & 0o077 == 0, path


def test_leaves_are_of_this_authority_and_name_their_member(made: Path) -> None:
    for name, common in (("recorder", "recorder"), ("left", "arm-left"), ("plant", "plant")):
        certificate = made / name / "zenoh" / f"{name}.pem"
        assert "OK" in openssl("verify", "-CAfile", made / "authority/ca.pem", certificate)
        assert openssl("x509", "-in", certificate, "-noout", "-subject").strip().endswith(f"CN = {common}")
        key = openssl("pkey", "-in", made / name / "keys" / f"{name}.pem", "-pubout")
        assert openssl("x509", "-in", certificate, "-noout", "-pubkey") == key
    assert hosts(made / "recorder/zenoh/recorder.pem") == ("recorder.cell",)


def test_an_authority_signs_no_further_one_and_a_leaf_signs_nothing(made: Path) -> None:
    assert "CA:TRUE, pathlen:0" in openssl("x509", "-in", made / "authority/ca.pem", "-noout", "-text")
    assert "CA:FALSE" in openssl("x509", "-in", made / "left/zenoh/left.pem", "-noout", "-text")


def test_configurations_are_the_shipped_ones_filled_in(made: Path) -> None:
    etc, key = Path("/etc/coop/zenoh"), Path("/run/credentials/coop-recorder.service/key.pem")
    paths = Paths(etc / "ca.pem", etc / "recorder.pem", key)
    recorder = recorder_config(paths, "tls/0.0.0.0:7447", CELL.file.name, ("left", "right"))
    arm = (made / "left/zenoh/left.json5").read_bytes()
    for file, ours in (("recorder", recorder), ("arm", arm)):
        shipped = (SYSTEMD / f"several-hosts/zenoh/{file}.json5").read_text().replace("NAME", "left")
        wanted = zenoh.Config.from_json5(shipped.replace("coop/paper/", f"coop/{CELL.file.name}/"))
        found = zenoh.Config.from_json5(ours.decode())
        for part in PARTS:
            assert json.loads(found.get_json(part)) == json.loads(wanted.get_json(part)), (file, part)


def test_the_simulated_plant_publishes_under_its_own_name(made: Path) -> None:
    access = json.loads((made / "recorder/zenoh/recorder.json5").read_text())["access_control"]
    assert {"id": "plant", "cert_common_names": ["plant"]} in access["subjects"]
    (own,) = [rule for rule in access["rules"] if rule["id"] == "own-plant"]
    assert own["key_exprs"] == [f"coop/{CELL.file.name}/plant/**", f"coop/{CELL.file.name}/plant/**/@adv/**"]


def test_certificates_end_when_they_were_told_to(made: Path) -> None:
    left = {name: end - datetime.datetime.now(datetime.UTC) for name, end in ends(made).items()}
    assert {name: round(span.total_seconds() / 86400) for name, span in left.items()} == {
        "authority": 3650, "recorder": 365, "left": 365, "right": 365, "plant": 365,
    }  # fmt: skip


def test_nothing_is_replaced_unasked_and_nothing_is_left_behind(made: Path) -> None:
    before = {path: path.read_bytes() for path in made.rglob("*") if path.is_file()}
    with pytest.raises(PkiError, match="replaced unasked"):
        make(Wish(CELL, made))
    assert {path: path.read_bytes() for path in made.rglob("*") if path.is_file()} == before
    with pytest.raises(PkiError, match="member to renew: found 'lift'"):
        renew(Wish(CELL, made), ["left", "lift"])
    with pytest.raises(PkiError, match="no authority"):
        renew(Wish(CELL, made / "left"), ["left"])
    assert {path: path.read_bytes() for path in made.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "expected room for keys and certificates; make room there, or name another path"),
        (errno.EROFS, "expected a folder that can be written; name another path"),
    ],
)
def test_a_disk_that_takes_no_more_is_told_with_the_folder(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, said: str
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    folder = shutil.copytree(made, tmp_path / "made")
    monkeypatch.setattr(Path, "write_bytes", refuse)  # of a member's configuration
    with pytest.raises(PkiError, match=f"folder {tmp_path}/new: found {os.strerror(number)}, {said}"):
        make(Wish(CELL, tmp_path / "new"))
    monkeypatch.setattr(Path, "chmod", refuse)
    with pytest.raises(PkiError, match=f"folder {folder}: found {os.strerror(number)}, {said}"):
        renew(Wish(CELL, folder), ["left"])
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_what_fails_in_the_middle_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(PkiError, match="command openssl"):
        make(Wish(CELL, tmp_path / "cell"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["recorder", "listen"])
@pytest.mark.parametrize(
    "host",
    ["", "two words", "a/../b", "recorder..cell", "-a.cell", "a-.cell", "10.0.0.300", "x" * 64, "a." * 126 + "aa"],
)
def test_what_is_neither_a_name_nor_an_address_is_refused_before_anything_is_made(
    tmp_path: Path, option: str, host: str
) -> None:
    with pytest.raises(PkiError, match=f"option --{option}: found .* expected a host's name or address"):
        make(replace(Wish(CELL, tmp_path / "cell"), **{option: host}))
    assert not list(tmp_path.iterdir())


def test_an_address_of_six_parts_is_one_that_zenoh_reads_and_the_certificate_names(of_address: Path) -> None:
    recorder, left = (of_address / name / "zenoh" for name in ("recorder", "left"))
    assert json.loads((recorder / "recorder.json5").read_text())["listen"]["endpoints"] == ["tls/[::]:7447"]
    assert json.loads((left / "left.json5").read_text())["connect"]["endpoints"] == ["tls/[fd00::1]:7447"]
    assert named(of_address / "recorder") == [ipaddress.ip_address("fd00::1")]


def test_an_openssl_that_does_not_end_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "openssl"
    fake.write_text("#!/bin/sh\nexec sleep 60\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr("agent.host.openssl._TIMEOUT_S", 0.1)
    with pytest.raises(PkiError, match=r"openssl req .* no end within 0\.1 s"):
        make(Wish(CELL, tmp_path / "cell"))
    assert [path.name for path in tmp_path.iterdir()] == ["openssl"]


def test_a_renewed_member_has_another_key_for_the_same_host_and_the_others_theirs(
    of_address: Path, tmp_path: Path
) -> None:
    cell = Path(shutil.copytree(of_address, tmp_path / "cell"))
    before = {path: path.read_bytes() for path in cell.rglob("*") if path.is_file()}
    renewed = renew(Wish(CELL, cell, days=30), ["recorder"])
    after = {path: path.read_bytes() for path in cell.rglob("*") if path.is_file()}
    changed = {str(path.relative_to(cell)) for path in after if after[path] != before.get(path)}
    assert changed == {"recorder/zenoh/recorder.pem", "recorder/keys/recorder.pem"}
    assert named(cell / "recorder") == [ipaddress.ip_address("fd00::1")]
    assert (cell / "recorder/keys/recorder.pem").stat().st_mode & 0o777 == 0o600
    assert renewed["recorder"] < renewed["left"]


def test_a_certificate_is_renewed_for_its_own_cell_alone(made: Path) -> None:
    with pytest.raises(PkiError, match="found the authority of cell paper_real, expected that of two_wx200; name the"):
        renew(Wish(load_files(Path("two_wx200")), made), ["left"])


@pytest.mark.parametrize(
    "words", [("--in-place",), ("--recorder", "10.0.0.1"), ("--listen", "10.0.0.1"), ("--port", "7448")]
)
def test_what_a_renewal_would_not_heed_is_refused(made: Path, words: tuple[str, ...]) -> None:
    before = (made / "left/zenoh/left.pem").read_bytes()
    done = coop("pki", "paper_real", made, "--renew", "left", "--days", "30", *words)
    assert (done.code, done.out) == (2, "")
    assert "--renew goes with --days alone" in done.err
    assert (made / "left/zenoh/left.pem").read_bytes() == before


def test_the_command_renews_for_as_many_days_as_it_is_told(made: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "cell"))
    done = coop("pki", "paper_real", folder, "--renew", "left", "--days", "30")
    assert (done.code, done.err) == (0, "")
    assert ends(folder)["left"] < ends(folder)["right"]


def test_the_command_says_how_long_everything_lasts(tmp_path: Path) -> None:
    command = ("pki", "paper", tmp_path / "cell", "--json")
    done = coop(*command)
    assert done.code == 0
    assert json.loads(done.out)["ends"].keys() == {"authority", "recorder", "left", "right", "plant"}
    again = coop(*command)
    assert (again.code, again.out) == (PkiError.exit_code, "")
