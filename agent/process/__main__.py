"""`python -m agent.process VERB CELL ...`: a process of a run, started anew.

What `coop VERB CELL ...` does, without what reads the lines of persons, which costs as long as a numpy.
"""

from __future__ import annotations

import sys

from agent.host.starting import end
from agent.process.entry import main

if __name__ == "__main__":
    end(main(sys.argv[1:]))
