"""Stills and films show the arms where they are, in front what is in front, and are the same every time."""

from __future__ import annotations

import io
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from agent.report.moments import Moment
from agent.report.prepared import Prepared, prepare
from agent.view.camera import Camera, camera_for
from agent.view.draw import GROUND, pixels, project
from agent.view.error import ViewError
from agent.view.film import FILM_HZ, FILM_PX, STILL_PX, FilmOptions, drawn, still, write_film
from agent.view.raster import AMBIENT, Raster
from agent.view.scene import OBJECT, OBJECT_COLOUR
from agent.view.shapes import box
from agent.view.staged import Staged, modes_at, stage, status_text
from tests.support.few import few
from tests.support.view_run import view_log, view_run

SIZE = (320, 240)
FRONT = Camera(np.array([0.0, 0.0, 2.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))


@cache
def the_run() -> Prepared:
    return view_run()


@cache
def staged() -> Staged:
    return stage(the_run(), 20.0)


def test_the_camera_looks_at_the_middle_with_x_right_and_y_up() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 1.0]])
    seen = FRONT.project(points, *SIZE)
    assert seen[0] == pytest.approx([160.0, 120.0, 2.0])
    scale = 120.0 / (np.tan(0.5 * FRONT.fov_rad) * 2.0)
    assert seen[1, :2] == pytest.approx([160.0 + 0.1 * scale, 120.0])
    assert seen[2, :2] == pytest.approx([160.0, 120.0 - 0.1 * scale])
    assert seen[3] == pytest.approx([160.0, 120.0, 1.0])


def test_everything_is_in_the_picture_and_fills_it_and_the_first_arm_is_left() -> None:
    scene, placed = staged().scene, staged().placed
    points = scene.points(placed, 0)
    for size in ((640, 340), (340, 640)):
        seen = camera_for(scene, points, size[0] / size[1]).project(points, *size)
        assert seen[:, :2].min() > 0.0
        assert np.all(seen[:, :2].max(axis=0) < size)
        assert np.max(np.ptp(seen[:, :2], axis=0) / size) > 0.85
    places = project(scene, placed, 0, staged().camera(SIZE), SIZE)
    assert places["arms/left/base"][0] < places[OBJECT][0] < places["arms/right/base"][0]
    assert places[OBJECT][1] < places["arms/left/base"][1]  # above


def test_the_nearer_solid_hides_the_other_whatever_comes_first() -> None:
    near, far = box(np.full(3, 0.2), (200, 0, 0)), box(np.full(3, 0.2), (0, 0, 200))
    for order in ((near, far), (far, near)):
        raster = Raster(FRONT, *SIZE, (255, 255, 255))
        for mesh in order:
            shift = 0.5 if mesh is near else 0.0
            raster.add(mesh.vertices + np.array([0.0, 0.0, shift]), mesh.faces, mesh.colour)
        red, _, blue = raster.pixels[120, 160].tolist()
        assert red >= int(AMBIENT * 200)
        assert blue == 0
        assert raster.pixels[5, 5].tolist() == [255, 255, 255]


def test_a_face_towards_the_light_is_brighter() -> None:
    raster = Raster(replace(FRONT, position=np.array([0.0, 1.2, 1.6])), *SIZE, (255, 255, 255))
    raster.add(box(np.full(3, 0.3), (200, 200, 200)).vertices, box(np.full(3, 0.3), RED).faces, (200, 200, 200))
    top, front = (raster.camera.project(np.array([p]), *SIZE)[0, :2] for p in ([0, 0.15, 0.0], [0, 0.0, 0.15]))
    assert raster.pixels[int(top[1]), int(top[0]), 0] > raster.pixels[int(front[1]), int(front[0]), 0] + 10


RED = (200, 0, 0)


def test_what_is_behind_the_camera_is_left_out() -> None:
    raster = Raster(FRONT, *SIZE, (255, 255, 255))
    raster.add(box(np.full(3, 0.2), RED).vertices + np.array([0.0, 0.0, 3.0]), box(np.full(3, 0.2), RED).faces, RED)
    assert (raster.pixels == 255).all()


def hue(colour: object) -> np.ndarray:
    shade = np.asarray(colour, float)
    return shade / np.linalg.norm(shade)


@pytest.mark.parametrize("row", [0, 39])
def test_arms_and_object_are_in_the_picture_where_they_should_be(row: int) -> None:
    camera = staged().camera(FILM_PX)
    seen = pixels(drawn(staged(), row, camera, FILM_PX))
    places = project(staged().scene, staged().placed, row, camera, FILM_PX)
    left, right = (arm.colour for arm in staged().scene.cell.arms)
    for name, colour in (("arms/left/base", left), ("arms/right/base", right), (OBJECT, OBJECT_COLOUR)):
        x, y = np.round(places[name]).astype(int)
        around = seen[y - 5 : y + 6, x - 5 : x + 6].reshape(-1, 3)
        alike = [bool(np.abs(hue(pixel) - hue(colour)).max() < 0.06) for pixel in around]
        assert np.mean(alike) > 0.4, name  # an arrow or an edge may cross it
    assert seen[5, 5].tolist() == list(GROUND)


