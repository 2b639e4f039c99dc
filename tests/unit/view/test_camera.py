"""The first picture is taken from the front, a little from above and aside, and just holds everything."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.view.camera import FOV_RAD, MARGIN, Camera, camera_for

ELEVATION, ASIDE = math.radians(18.0), math.radians(14.0)
X, Y, Z = np.eye(3)


def scene(up: np.ndarray, *bases: list[float]) -> Any:
    return SimpleNamespace(up=up, cell=SimpleNamespace(arms=[SimpleNamespace(p_world_base=base) for base in bases]))


def cloud(seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (60, 3)) * [0.5, 0.2, 0.3] + [0.1, 0.4, 0.2]


def back_of(camera: Camera) -> np.ndarray:
    return np.asarray((camera.position - camera.look_at) / np.linalg.norm(camera.position - camera.look_at))


def seen_from(front: np.ndarray, right: np.ndarray, up: np.ndarray) -> np.ndarray:
    level = math.cos(ASIDE) * front + math.sin(ASIDE) * right
    return np.asarray(math.cos(ELEVATION) * level + math.sin(ELEVATION) * up)


@pytest.mark.parametrize(
    ("what", "front", "right"),
    [
        (scene(Z, [-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]), -Y, X),
        (scene(Z, [0.3, 0.0, 0.0], [-0.3, 0.0, 0.0]), Y, -X),
        (scene(Z, [0.1, -0.3, 0.0], [0.1, 0.3, 0.0]), X, Y),
        (scene(Z, [-0.3, 0.0, 0.1], [0.3, 0.0, 0.7]), -Y, X),  # the second stands higher
        (scene(Z, [-0.3, 0.0, 0.0], [-0.1, 0.5, 0.0], [0.2, -0.4, 0.0], [0.3, 0.0, 0.0]), -Y, X),
        (scene(Y, [-0.3, 0.0, 0.2], [0.3, 0.0, 0.2]), Z, X),
        (scene(-Z, [-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]), Y, X),  # upside down
        (scene(Z, [0.2, 0.1, 0.0]), X, Y),  # one arm, or arms above each other
        (scene(Y, [0.2, 0.1, 0.0], [0.2, 0.8, 0.0]), Z, X),
        (scene(-Z, [0.2, 0.1, 0.0]), X, -Y),
        (scene(X, [0.2, 0.1, 0.0]), Z, -Y),
    ],
)  # fmt: skip
def test_it_is_taken_from_the_front_with_the_first_arm_on_the_left(
    what: Any, front: np.ndarray, right: np.ndarray
) -> None:
    camera = camera_for(what, cloud(), 1.5)
    assert back_of(camera) == pytest.approx(seen_from(front, right, what.up), abs=1e-9)


@pytest.mark.parametrize("aspect", [0.5, 1.2, 3.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_just_holds_all_points_with_a_margin(aspect: float, seed: int) -> None:
    points, height = cloud(seed), 1000
    camera = camera_for(scene(Z, [-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]), points, aspect)
    x, y, _ = camera.project(points, round(aspect * height), height).T
    across, along = np.abs(x / (aspect * height) - 0.5), np.abs(y / height - 0.5)
    most = max(across.max(), along.max())
    assert most < 0.5
    distances = (points - camera.position) @ -back_of(camera)
    nearest = np.where(across > along, across, along).argmax()
    assert 2.0 * most * MARGIN == pytest.approx(1.0, abs=0.02), f"point {nearest}, {distances[nearest]:.2f} m away"


def test_what_is_seen_stands_in_the_middle_of_the_height() -> None:
    points = cloud() + 5.0 * Z
    camera = camera_for(scene(Z, [-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]), points, 1.2)
    heights = (points - camera.look_at) @ camera.axes[1]
    assert heights.max() == pytest.approx(-heights.min(), abs=1e-9)
    assert camera.fov_rad == FOV_RAD


def test_axes_are_a_right_handed_frame_whatever_the_up() -> None:
    axes = Camera(np.array([1.0, -2.0, 0.7]), np.array([0.2, 0.1, 0.3]), Z).axes
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[1] @ Z > 0.0
    assert axes[0] @ Z == pytest.approx(0.0, abs=1e-12)
    assert axes[2] == pytest.approx(np.array([0.8, -2.1, 0.4]) / np.linalg.norm([0.8, -2.1, 0.4]))


def test_what_is_behind_the_camera_is_put_just_before_it() -> None:
    camera = Camera(np.zeros(3), Y, Z)
    assert camera.project(np.array([[0.0, -1.0, 0.0], [0.0, 2.0, 0.0]]), 10, 10)[:, 2].tolist() == [0.02, 2.0]
