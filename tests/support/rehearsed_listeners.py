"""Rehearses faults of listeners: CELL FAULTS ENDPOINT FILE, which gets the rows of the rings and what was found.

Alone in its process, it has copies of itself as the processes of the cell, as `coop` has.
"""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

from agent.config.cell import load_cell
from agent.faults.heard import heard
from agent.faults.listeners import rehearse_listeners
from agent.faults.plan import Injection
from tests.support.nobody import Nobody


def main(path: str, deeds: str, endpoint: str, kept: str) -> None:
    faults = [Injection(fault=fault, **given) for fault, given in json.loads(deeds)]
    cell, log = load_cell(Path(path)), Path(path).parent / "run.mcap"
    run = rehearse_listeners(cell, faults, 1, log, Nobody(), listen=endpoint)
    Path(kept).write_bytes(pickle.dumps((run.rows, heard(run))))


if __name__ == "__main__":
    main(*sys.argv[1:])
