"""`make run` on a minimal Debian with nothing but python3, make and git: it says what to install, and then it works.

Each release takes some two minutes and downloads 300 MB, so `make test` leaves it out; `make test-fresh` runs it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.debian_tree import Tree, built, missing
from tests.support.packages import SOURCE, build, unpacked

pytestmark = [pytest.mark.fresh, pytest.mark.timeout(1500)]


@pytest.fixture(params=["bookworm", "trixie"])
def tree(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Tree]:
    """One for each try: the packages of the one before would be there."""
    if reason := missing():
        pytest.skip(reason)
    with built(request.param, ("python3", "make", "git"), tmp_path / "tree") as tree:
        unpacked(build("sdist", SOURCE, tmp_path), tmp_path / "source").rename(tree.root / "coop")
        yield tree


def test_make_run_names_the_package_that_is_missing_and_then_works(tree: Tree) -> None:
    refused = tree.run("make", "-C", "/coop", "run")
    assert refused.returncode != 0
    lines = [line for line in refused.stderr.splitlines() if not line.startswith("make")]
    assert lines == ["coop: python3 cannot make an environment: apt install python3-venv"]
    assert not (tree.root / "coop/.venv").exists()

    remedy = re.search(r"apt install (.+)$", lines[0])
    assert remedy is not None
    assert tree.run("apt-get", "update").returncode == 0
    installed = tree.run("apt-get", "install", "--yes", "--no-install-recommends", *remedy[1].split())
    assert installed.returncode == 0, installed.stderr

    done = tree.run("make", "-C", "/coop", "run")
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    (results,) = (tree.root / "coop/runs").glob("*/results.json")
    content = json.loads(results.read_text())
    assert content["complete"]
    assert set(content["verdicts"].values()) == {"met"}
    assert results.with_name("report.html").stat().st_size > 100_000
    assert not list(tree.root.glob("usr/lib/*/libgomp.so*")), "a tree with libgomp1 proves nothing"
