"""systemd's own tools find no fault in the units.

`systemd-analyze verify` returns 0 for a misspelt key, so its silence is what counts.  It wants the programs to exist,
so it looks into a root of its own, where they do.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tests.support.few import few
from tests.support.systemd.unit_files import CASES, SIMULATED, fake_root, install, read_unit, words

needs_analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
needs_sysusers = pytest.mark.skipif(
    shutil.which("systemd-sysusers") is None or os.geteuid() != 0, reason="needs systemd-sysusers, as root"
)
Rooted = Callable[[tuple[str, ...]], Path]
EXPOSURE_MAX = 20  # tenths, as --threshold counts


@pytest.fixture(scope="module")
def rooted(tmp_path_factory: pytest.TempPathFactory) -> Rooted:
    """Root for systemd-analyze, made once for each choice and never changed."""
    return cache(lambda choices: fake_root(tmp_path_factory.mktemp("root"), *choices))


EACH = list({name: (choices, name) for choices, name in CASES}.values())  # every unit once


def analyze(root: Path, verb: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["systemd-analyze", f"--root={root}", verb, *arguments],
        capture_output=True,
        text=True,
        env={"PATH": os.environ["PATH"]},
    )


@needs_analyze
@pytest.mark.parametrize(("choices", "name"), few(CASES, EACH.__contains__))
def test_verify_has_nothing_to_say(rooted: Rooted, choices: tuple[str, ...], name: str) -> None:
    done = analyze(rooted(choices), "verify", "--man=no", f"{name}.service", "coop.target")
    assert (done.stderr, done.stdout, done.returncode) == ("", "", 0)


@needs_analyze
@pytest.mark.parametrize(
    ("right", "wrong", "complaint"),
    [
        ("ProtectSystem=", "ProtectSytem=", "Unknown key"),
        ("WatchdogSec=100ms", "WatchdogSec=100 bananas", "Failed to parse"),
        ("/opt/coop/bin/coop", "/opt/coop/bin/coup", "not executable"),
    ],
)
def test_verify_would_see_a_mistake(tmp_path: Path, right: str, wrong: str, complaint: str) -> None:
    path = fake_root(tmp_path) / "etc/systemd/system/coop-agent@.service"
    path.write_text(path.read_text().replace(right, wrong))
    assert complaint in analyze(tmp_path, "verify", "--man=no", "coop-agent@left.service").stderr


@needs_analyze
def test_verify_looks_into_drop_ins(tmp_path: Path) -> None:
    path = fake_root(tmp_path, "simulated") / "etc/systemd/system/coop-agent@.service.d/50-simulated.conf"
    path.write_text(path.read_text() + "Colour=blue\n")
    assert "Unknown key 'Colour'" in analyze(tmp_path, "verify", "--man=no", "coop-agent@left.service").stderr


@needs_analyze
@pytest.mark.parametrize(("choices", "name"), few(CASES, EACH.__contains__))
def test_exposure_is_at_most_two(rooted: Rooted, choices: tuple[str, ...], name: str) -> None:
    threshold = f"--threshold={EXPOSURE_MAX}"
    done = analyze(rooted(choices), "security", "--offline=true", threshold, "--no-pager", f"{name}.service")
    assert (done.returncode, done.stderr) == (0, ""), done.stdout[-200:]


@needs_analyze
def test_exposure_of_an_open_unit_is_above_two(tmp_path: Path) -> None:
    path = fake_root(tmp_path) / "etc/systemd/system/coop-rings.service"
    path.write_text("[Service]\nExecStart=/usr/bin/find\n")
    done = analyze(tmp_path, "security", "--offline=true", f"--threshold={EXPOSURE_MAX}", "--no-pager", path.name)
    assert done.returncode != 0


@needs_sysusers
def test_every_user_and_group_of_the_units_is_made(tmp_path: Path) -> None:
    install(tmp_path, "simulated")
    (tmp_path / "etc/group").write_text("root:x:0:\ndialout:x:20:\n")
    done = subprocess.run(["systemd-sysusers", f"--root={tmp_path}", "coop.conf"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    users, groups = (
        {line.split(":")[0] for line in (tmp_path / "etc" / name).read_text().splitlines()}
        for name in ("passwd", "group")
    )
    for name in SIMULATED:
        unit = read_unit(tmp_path, name)
        assert words(unit, "User") <= users
        assert words(unit, "Group") | words(unit, "SupplementaryGroups") <= groups
