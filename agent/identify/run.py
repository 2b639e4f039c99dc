"""From one log to estimates and files: what the command `coop identify` does."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from agent.atomic import keep_existing, make_folder, refuse_other, write_together
from agent.identify.equations import Options
from agent.identify.fit import fit
from agent.identify.recording import from_log
from agent.identify.result import Identified, identified
from agent.identify.show import validation_figure
from agent.log.read import open_log
from agent.report.plotting import save_png


@dataclass(frozen=True, slots=True)
class Files:
    """What was written."""

    arm: Path  # the arm file with the new figures
    figure: Path
    summary: Path


def identify(
    log: Path,
    arm: str | None = None,
    options: Options | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Identified:
    """Identify the one arm of a log; tell: what is being done.

    Raises LogError, ReplayError, ConfigError or IdentifyError.
    """
    options = options or Options()
    tell("reading the log")
    with open_log(log) as opened:
        recording = from_log(opened, arm)
    tell("fitting")
    return identified(recording, options, fit(recording, options))


def write(result: Identified, out: Path, *, replace: bool = False) -> Files:
    """Write arm file, its own URDF if it has one, figure and summary into the folder `out`, which may be new.

    Raises WriteError, with no new file written, where one of them is there already and not to be replaced, or cannot
    be written, and where another file there has the name of a URDF that ships.
    """
    arm = result.recording.arm
    model, own = arm.entry.model, arm.entry.arm_file
    files = Files(
        out / (f"{model}.toml" if own is None else Path(own).name),
        out / f"identify_{model}.png",
        out / f"identify_{model}.json",
    )
    urdf = {out / arm.file.urdf: arm.urdf_xml.encode()} if arm.own_urdf else {}
    if not arm.own_urdf:
        refuse_other(out / arm.file.urdf, arm.urdf_xml.encode())
    if not replace:
        keep_existing(*urdf, files.arm, files.figure, files.summary, remedy="name another folder, or give --force")
    make_folder(out)
    text = result.arm_toml(arm.toml.decode())
    summary = json.dumps(result.summary(), indent=2) + "\n"
    png = save_png(validation_figure(result))
    write_together(urdf | {files.figure: png, files.summary: summary.encode(), files.arm: text.encode()})
    return files
