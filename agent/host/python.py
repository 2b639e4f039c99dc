"""How a process of ours starts another one: by the same interpreter, which finds the same code in whatever folder.

`python -m` looks first into the folder that it is started in: another checkout there, or a `queue.py`, would be taken.
"""

from __future__ import annotations

import os
import sys


def command(module: str, *arguments: str) -> list[str]:
    """What runs a module of ours; to be given `surroundings`."""
    return [sys.executable, "-P", "-m", module, *arguments]


def surroundings() -> dict[str, str]:
    """The environment in which it finds what this process found."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
