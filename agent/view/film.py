"""A run as a short moving picture, and its first moment as a still; both are drawn here and need no browser."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from agent.modes import Mode
from agent.report.prepared import Prepared
from agent.view.arm import ViewError
from agent.view.camera import Camera, camera_for
from agent.view.draw import picture
from agent.view.drawing import drawing_of_log
from agent.view.motion import Motion, motion_of
from agent.view.scene import Placed, Scene

STILL_PX: Final = (1008, 560)
FILM_PX: Final = (640, 340)
FILM_HZ: Final = 12.5  # pictures a second of the film: a multiple of GIF's 10 ms
_COLOURS: Final = 96  # of a GIF
_CAMERA_LOOKS: Final = 40  # instants that the camera must hold
FORMATS: Final = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """Which part of a run, how fast, and where to."""

    path: Path
    begin_s: float = 0.0
    end_s: float | None = None  # the end of the run
    speed: float = 2.5


@dataclass(frozen=True, slots=True)
class _Set:
    scene: Scene
    motion: Motion
    placed: Placed

    def camera(self, size: tuple[int, int]) -> Camera:
        rows = np.unique(np.linspace(0, len(self.motion.t) - 1, _CAMERA_LOOKS).astype(int))
        points = np.vstack([self.scene.points(self.placed, row) for row in rows.tolist()])
        return camera_for(self.scene, points, size[0] / size[1])

    def draw(self, row: int, camera: Camera, size: tuple[int, int], more: str = "") -> Image.Image:
        caption = f"t = {self.motion.t[row]:.1f} s · {modes_at(self.motion, row)}{more}"
        return picture(self.scene, self.placed, row, camera, size, caption)


def still(run: Prepared) -> bytes:
    """The first moment of a run as PNG.  Raises Refusal when the log does not say how the cell looks."""
    motion = motion_of(run, pictures_hz=1.0)
    stage = _stage(run, motion)
    out = io.BytesIO()
    stage.draw(0, stage.camera(STILL_PX), STILL_PX).save(out, "PNG", optimize=True)
    return out.getvalue()


def write_film(run: Prepared, options: FilmOptions) -> int:
    """Write a moving picture, GIF, WebP or PNG by its name; returns how many pictures it has.

    Raises Refusal for another name, an empty part of the run, or a log that does not say how the cell looks.
    """
    kind = FORMATS.get(options.path.suffix.lower())
    if kind is None:
        raise ViewError(
            "format of the film", found=options.path.name, expected=" or ".join(f"NAME{end}" for end in FORMATS),
            remedy="name it so",
        )  # fmt: skip
    motion = _part(motion_of(run, FILM_HZ / options.speed), options, run)
    stage = _stage(run, motion)
    camera = stage.camera(FILM_PX)
    more = f" · {options.speed:g} times as fast" if options.speed != 1.0 else ""
    frames = [stage.draw(row, camera, FILM_PX, more) for row in range(len(motion.t))]
    if kind == "GIF":
        frames = [f.quantize(_COLOURS, dither=Image.Dither.NONE) for f in frames]
    part = options.path.with_name(f".{options.path.name}.part")
    try:
        settings = {"quality": 80, "method": 4, "minimize_size": True} if kind == "WEBP" else {"optimize": True}
        frames[0].save(
            part, kind, save_all=True, append_images=frames[1:], duration=round(1e3 / FILM_HZ), loop=0, **settings
        )  # fmt: skip
        part.replace(options.path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ViewError(
            f"cannot write {options.path}", found=error.strerror or str(error), expected="a folder that can be written",
            remedy="name another file",
        ) from error  # fmt: skip
    return len(frames)


def modes_at(motion: Motion, row: int) -> str:
    """The modes of all arms at one instant, in words; one word where they are the same."""
    known = {m.value: m.name for m in Mode}
    modes = {
        name: known.get(int(arm.mode[row]), "?") + ("" if arm.fresh[row] else " (no row)")
        for name, arm in motion.arms.items()
    }
    if len(set(modes.values())) == 1:
        return next(iter(modes.values()))
    return ", ".join(f"{name} {mode}" for name, mode in modes.items())


def _stage(run: Prepared, motion: Motion) -> _Set:
    scene = Scene.of(drawing_of_log(run.log), motion)
    return _Set(scene, motion, scene.place(motion))


def _part(motion: Motion, options: FilmOptions, run: Prepared) -> Motion:
    end_s = run.info.duration_s if options.end_s is None else options.end_s
    chosen = motion.within(options.begin_s, end_s)
    if len(chosen.t) < 2:
        last = float(motion.t[-1])
        raise ViewError(
            "part of the run", found=f"{options.begin_s:g} to {end_s:g} s", expected=f"some of 0 to {last:g} s",
            remedy="correct --from and --to",
        )  # fmt: skip
    return chosen