def test_the_object_has_moved_in_the_picture() -> None:
    camera = staged().camera(FILM_PX)
    at = [project(staged().scene, staged().placed, row, camera, FILM_PX)[OBJECT][0] for row in (0, 39)]
    assert at[1] - at[0] > 10.0


def test_a_still_is_the_first_moment_and_the_same_every_time() -> None:
    one, two = still(the_run()), still(the_run())
    assert one == two
    picture = Image.open(io.BytesIO(one))
    assert picture.size == STILL_PX
    assert len(np.unique(pixels(picture).reshape(-1, 3), axis=0)) > 50


@pytest.mark.parametrize("name", few(("film.gif", "film.webp", "film.png"), "film.gif".__eq__))
def test_a_film_has_its_pictures_and_pace(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    count = write_film(the_run(), FilmOptions(path, 0.5, 1.5, speed=5.0))
    assert count == 3  # 1 s at five times the pace is 0.2 s of 12.5 pictures a second
    with Image.open(path) as film:
        assert (film.n_frames, film.size) == (count, FILM_PX)  # type: ignore[attr-defined]
        film.seek(1)
        film.load()
        assert film.info["duration"] == pytest.approx(1e3 / FILM_HZ)
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_behind_a_link_is_the_file_it_leads_to(tmp_path: Path) -> None:
    link, far = tmp_path / "film.png", tmp_path / "far" / "film"
    far.parent.mkdir()
    link.symlink_to("far/film")
    write_film(the_run(), FilmOptions(link, 0.0, 0.1))
    assert link.readlink() == Path("far/film")
    assert sorted(tmp_path.rglob("*")) == [far.parent, far, link]
    link.unlink()
    os.mkfifo(link)
    with pytest.raises(ViewError, match=r"film\.png: found a pipe, expected a file, or nothing"):
        write_film(the_run(), FilmOptions(link, 0.0, 0.1))
    assert link.is_fifo()


def test_a_film_of_nothing_or_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ViewError, match=r"film\.avi"):
        write_film(the_run(), FilmOptions(tmp_path / "film.avi"))
    with pytest.raises(ViewError, match=r"expected some of 0 to 1\.995 s"):
        write_film(the_run(), FilmOptions(tmp_path / "film.gif", 5.0, 6.0))
    with pytest.raises(ViewError, match="No such file"):
        write_film(the_run(), FilmOptions(tmp_path / "nowhere" / "film.gif", 0.0, 0.5))
    for speed in (0.01, float("nan"), float("inf")):
        with pytest.raises(ViewError, match="pictures, expected at most 1500"):
            write_film(the_run(), FilmOptions(tmp_path / "film.gif", speed=speed))
    assert list(tmp_path.iterdir()) == []


def test_the_caption_says_time_and_modes() -> None:
    log = view_log()
    log.agents["left"]["mode"][200:] = 3
    motion = stage(prepare(log), 20.0).motion
    assert status_text(motion, 0) == "t = 0.0 s · TRACK"
    assert status_text(motion, 30) == "t = 1.5 s · left HOLD, right TRACK"
    told = [
        Moment(0.0, "left", "torque on"),
        Moment(0.0, "left", "mode TRACK → HOLD"),
        Moment(0.0, "left", 60 * "x", True),
    ]
    assert status_text(motion, 0, told) == f"t = 0.0 s · TRACK · left: mode TRACK → HOLD · left: {39 * 'x'}…"
    log.agents["right"] = log.agents["right"][:100]
    assert modes_at(stage(prepare(log), 20.0).motion, 39) == "left HOLD, right TRACK (no row)"


def test_a_run_that_flew_away_is_drawn() -> None:
    log = view_log()
    rows = log.agents["left"]
    rows["q"][200:] = np.nan
    rows["wrench_cmd"][100:] = np.inf
    rows["p_object_des"][300:] = 1e300
    shown = stage(prepare(log), 20.0)
    camera = shown.camera(SIZE)
    for row in (0, 15, 25, 39):
        assert pixels(drawn(shown, row, camera, SIZE)).std() > 5.0


def test_a_log_without_a_row_in_the_run_is_refused() -> None:
    log = view_log()
    for rows in log.agents.values():
        rows["t"] -= 1000.0
    with pytest.raises(ViewError, match="no row of any arm"):
        stage(prepare(log), 20.0)


def test_a_part_of_a_run_begins_where_it_is_asked_to() -> None:
    part = stage(the_run(), 20.0, 0.52, 1.02)
    assert part.motion.t == pytest.approx(0.52 + np.arange(10) / 20.0)
    assert part.placed.poses[OBJECT].shape == (10, 7)
    assert part.motion.arms["left"].fresh.all()
