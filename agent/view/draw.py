"""A scene at one instant as a picture of pixels, the same on every machine: solids, then wires and arrows over them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from agent.view.camera import Camera
from agent.view.pose import Array, moved
from agent.view.raster import Raster
from agent.view.scene import OBJECT, Placed, Scene
from agent.view.shapes import GRID, Colour, box_edges

GROUND: Final[Colour] = (250, 250, 248)
INK: Final[Colour] = (35, 39, 43)
FINER: Final = 2  # drawn so many times larger, then made smaller: smooth edges
WIRE_PX: Final = 1.0
ARROW_PX: Final = 2.0
HEAD_PX: Final = 7.0
TEXT_PX: Final = 14


def picture(
    scene: Scene, placed: Placed, row: int, camera: Camera, size: tuple[int, int], caption: str = ""
) -> Image.Image:
    """The scene at instant `row` of what is placed; `size`: width and height in pixels."""
    width, height = FINER * size[0], FINER * size[1]
    raster = Raster(camera, width, height, GROUND)
    canvas = Image.fromarray(raster.pixels)
    _grid(ImageDraw.Draw(canvas), scene, camera, (width, height))
    raster.pixels[:] = np.asarray(canvas)
    for name, meshes in scene.solids.items():
        for mesh in meshes if _is_placed(placed, name, row) else ():
            raster.add(moved(placed.poses[name][row], mesh.vertices), mesh.faces, mesh.colour)
    image = Image.fromarray(raster.pixels)
    over = ImageDraw.Draw(image)
    for wire in scene.wires:
        if _is_placed(placed, wire.name, row):
            ends = moved(placed.poses[wire.name][row], box_edges(scene.size_m).reshape(-1, 3))
            for a, b in camera.project(ends, width, height)[:, :2].reshape(-1, 2, 2):
                over.line([*a, *b], fill=wire.colour, width=round(FINER * WIRE_PX))
    for arrow in scene.arrows:
        if arrow.name in placed.arrows:
            ends = camera.project(placed.arrows[arrow.name][row], width, height)[:, :2]
            _arrow(over, ends, arrow.colour)
    small = image.resize(size, Image.Resampling.BOX)
    if caption:
        ImageDraw.Draw(small).text((10, size[1] - 10), caption, fill=INK, font=_font(), anchor="ls")
    return small


def project(scene: Scene, placed: Placed, row: int, camera: Camera, size: tuple[int, int]) -> dict[str, Array]:
    """The pixel (2,) at which the middle of the object and of each link falls, by name."""
    names = [OBJECT, *(name for name in scene.solids if name.startswith("arms/"))]
    middles = {name: np.vstack([m.vertices for m in scene.solids[name]]).mean(axis=0) for name in names}
    return {
        name: camera.project(moved(placed.poses[name][row], middle[None]), *size)[0, :2]
        for name, middle in middles.items()
    }


def _is_placed(placed: Placed, name: str, row: int) -> bool:
    return name in placed.poses and bool(np.isfinite(placed.poses[name][row]).all())


def _grid(draw: ImageDraw.ImageDraw, scene: Scene, camera: Camera, size: tuple[int, int]) -> None:
    ends = camera.project(scene.floor().reshape(-1, 3), *size)
    for a, b in ends.reshape(-1, 2, 3):
        draw.line([a[0], a[1], b[0], b[1]], fill=GRID, width=FINER)


def _arrow(draw: ImageDraw.ImageDraw, ends: Array, colour: Colour) -> None:
    tail, tip = ends
    along = tip - tail
    length = float(np.linalg.norm(along))
    if not length >= 1.0:  # or no number
        return
    along /= length
    head = min(FINER * HEAD_PX, 0.6 * length)
    neck, aside = tip - head * along, 0.4 * head * np.array([-along[1], along[0]])
    draw.line([*tail, *neck], fill=colour, width=round(FINER * ARROW_PX))
    draw.polygon([tuple(tip), tuple(neck + aside), tuple(neck - aside)], fill=colour)


def _font() -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), TEXT_PX)


def pixels(image: Image.Image) -> NDArray[np.uint8]:
    """Height × width × 3 of a picture."""
    return np.asarray(image.convert("RGB"))
