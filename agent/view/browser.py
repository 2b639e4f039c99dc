"""A scene in the browser (viser): its solids, wires and arrows as nodes that are moved from picture to picture."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import viser

from agent.view.camera import Camera
from agent.view.pose import Array
from agent.view.scene import OBJECT, Placed, Scene
from agent.view.shapes import GRID, box_edges

PAGE_PX: Final = (880, 720)  # a picture on a page with controls
SHAFT_M, HEAD_M, HEAD_LENGTH_M = 0.003, 0.008, 0.02
WIRE_PX: Final = 2.0
LABEL_AT: Final = 0.92  # of the way from the middle of the picture to its upper edge


class Nodes:
    """What is seen of a scene; `show` moves it."""

    def __init__(self, server: viser.ViserServer, scene: Scene, camera: Camera, *, titled: bool = True) -> None:
        """`titled`: the text stands above the picture, too, which costs a browser without a graphics card 0.1 s."""
        self._server, self._scene = server, scene
        up, at = server.scene, server.initial_camera
        up.set_up_direction(scene.up)
        at.position, at.look_at, at.up, at.fov = camera.position, camera.look_at, scene.up, camera.fov_rad
        up.configure_environment_map(None)
        up.configure_default_lights(True, cast_shadow=False)
        up.add_light_ambient("/light", intensity=0.7)
        lines = scene.floor()
        up.add_line_segments("/floor", lines, GRID, thickness=1.0, thickness_units="screen")
        self._nodes: dict[str, Any] = {}
        self._shown: dict[str, Array] = {}
        for name, meshes in scene.solids.items():
            self._nodes[name] = up.add_frame(f"/{name}", show_axes=False)
            for number, mesh in enumerate(meshes):
                up.add_mesh_simple(
                    f"/{name}/{number}", mesh.vertices, mesh.faces, color=mesh.colour, flat_shading=True,
                    opacity=0.75 if name == OBJECT else None,
                )  # fmt: skip
        edges = box_edges(scene.size_m)
        for wire in scene.wires:
            self._nodes[wire.name] = up.add_frame(f"/{wire.name}", show_axes=False)
            up.add_line_segments(f"/{wire.name}/edges", edges, wire.colour, thickness=WIRE_PX, thickness_units="screen")
        self._arrows = {
            arrow.name: up.add_arrows(
                f"/{arrow.name}", np.zeros((1, 2, 3)), np.array([arrow.colour], np.uint8), shaft_radius=SHAFT_M,
                head_radius=HEAD_M, head_length=HEAD_LENGTH_M, visible=False,
            )
            for arrow in scene.arrows
        }  # fmt: skip
        self._label = up.add_label("/status", "", position=_above(camera), anchor="top-center") if titled else None

    def show(self, placed: Placed, row: int, text: str) -> None:
        """The picture of one instant; nodes that stand still cost nothing."""
        with self._server.atomic():
            for name, node in self._nodes.items():
                if name in placed.poses:
                    self._move(name, node, placed.poses[name][row])
            for name, handle in self._arrows.items():
                if name in placed.arrows:
                    self._point(name, handle, placed.arrows[name][row])
            if self._label is not None and self._label.text != text:
                self._label.text = text

    def _move(self, name: str, node: Any, pose: Array) -> None:
        before = self._shown.get(name)
        if np.isfinite(pose).all() and (before is None or not np.array_equal(before, pose)):
            self._shown[name] = pose.copy()
            node.position, node.wxyz = pose[:3], pose[3:]

    def _point(self, name: str, handle: Any, ends: Array) -> None:
        long_enough = bool(np.linalg.norm(ends[1] - ends[0]) > HEAD_LENGTH_M / 4)  # false for what is no number
        if handle.visible != long_enough:
            handle.visible = long_enough
        before = self._shown.get(name)
        if long_enough and (before is None or not np.array_equal(before, ends)):
            self._shown[name] = ends.copy()
            handle.points = ends[None]


def _above(camera: Camera) -> Array:
    """A point that is seen in the middle of the upper edge of the first picture."""
    distance = float(np.linalg.norm(camera.position - camera.look_at))
    return np.asarray(camera.look_at + LABEL_AT * distance * math.tan(0.5 * camera.fov_rad) * camera.axes[1])
