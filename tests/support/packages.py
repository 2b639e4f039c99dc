"""Builds our source package and wheel for tests, without a network and without touching the checkout."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path

SOURCE = Path(__file__).parents[2]


def build(kind: str, source: Path, out: Path) -> Path:
    """The package of this kind ("sdist" or "wheel"), made from the files in `source`."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(out)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    (made,) = out.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return made


def unpacked(sdist: Path, into: Path) -> Path:
    """The one folder that a source package unpacks to."""
    with tarfile.open(sdist) as archive:
        if hasattr(tarfile, "data_filter"):  # from Python 3.11.4 on; Debian 12 has 3.11.2
            archive.extraction_filter = tarfile.data_filter
        archive.extractall(into)
    (folder,) = into.iterdir()
    return folder
