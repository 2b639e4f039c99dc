"""A run as a short moving picture, and its first moment as a still; both are drawn here and need no browser."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image

from agent.atomic import place_of
from agent.report.prepared import Prepared
from agent.view.camera import Camera
from agent.view.draw import picture
from agent.view.error import ViewError
from agent.view.staged import Staged, stage, status_text

STILL_PX: Final = (1008, 560)
FILM_PX: Final = (640, 340)
FILM_HZ: Final = 12.5  # pictures a second of the film: a multiple of GIF's 10 ms
FILM_MAX: Final = 1500  # pictures: some minutes of drawing
_COLOURS: Final = 96  # of a GIF
FORMATS: Final = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """Which part of a run, how fast, and where to."""

    path: Path
    begin_s: float = 0.0
    end_s: float | None = None  # the end of the run
    speed: float = 2.5


def drawn(staged: Staged, row: int, camera: Camera, size: tuple[int, int], more: str = "") -> Image.Image:
    """The picture of one instant."""
    caption = status_text(staged.motion, row) + more
    return picture(staged.scene, staged.placed, row, camera, size, caption)


def still(run: Prepared) -> bytes:
    """The first moment of a run as PNG.  Raises Refusal when the log does not say how the cell looks."""
    staged = stage(run, pictures_hz=1.0)
    out = io.BytesIO()
    drawn(staged, 0, staged.camera(STILL_PX), STILL_PX).save(out, "PNG", optimize=True)
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
    end_s = run.info.duration_s if options.end_s is None else options.end_s
    count = (min(end_s, run.info.duration_s) - options.begin_s) * FILM_HZ / options.speed
    if not (math.isfinite(options.speed) and options.speed > 0.0) or count > FILM_MAX:
        raise ViewError(
            f"film at {options.speed:g} times the pace", found=f"{count:.0f} pictures", expected=f"at most {FILM_MAX}",
            remedy="show less of the run with --from and --to, or a faster --speed",
        )  # fmt: skip
    staged = stage(run, FILM_HZ / options.speed, options.begin_s, end_s)
    camera = staged.camera(FILM_PX)
    more = f" · {options.speed:g} times as fast" if options.speed != 1.0 else ""
    frames = [drawn(staged, row, camera, FILM_PX, more) for row in range(len(staged.motion.t))]
    if kind == "GIF":
        frames = [f.quantize(_COLOURS, dither=Image.Dither.NONE) for f in frames]
    place = place_of(options.path, ViewError)
    part = place.with_name(f".{place.name}.part")
    try:
        settings = {"quality": 80, "method": 4, "minimize_size": True} if kind == "WEBP" else {"optimize": True}
        frames[0].save(
            part, kind, save_all=True, append_images=frames[1:], duration=round(1e3 / FILM_HZ), loop=0, **settings
        )  # fmt: skip
        part.replace(place)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ViewError(
            f"cannot write {options.path}", found=error.strerror or str(error), expected="a folder that can be written",
            remedy="name another file",
        ) from error  # fmt: skip
    return len(frames)
