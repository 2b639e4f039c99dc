"""The cell of a log, from the files inside the log; no cell or arm file of this installation stands in for one."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import tomli_w

import configs
from agent.atomic import write_atomically
from agent.config.cell import Cell, cell_from_toml
from agent.config.reading import CHANGED, override, parse
from agent.host.info import CELL_FILE
from agent.log.read import AnyLog
from drivers.interface import Refusal

_NAME: Final = re.compile(r"[\w-][\w.-]*\.(toml|urdf)")


class ReplayError(Refusal):
    """A log lacks files of its cell, or cannot be replayed in this way."""


def recorded_cell(log: AnyLog) -> Cell:
    """The cell as the agents of the run had it.

    Raises ReplayError where the log lacks one of its files, ConfigError where this release does not read them.
    """
    with tempfile.TemporaryDirectory(prefix="coop-replay-") as name:
        folder = _unpacked(log, Path(name))
        raw = log.attachments[CELL_FILE]
        _require_arm_files(log, raw, folder)
        return cell_from_toml(raw, f"{CELL_FILE} of {log.path.name}", folder)


def changed_cell(log: AnyLog, changes: Sequence[str]) -> Cell:
    """The same with values of its cell file changed ("key.path=value"); arm models that the log has not are ours.

    Raises ReplayError, and ConfigError for a change that gives no cell.
    """
    with tempfile.TemporaryDirectory(prefix="coop-replay-") as name:
        folder = _unpacked(log, Path(name))
        document = parse(log.attachments[CELL_FILE], Path(CELL_FILE))
        for text in changes:
            override(document, text)
        raw = tomli_w.dumps(document).encode()
        for shipped in configs.ARMS_DIR.iterdir():
            if _NAME.fullmatch(shipped.name) and not (folder / shipped.name).exists():
                write_atomically(folder / shipped.name, shipped.read_bytes())
        return cell_from_toml(raw, f"{CELL_FILE} of {log.path.name}{CHANGED}", folder)


def _unpacked(log: AnyLog, folder: Path) -> Path:
    if CELL_FILE not in log.attachments:
        raise ReplayError(
            f"{log.path} does not hold its cell",
            found=f"attachments {', '.join(sorted(log.attachments)) or 'none'}",
            expected=f"{CELL_FILE} and its arm files",
            remedy="take a log that `coop record` made; one that was cut before them has no row either",
        )
    for name, content in log.attachments.items():
        if _NAME.fullmatch(name):
            (folder / name).write_bytes(content)
    return folder


def _require_arm_files(log: AnyLog, raw: bytes, folder: Path) -> None:
    """Refuse a log without an arm file by saying so, not by saying that the model is unknown."""
    arms = parse(raw, Path(CELL_FILE)).get("arms")
    models = (
        [arm.get("model") for arm in arms if isinstance(arm, dict) and "arm_file" not in arm]
        if isinstance(arms, list)
        else []
    )
    names = [f"{model}.toml" for model in models if isinstance(model, str)]
    for name in list(names):
        path = folder / name
        urdf = parse(path.read_bytes(), path).get("urdf") if name in log.attachments else None
        names += [urdf] if isinstance(urdf, str) else []
    lacking = sorted({name for name in names if name not in log.attachments})
    if lacking:
        raise ReplayError(
            f"{log.path} does not hold all files of its cell",
            found=f"no {', '.join(lacking)}",
            expected="the arm files and URDFs of its cell as attachments",
            remedy="replay the log as it was recorded, not a copy without them",
        )
