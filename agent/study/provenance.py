"""What computes the runs of a study in this process: versions of packages, and a hash of this one's own sources."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import agent
import drivers
import sim_backend
from agent.host.info import computing

SOURCES = "sources"  # a checkout keeps its version while its sources change


@lru_cache(maxsize=1)
def provenance() -> Mapping[str, str]:
    """Versions by package, and `sources`: runs of two processes may be put together where all are the same."""
    return computing() | {
        SOURCES: hash_of(*(Path(path) for of in (agent, drivers, sim_backend) for path in of.__path__))
    }


def hash_of(*packages: Path) -> str:
    """Of names and content of the Python files of these folders, in hexadecimal."""
    digest = hashlib.sha256()
    for folder in packages:
        for path in sorted(folder.rglob("*.py")):
            content = hashlib.sha256(path.read_bytes()).digest()
            digest.update(path.relative_to(folder.parent).as_posix().encode() + b"\0" + content)
    return digest.hexdigest()[:16]


def apart(found: Mapping[str, str], expected: Mapping[str, str]) -> tuple[str, str]:
    """In words, what of `found` is another than expected, and what is expected of the same."""
    keys = [key for key in {**expected, **found} if found.get(key) != expected.get(key)]
    ours, theirs = (", ".join(f"{key} {one.get(key, 'none')}" for key in keys) for one in (found, expected))
    return ours, theirs
