"""What the doctor says of a host's certificates, by the time that they are asked at."""

from __future__ import annotations

import datetime
import shutil
from pathlib import Path

import pytest

import configs
from agent.config.cell import load_cell
from agent.doctor import doctor
from agent.doctor.certificates import certificates
from agent.doctor.doctor import DoctorOptions, diagnose
from agent.host.openssl import validity
from agent.pki.certificates import Leaf, make_authority, sign
from agent.verify.finding import Verdict

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl to make certificates")
DAYS = 365


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As /etc/coop/zenoh of the host of arm left."""
    made = tmp_path_factory.mktemp("zenoh")
    make_authority(made, "paper")
    sign(made, made, "left", Leaf("left", ()), DAYS)
    return made


@pytest.mark.parametrize(
    ("days", "verdict", "found", "remedy"),
    [
        (0.0, Verdict.OK, "until ", ""),
        (DAYS - 14.1, Verdict.OK, "until ", ""),
        (DAYS - 13.9, Verdict.WARNING, "until ", "`coop pki CELL FOLDER --renew left`"),
        (DAYS + 0.1, Verdict.WARNING, "expired: until ", "`coop pki CELL FOLDER --renew left`"),
        (-0.1, Verdict.WARNING, "not valid before ", "clock of this host"),
    ],
)
def test_a_certificate_is_named_that_has_ended_ends_soon_or_does_not_count_yet(
    folder: Path, days: float, verdict: Verdict, found: str, remedy: str
) -> None:
    begins, _ = validity(folder / "left.pem")
    authority, left = certificates(folder, begins + datetime.timedelta(days=days))
    assert (left.what, left.verdict) == ("certificate left.pem", verdict)
    assert left.found.startswith(found)
    assert remedy in left.remedy
    assert authority.verdict is (Verdict.WARNING if days < 0 else Verdict.OK)


def test_an_authority_that_ends_is_made_anew_for_all_hosts(folder: Path) -> None:
    authority, _ = certificates(folder, validity(folder / "ca.pem").ends)
    assert authority.found.startswith("expired")
    assert "a new authority, for all hosts" in authority.remedy


def test_what_is_no_certificate_is_a_warning_and_a_host_without_any_has_nothing_to_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert certificates(tmp_path / "none", datetime.datetime.now(datetime.UTC)) == []
    (tmp_path / "left.pem").write_text("no certificate")
    monkeypatch.setattr(doctor, "FOLDER", tmp_path)
    diagnosis = diagnose(load_cell(configs.CELLS_DIR / "paper.toml"), DoctorOptions((), tmp_path), lambda _: None)
    (left,) = [finding for finding in diagnosis.findings if finding.what == "certificate left.pem"]
    assert left.verdict is Verdict.WARNING
    assert "copy the one" in left.remedy
