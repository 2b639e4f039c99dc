"""`make varied`: cells that users might write, of which nothing may hold while nothing fails.

VARIED_N: shipped cells with changes (default 60).  VARIED_MADE: cells as `coop new` makes them (12).  VARIED_SEED: of
the first one of either (0).  Half an hour of CPU, half of it the search for gains.
A shipped cell gets another motion (larger, quicker, turned further, along both axes of its plane, from rest to rest),
an object 0.5 to 2 times as heavy, and `[tolerance]` as shipped or smaller; one that is made has two to four arms of any
model, an object and a motion of its own.  Each runs for 20 s as its file says and in two realities within its
tolerance.  What `coop check` or `coop new` refuses is told and not run.  Wrong is an arm that holds, and a run that is
not finite.
"""

from __future__ import annotations

import os
import sys
import tomllib
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import tomli_w

import configs
from agent.config.cell import Cell, cell_from_toml
from agent.config.reality import draw
from agent.make.make import Maker
from agent.make.wish import MotionKind, MotionWish, ObjectWish, Wish, arm_wishes
from agent.study.lab import Laboratory, Run
from agent.verify.check import examine
from drivers.interface import DriverError, Refusal
from sim_backend.physics.spec import PlantError
from tests.soak.watch import say

CELLS: Final = ("paper_real", "two_wx200", "two_models", "three_wx250s", "four_wx250s", "paper_adaptive")
SPATIAL: Final = "wx250s"
IN_SPACE: Final = (SPATIAL, "awx250s")
PAIR: Final = 2
PAIRED: Final = (SPATIAL, SPATIAL, "wx200", "wx250", "awx250s", "widowx_mk2")
FACES: Final = ("-x", "+x", "+y", "-y")
FRICTION: Final = ([0.6, 1.5], [0.8, 1.25], [0.9, 1.1])
CALIBRATED: Final = ("base_m", "base_rad", "grasp_m", "masses", "object", "torque_constant")
END_S: Final = 20.0
REALITIES: Final = 2

File = dict[str, Any]


def varied(seed: int) -> tuple[Cell, str]:
    """A cell drawn from this seed, and words for it.  Raises Refusal for one that cannot be read."""
    rng = np.random.default_rng(seed)
    raw = (configs.CELLS_DIR / f"{CELLS[seed % len(CELLS)]}.toml").read_bytes()
    file, stated = tomllib.loads(raw.decode()), cell_from_toml(raw, "a shipped cell").tolerance
    motion = _moved(file, rng)
    heavy = float(rng.uniform(0.5, 2.0))
    body = file["object"]
    body["mass_kg"] *= heavy
    body["inertia_kg_m2"] = {axis: heavy * value for axis, value in body["inertia_kg_m2"].items()}
    friction, calibrated = FRICTION[int(rng.integers(len(FRICTION)))], (1.0, 0.3)[int(rng.integers(2))]
    tolerance = {key: calibrated * getattr(stated, key) for key in CALIBRATED}
    file["tolerance"] = {**file.get("tolerance", {}), **tolerance, "friction": friction}
    file["duration_s"], file["simulation"]["ready_s"], file["report"]["transient_s"] = END_S, 2.0, 4.0
    words = f"{file['name']}, {motion}, object × {heavy:.2f}, friction {friction}, other errors × {calibrated:g}"
    return cell_from_toml(tomli_w.dumps(file).encode(), words), words


