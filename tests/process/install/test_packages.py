"""Source package and wheel: complete, and a cell runs from an installed wheel far from the checkout.

The wheel is built from the unpacked source package, so that what that one lacks is missed.  It goes into an environment
of its own; only its dependencies are those of this environment, by a line in a .pth file: no network is needed.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import pytest

from tests.support.coop import TIMEOUT_S
from tests.support.packages import SOURCE, build, unpacked


@dataclass(frozen=True)
class Packages:
    """What a release would consist of, and a place where it is installed."""

    source: Path  # the unpacked source package
    wheel: Path
    prefix: Path  # an environment with the wheel
    elsewhere: Path  # an empty folder to work in

    def coop(self, *arguments: str) -> str:
        """What the installed command prints when it does what it is asked."""
        done = self.ended(*arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def ended(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """How the installed command ends."""
        return subprocess.run(
            [self.prefix / "bin/coop", *arguments],
            cwd=self.elsewhere,
            env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
        )


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Packages:
    base = tmp_path_factory.mktemp("packages")
    source = unpacked(build("sdist", SOURCE, base / "out"), base / "source")
    wheel = build("wheel", source, base / "out")
    prefix, elsewhere = base / "prefix", base / "elsewhere"
    elsewhere.mkdir()
    venv.create(prefix, symlinks=True)
    python = prefix / "bin/python"
    how = ["--quiet", "--no-compile", "--no-deps", "--no-index"]
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", *how, str(wheel)]
    done = subprocess.run(install, capture_output=True, text=True, timeout=TIMEOUT_S)
    assert done.returncode == 0, done.stderr
    (site,) = prefix.glob("lib/python*/site-packages")
    dependencies = metadata.distribution("pin").locate_file("")
    (site / "dependencies.pth").write_text(f"{dependencies}\nimport cmeel_pth\n")
    return Packages(source, wheel, prefix, elsewhere)


@pytest.mark.skipif(
    shutil.which("git") is None or not (SOURCE / ".git").exists(), reason="needs a checkout and git to list it"
)
def test_the_source_package_holds_every_file_of_the_checkout(packages: Packages) -> None:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=SOURCE, capture_output=True, text=True, check=True,
    )  # fmt: skip
    wanted = {name for name in listed.stdout.splitlines() if (SOURCE / name).exists()}
    held = {str(path.relative_to(packages.source)) for path in packages.source.rglob("*") if path.is_file()}
    assert {"Makefile", "LICENSE", "README.md", "CHANGELOG.md", "systemd/install.sh"} <= held
    assert held - {"PKG-INFO"} == wanted


def test_make_lists_its_targets_in_the_source_package(packages: Packages) -> None:
    done = subprocess.run(["make", "-C", packages.source, "help"], capture_output=True, text=True, timeout=20)
    assert done.returncode == 0, done.stderr
    assert "the paper's experiment in simulation" in done.stdout


def test_the_wheel_brings_types_licence_units_and_documents(packages: Packages) -> None:
    names = set(zipfile.ZipFile(packages.wheel).namelist())
    assert {f"{package}/py.typed" for package in ("agent", "drivers", "sim_backend", "configs")} <= names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert not any(name.startswith("tests") for name in names)
    share = packages.prefix / "share/widowx-coop"
    for folder in ("systemd", "docs"):
        wanted = {path.relative_to(packages.source) for path in (packages.source / folder).rglob("*") if path.is_file()}
        assert {path.relative_to(share) for path in (share / folder).rglob("*") if path.is_file()} == wanted
    for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "Makefile"):
        assert (share / name).read_bytes() == (packages.source / name).read_bytes()


def test_coop_where_finds_what_ships(packages: Packages, tmp_path: Path) -> None:
    places = dict(line.split() for line in packages.coop("where").splitlines())
    assert set(places) == {"cells", "arms", "units", "docs", "layouts"}
    assert all(Path(place).is_relative_to(packages.prefix) for place in places.values())
    assert (Path(places["cells"]) / "paper.toml").is_file()
    assert (Path(places["arms"]) / "wx250s.urdf").is_file()
    assert (Path(places["layouts"]) / "foxglove.json").is_file()
    assert (Path(places["docs"]) / "install.md").is_file()
    install = Path(packages.coop("where", "units").strip()) / "install.sh"
    done = subprocess.run([install, "simulated"], env={**os.environ, "DESTDIR": str(tmp_path)}, timeout=20)
    assert done.returncode == 0
    assert (tmp_path / "etc/systemd/system/coop-plant.service").is_file()


def test_an_installation_without_its_documents_says_so(packages: Packages) -> None:
    docs = packages.prefix / "share/widowx-coop/docs"
    aside = docs.rename(packages.elsewhere / "docs")
    try:
        done = packages.ended("where", "docs")
    finally:
        aside.rename(docs)
    assert done.returncode == 2
    assert done.stderr == (
        f"coop: docs: found no folder {docs}, expected the files that ship; install widowx-coop again\n"
    )


def test_a_cell_runs_from_the_wheel(packages: Packages) -> None:
    cell = Path(packages.coop("where", "cells").strip()) / "paper.toml"
    packages.coop("run", str(cell), "--duration", "0.3", "--out", "run")
    results = json.loads((packages.elsewhere / "run/results.json").read_text())
    assert results["rows_recorded"] == results["rows_expected"] == 120
    assert results["complete"]
    assert "</html>" in (packages.elsewhere / "run/report.html").read_text()
