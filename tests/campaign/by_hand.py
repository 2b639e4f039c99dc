"""`make by-hand`: arms that float with the object are moved, their logs calibrate the cell, its arms strain less.

Everything by the commands a person types, each a process: `coop float` with the real driver on emulated servos whose
bases, grasps and zeros are off, an emulated hand on the object, `coop calibrate` on its logs, and `coop run` of the
cell before and after, without what else keeps arms from straining each other (alignment) or ends a run that strains
(noticing).  BY_HAND: how many drawn realities (3), about two minutes each.  Exit 1 where a bound is missed.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from tests.soak.watch import say
from tests.support.calibrate_rig import UNSURE, believed
from tests.support.coop import coop, start

CELL: Final = "two_wx200"
AFLOAT_S, SESSIONS = 25.0, 8  # together; a host that stalls ends a session, as a servo without answers does
PUSH_S, PUSHED_S = 0.25, 50.0
DISAGREE_MM, DISAGREE_MRAD = 0.5, 1.0  # of poses held out, with the encoders' steps
FOURFOLD: Final = 4.0
STIFF = ("simulation.reality.pads_N_per_m=1e4", "simulation.reality.pads_Nm_per_rad=400.0")
AS_IT_IS = (
    "controller.alignment.enabled=false", "safety.noticing.enabled=false", "report.transient_s=3", "simulation.push=[]"
)  # fmt: skip


def main() -> int:
    """A line per reality; 0 when every one is within its bounds."""
    bad = 0
    say(f"{'seed':>4} {'afloat':>12} {'poses':>6} {'disagreement, held out':>38} {'internal force':>24}")
    for seed in range(int(os.environ.get("BY_HAND", "3"))):
        with tempfile.TemporaryDirectory() as folder:
            bad += not judged(seed, Path(folder))
    return int(bad > 0)


def judged(seed: int, folder: Path) -> bool:
    """From arms that float to the strain of the new cell; whether it is within its bounds."""
    off = [*reality(seed), *STIFF]
    logs, afloat_s = floated([*off, hand(seed)], folder)
    found = calibrated(logs, folder)
    if found is None:
        say(f"{seed:4d} {afloat_s:5.1f} s in {len(logs)}: too few poses; this machine stalls, run it on a quiet one")
        return False
    before_mm, before_mrad = (1e3 * found["disagreement_before"][of] for of in ("rms_m", "rms_rad"))
    after_mm, after_mrad = (1e3 * found["disagreement_after"][of] for of in ("rms_m", "rms_rad"))
    old, new = strain([CELL, *sets(off)], folder / "old"), strain([found["written"]], folder / "new_run")
    how = f"{before_mm:7.2f} mm {before_mrad:6.2f} mrad → {after_mm:.2f} mm {after_mrad:.2f} mrad"
    less = f"{old:7.2f} N → {new:.2f} N, {old / new:.0f} x less"
    say(f"{seed:4d} {afloat_s:5.1f} s in {len(logs)} {found['poses']:6d} {how} {less}")
    return after_mm <= DISAGREE_MM and after_mrad <= DISAGREE_MRAD and old >= FOURFOLD * new


def reality(seed: int) -> list[str]:
    """Errors within ± 10 mm and 20 mrad of bases, ± 3 mm of grasps and ± 1° of zeros, as changes of a cell."""
    _, chain, _ = believed(CELL)
    bound = math.sqrt(3.0) * chain.scale
    truth, made = np.random.default_rng(seed).uniform(-bound, bound), []
    for link, x in zip(chain.links, chain.parts(truth), strict=True):
        base, grasp = link.base @ x[: link.m], link.grasp @ x[link.m : 2 * link.m]
        values = {"base_m": base[:3], "base_rad": base[3:], "grasp_m": grasp[:3], "zeros_rad": x[link.zeros]}
        made += [f"simulation.reality.arms.{link.arm.name}.{key}={v.round(6).tolist()}" for key, v in values.items()]
    return made


def hand(seed: int) -> str:
    """A person's hand on the object, in steps: a few newtons to and fro and up and down, and a turn."""
    begin, pushes = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, 3), []
    for k in range(round(PUSHED_S / PUSH_S)):
        fx, fz, my = np.array([3.5, 2.5, 0.2]) * np.sin(np.array([2.0, 3.0, 2.4]) * (k + 0.5) * PUSH_S + begin)
        pushes.append(
            f"{{at_s={k * PUSH_S}, duration_s={PUSH_S}, force_N=[{fx:.3f},0.0,{fz:.3f}], moment_Nm=[0.0,{my:.4f},0.0]}}"
        )
    return f"simulation.push=[{', '.join(pushes)}]"


def floated(changes: list[str], folder: Path) -> tuple[list[Path], float]:
    """Logs of arms that floated with the object, and for how long."""
    logs: list[Path] = []
    afloat_s = 0.0
    while afloat_s < AFLOAT_S and len(logs) < SESSIONS:
        out = folder / f"float{len(logs)}"
        words = ("--arm", "left", "--arm", "right", "--holding", "--emulate", "--json", "--out", out)
        process = start("float", CELL, *words, *sets(changes), cwd=folder)
        assert process.stdout is not None
        since_s, told = time.monotonic(), 0.0
        for line in process.stdout:
            glances = json.loads(line)
            if isinstance(glances, dict):
                break
            if all(glance["mode"] == "FLOAT" for glance in glances):
                told = min(glance["t_s"] for glance in glances)
            if afloat_s + told >= AFLOAT_S and since_s:
                since_s = 0.0
                process.send_signal(signal.SIGINT)
        process.communicate()
        afloat_s += told
        if (out / "run.mcap").exists():
            logs.append(out / "run.mcap")
    return logs, afloat_s


def calibrated(logs: list[Path], folder: Path) -> dict[str, Any] | None:
    """What `coop calibrate` says; None where the logs have too few poses."""
    done = coop("calibrate", *logs, "--out", folder / "new", "--json", *sets(list(UNSURE)))
    if "poses in the log: found" in done.stderr:
        return None
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def strain(words: list[str], out: Path) -> float:
    """Force with which the arms of a run pull against each other, rms, N."""
    done = coop("run", *words, *sets(list(AS_IT_IS)), "--duration", 8, "--no-report", "--out", out)
    if done.returncode not in (0, 1):
        raise RuntimeError(done.stderr)
    arms = json.loads((out / "results.json").read_text())["arms"].values()
    return float(max(arm["internal_realised"]["rms_force_N"] for arm in arms))


def sets(changes: list[str]) -> list[str]:
    """The words that make these changes."""
    return [word for change in changes for word in ("--set", change)]


if __name__ == "__main__":
    sys.exit(main())