def _moved(file: File, rng: np.random.Generator) -> str:
    """Change the motion of a cell file, the object at its begin; what it is."""
    motion = file["trajectory"]
    if motion["kind"] == "waypoints":
        pace, size, begin = (
            float(rng.uniform(0.5, 1.6)),
            float(rng.uniform(0.4, 1.3)),
            np.array(file["object"]["p_start_m"]),
        )
        for point in motion["points"][1:]:
            off = size * (np.array(point["p_m"]) - begin) + rng.normal(0.0, 0.005, 3)
            point["t_s"], point["p_m"] = round(pace * point["t_s"], 3), (begin + off).tolist()
        return f"pace {1.0 / pace:.2f}, size {size:.2f}"
    centre, plane = np.array(motion["p_centre_m"]), 1.0 - np.abs(np.array(motion["axis"]))
    if not rng.integers(3):
        begin, end = (centre + plane * rng.uniform(-0.03, 0.03, 3) for _ in range(2))
        move_s, wait_s = (round(float(rng.uniform(*span)), 2) for span in ((2.0, 8.0), (0.5, 3.0)))
        file["object"]["p_start_m"] = begin.tolist()
        ends = {"p_from_m": begin.tolist(), "p_to_m": end.tolist()}
        file["trajectory"] = {"kind": "rest_to_rest", **ends, "move_s": move_s, "wait_s": wait_s}
        return f"{1e3 * float(np.linalg.norm(end - begin)):.0f} mm from rest to rest in {move_s:g} s"
    along = float(rng.uniform(0.2, 1.1)) * np.array(motion["p_amplitude_m"])
    motion["p_amplitude_m"] = (along + rng.integers(2) * plane * rng.uniform(-0.02, 0.02, 3)).tolist()
    motion["angle_rad"] *= float(rng.uniform(-1.5, 1.5))
    motion["period_s"] = round(motion["period_s"] * float(rng.uniform(0.6, 2.0)), 2)
    motion["ramp_s"] = round(float(rng.uniform(1.5, 4.0)), 2)
    size = 1e3 * float(np.linalg.norm(motion["p_amplitude_m"]))
    return f"± {size:.0f} mm and {motion['angle_rad']:.2f} rad in {motion['period_s']:g} s, ramp {motion['ramp_s']:g} s"


def made(seed: int) -> tuple[Cell, str]:
    """A cell that `coop new` makes of a wish drawn from this seed, and words for it.  Raises Refusal."""
    rng = np.random.default_rng(seed)
    count = int(rng.choice([2, 2, 3, 4]))
    models = [str(model) for model in rng.choice(PAIRED, 2)] if count == PAIR else [SPATIAL] * count
    spatial = all(model in IN_SPACE for model in models)
    arms = arm_wishes([f"{model} face={face}" for model, face in zip(models, FACES, strict=False)])
    x, y, z = (float(rng.uniform(*span)) for span in ((0.15, 0.35), (0.03, 0.15), (0.02, 0.08)))
    body = ObjectWish(float(rng.uniform(0.025, 0.175)) * count, (x, y if count == PAIR else y + 0.06, z))
    kind = MotionKind(str(rng.choice(["lift", "carry", "sinusoid"])))
    dx, dy, dz = rng.uniform(-0.05, 0.05, 3).tolist()
    by = (0.0, 0.0, abs(dz)) if kind is MotionKind.LIFT else (dx, dy if spatial else 0.0, abs(dz))
    time_s = float(rng.uniform(6.0, 20.0) if kind is MotionKind.SINUSOID else rng.uniform(3.0, 10.0))
    wish = Wish(f"made{seed}", arms, body, MotionWish(kind, by, time_s))
    words = f"{', '.join(models)}, {body.mass_kg:.2f} kg, {kind} by {np.round(by, 3).tolist()} in {time_s:.1f} s"
    return Maker(wish).make().cell, words


def wrong(cell: Cell, seed: int) -> Iterator[str]:
    """Every run in which an arm holds, or nothing is finite any more."""
    lab = Laboratory(cell)
    for k in range(1 + REALITIES):
        run = Run(lab, draw(cell.file.tolerance, seed + k * 100_000, cell) if k else None)
        where = f"reality {seed + k * 100_000}" if k else "as its file says"
        try:
            while run.t < END_S and not run.trips:
                run.advance()
        except (PlantError, DriverError) as error:
            yield f"{where}: {error}"
        if run.trips:
            yield f"{where}: {run.trips[0].told}"


def main() -> int:
    """All cells; 0 when no arm held."""
    first = int(os.environ.get("VARIED_SEED", "0"))
    counts = ((varied, int(os.environ.get("VARIED_N", "60"))), (made, int(os.environ.get("VARIED_MADE", "12"))))
    bad, ran = 0, 0
    for seed, drawn in ((first + k, draws) for draws, count in counts for k in range(count)):
        try:
            cell, words = drawn(seed)
            examine(cell).require()
        except Refusal as refusal:
            say(f"{seed} refused: {refusal}")
            continue
        found = list(wrong(cell, seed))
        say(f"{seed} {words}: {'; '.join(found) or 'ok'}")
        bad, ran = bad + len(found), ran + 1 + REALITIES
    say(f"{ran} runs of {END_S:g} s: {bad} wrong")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
