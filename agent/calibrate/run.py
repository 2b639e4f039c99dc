"""From the logs of a cell to a calibrated cell: what the command `coop calibrate` does."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np

from agent.atomic import keep_existing, make_folder, refuse_other, write_together
from agent.calibrate.chain import CalibrateError, chain_of
from agent.calibrate.poses import poses_of
from agent.calibrate.result import Calibrated, arm_toml, calibrated, cell_toml, summary
from agent.calibrate.show import figure
from agent.config.cell import Arm, Cell
from agent.log.read import AnyLog, open_log
from agent.replay.source import changed_cell, recorded_cell
from agent.report.plotting import save_png

HOLD: Final = "see that every arm holds the object and none lets it slip"


@dataclass(frozen=True, slots=True)
class Files:
    """What was written."""

    cell: Path
    arms: tuple[Path, ...]
    figure: Path
    summary: Path


def calibrate(
    logs: Sequence[Path],
    changes: Sequence[str] = (),
    tell: Callable[[str], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> Calibrated:
    """Calibrate the cell of one log, or of several of one cell that have the arms between them.

    changes: of its [tolerance], "tolerance.key=value"; tell: what is being done; warn: of what is wrong with a
    log, or not in it.  Raises LogError, ReplayError, ConfigError or CalibrateError.
    """
    _refuse_others(changes)
    tell("reading the log")
    with ExitStack() as stack:
        opened = [stack.enter_context(open_log(log)) for log in logs]
        for line in (f"{log.path}: {remark}" for log in opened for remark in log.remarks):
            warn(line)
        cells = [recorded_cell(log) for log in opened]
        for log, cell in zip(logs, cells, strict=True):
            _refuse_rehearsal(cell, log)
            _refuse_apart(cell, log)
        for log, other in zip(logs[1:], cells[1:], strict=True):
            _require_same(cells[0], other, log)
        _refuse_twice(opened)
        believed = changed_cell(opened[0], changes) if changes else cells[0]
        poses = poses_of([log.agents for log in opened], cells[0])
    tell("fitting")
    return calibrated(cells[0], chain_of(believed), poses)


def _refuse_rehearsal(cell: Cell, log: Path) -> None:
    """Refuse arms that follow simulated twins: they agree with the cell file however wrong that is."""
    hil = cell.file.hil
    if hil is not None:
        raise CalibrateError(
            f"log {log.name}", found=f"a rehearsal: arms in the loop ({', '.join(hil.arms)}) follow their twins",
            expected="arms that hold the object", remedy="record a log without [hil], as `coop float` does",
        )  # fmt: skip


def _refuse_apart(cell: Cell, log: Path) -> None:
    """Refuse arms that floated each on its own: nothing joins them, whatever they did."""
    floating = cell.file.floating
    if floating is not None and not floating.holding:
        raise CalibrateError(
            f"log {log.name}", found=f"arms that float without the object ({', '.join(floating.arms)})",
            expected="arms that hold the object",
            remedy="have grippers close on it: `coop float` with --holding (holding = true under [floating])",
        )  # fmt: skip


def _require_same(cell: Cell, other: Cell, log: Path) -> None:
    """Refuse a log of another cell; which arms float, and what befalls a simulated one, may differ."""
    one, two = (c.file.model_dump(exclude={"floating": True, "simulation": {"push"}}) for c in (cell, other))
    differ = sorted(key for key in one if one[key] != two[key])
    differ += [f"arm file of {a.name}" for a, b in zip(cell.arms, other.arms, strict=False) if a.toml != b.toml]
    if differ:
        raise CalibrateError(
            f"cell of {log}", found=f"another one: {', '.join(differ)} differ", expected="that of the first log",
            remedy="give logs of arms that had one cell file",
        )  # fmt: skip


def _refuse_twice(logs: Sequence[AnyLog]) -> None:
    """Refuse one log under two names, or a copy: an arm has one row at a time."""
    times = [{arm: np.asarray(rows["utc_ns"]) for arm, rows in log.agents.items()} for log in logs]
    for (one, own), (other, its) in itertools.combinations(zip(logs, times, strict=True), 2):
        for arm in own.keys() & its.keys():
            if np.intersect1d(own[arm], its[arm]).size:
                raise CalibrateError(
                    f"logs {one.path} and {other.path}", found=f"rows of arm {arm} that stand in both",
                    expected="each log once: of another host, or of another motion", remedy="leave one out",
                )  # fmt: skip


def _refuse_others(changes: Sequence[str]) -> None:
    for change in changes:
        if not change.strip().startswith("tolerance."):
            raise CalibrateError(
                "--set", found=change, expected="tolerance.KEY=VALUE: how far off the cell may be",
                remedy="the rest of the cell is as it was when the log was made",
            )  # fmt: skip


def write(result: Calibrated, logs: Sequence[Path], out: Path) -> Files | None:
    """Write cell, arm files, figure and summary into the folder `out`, which may be new.

    None, with nothing written, where the cell's own file agrees already.
    Raises CalibrateError where the poses held out do not agree better than before, or not even as well as the cell's
    own [tolerance] has it, and WriteError, with nothing written, where one of the files is there already or cannot be
    written, or another has the name of a URDF that ships.
    """
    if result.settled:
        return None
    if not result.better:
        before_m, after_m, before_rad, after_rad = result.judged
        raise CalibrateError(
            "disagreement of the poses held out",
            found=f"{1e3 * after_m:.2f} mm and {1e3 * after_rad:.2f} mrad after, "
            f"{1e3 * before_m:.2f} mm and {1e3 * before_rad:.2f} mrad before",
            expected="less after than before",
            remedy=f"nothing is written; {HOLD}, record more motion, or say with [tolerance] how far off the cell "
            "may be",
        )
    if not result.agrees:
        (left_m, left_rad), (most_m, most_rad) = result.left, result.explained
        raise CalibrateError(
            "disagreement of most poses held out",
            found=f"{1e3 * left_m:.2f} mm and {1e3 * left_rad:.2f} mrad after the fit",
            expected=f"at most {1e3 * most_m:.2f} mm and {1e3 * most_rad:.2f} mrad, what arms within the log's own "
            "[tolerance] have that hold one object",
            remedy=f"nothing is written; {HOLD}, or say with --set tolerance.KEY=VALUE how far off the cell may be",
        )
    name = f"{result.cell.file.name}_calibrated"
    arms = [f"{name}_{arm.name}.toml" for arm in result.cell.arms]
    source = " and ".join(dict.fromkeys(log.name for log in logs))
    texts = _texts(result, f"calibrated from {source}", name, arms)
    drawn = out / f"{name}.png"
    keep_existing(*(out / file for file in texts), drawn, remedy="name another folder with --out")
    for arm in result.cell.arms:
        if not arm.own_urdf:
            refuse_other(out / arm.file.urdf, arm.urdf_xml.encode())
    make_folder(out)
    write_together({drawn: save_png(figure(result))} | {out / file: text.encode() for file, text in texts.items()})
    return Files(out / f"{name}.toml", tuple(out / arm for arm in arms), drawn, out / f"{name}.json")


def _texts(result: Calibrated, source: str, name: str, arms: Sequence[str]) -> dict[str, str]:
    """Text of each file by its name; the cell's last, as it names the others."""
    texts = {}
    links, parts = result.chain.links, result.chain.parts(result.written)
    urdfs = urdf_names([link.arm for link in links])
    for link, x, file, urdf in zip(links, parts, arms, urdfs, strict=True):
        texts[file] = arm_toml(link.arm, x[link.zeros], urdf)
        if link.arm.own_urdf:
            texts[urdf] = link.arm.urdf_xml
    texts[f"{name}.json"] = json.dumps(summary(result), indent=2, allow_nan=False) + "\n"
    texts[f"{name}.toml"] = cell_toml(result, source, arms)
    return texts


def urdf_names(arms: Sequence[Arm]) -> list[str]:
    """Name of each arm's URDF where all of them lie in one folder: a name that another text has gets the arm's to it.

    One that ships keeps its name: it is not written, but one of that name beside the arm file would be read instead.
    """
    taken = {arm.file.urdf: arm.urdf_xml for arm in arms if not arm.own_urdf}
    names = []
    for arm in arms:
        name = PurePosixPath(arm.file.urdf)
        while taken.setdefault(str(name), arm.urdf_xml) != arm.urdf_xml:
            name = name.with_stem(f"{name.stem}_{arm.name}")
        names.append(str(name))
    return names
