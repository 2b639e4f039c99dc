"""A process that does runs of a study: tasks come in by standard input, results go out by standard output.

`python -m agent.study.worker PARENT`; it ends with its parent or with its input.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import sys

from agent.host.signals import end_with
from agent.study.work import perform


def main(parent: int) -> None:
    """Work until the input ends."""
    end_with(parent)
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # what a library may print is no answer
        with contextlib.suppress(EOFError):
            while True:
                task = pickle.load(sys.stdin.buffer)
                pickle.dump(perform(task), answers)
                answers.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]))
