"""Layouts of viewers for a cell: Foxglove or Lichtblick (JSON), PlotJuggler (XML).

They name standard topics only, which a log and the live view have alike.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from typing import Any, Final

from agent.log.diagnostics import TOPIC as DIAGNOSTICS
from agent.log.scene import MAP, Scene, SceneArm
from agent.log.standard import LOG_TOPIC, POSE_DES_TOPIC, POSE_TOPIC

_AXES: Final = ("x", "y", "z")
_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # of Okabe and Ito


def foxglove(scene: Scene) -> str:
    """The arms and the object in 3D, and beside them pose, torques, wrenches, diagnostics and log."""
    panels: dict[str, Any] = {
        "3D!cell": _view(scene),
        "Plot!pose": _plot("object and desired pose, m", _pose_paths(".")),
        "Plot!wrenches": _plot("forces at the end effectors, N", _force_paths(scene)),
        "DiagnosticSummary!cell": {
            "minLevel": 0, "pinnedIds": [], "hardwareIdFilter": "", "topicToRender": DIAGNOSTICS, "sortByLevel": True,
        },
        "RosOut!cell": {"searchTerms": [], "minLogLevel": 1, "topicToRender": LOG_TOPIC},
    }  # fmt: skip
    for arm in scene.arms:
        panels[f"Plot!{arm.name}"] = _plot(f"torques of {arm.name}, N·m", list(_torque_paths(arm)))
    plots = [name for name in panels if name.startswith("Plot!")]
    left = _stack(["3D!cell", _stack(["DiagnosticSummary!cell", "RosOut!cell"], "row")], "column", 70)
    layout = {"direction": "row", "first": left, "second": _stack(plots, "column"), "splitPercentage": 55}
    whole = {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return json.dumps(whole | {"layout": layout}, indent=2) + "\n"


def plotjuggler(scene: Scene) -> str:
    """Tabs with the pose, and for each arm its joints, torques and forces."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    _tab(window, "object", [_pose_paths("/")])
    for arm in scene.arms:
        series = [
            [f"/{arm.name}/joint_states/{joint}/{kind}" for joint in arm.joints] for kind in ("position", "effort")
        ]
        _tab(window, arm.name, [*series, [f"/{arm.name}/wrench/wrench/force/{axis}" for axis in _AXES]])
    ET.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _view(scene: Scene) -> dict[str, Any]:
    layers: dict[str, Any] = {
        "grid": {
            "layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "frameLocked": True,
            "size": 2, "divisions": 20, "lineWidth": 1, "color": "#808080",
            "position": [0, 0, 0], "rotation": [0, 0, 0],
        }
    }  # fmt: skip
    for arm in scene.arms:
        layers[f"urdf-{arm.name}"] = {
            "layerId": "foxglove.Urdf", "instanceId": f"urdf-{arm.name}", "label": arm.name, "visible": True,
            "frameLocked": True, "sourceType": "topic", "topic": f"/{arm.name}/robot_description", "url": "",
            "filePath": "", "parameter": "", "framePrefix": f"{arm.name}/",
        }  # fmt: skip
    camera = {
        "distance": 1.5, "perspective": True, "phi": 65, "thetaOffset": 30, "fovy": 45, "near": 0.01, "far": 100,
        "target": [0, 0, 0], "targetOffset": [0.3, 0, 0.1], "targetOrientation": [0, 0, 0, 1],
    }  # fmt: skip
    poses = {topic: {"visible": True, "type": "axis", "axisScale": 0.1} for topic in (POSE_TOPIC, POSE_DES_TOPIC)}
    return {
        "followMode": "follow-none", "followTf": MAP, "layers": layers, "cameraState": camera, "topics": poses,
        "scene": {"transforms": {"axisScale": 0.05, "showLabel": False}}, "transforms": {}, "publish": {},
    }  # fmt: skip


def _plot(title: str, paths: Sequence[str]) -> dict[str, Any]:
    series = [
        {"value": path, "enabled": True, "timestampMethod": "headerStamp", "color": _COLOURS[i % len(_COLOURS)]}
        for i, path in enumerate(paths)
    ]
    return {
        "title": title, "paths": series, "showLegend": True, "legendDisplay": "floating", "isSynced": True,
        "xAxisVal": "timestamp", "showXAxisLabels": True, "showYAxisLabels": True,
    }  # fmt: skip


def _pose_paths(dot: str) -> list[str]:
    return [f"{topic}{dot}pose{dot}position{dot}{axis}" for axis in _AXES for topic in (POSE_TOPIC, POSE_DES_TOPIC)]


def _force_paths(scene: Scene) -> list[str]:
    return [f"/{arm.name}/wrench.wrench.force.{axis}" for arm in scene.arms for axis in _AXES]


def _torque_paths(arm: SceneArm) -> Iterator[str]:
    """By number, because a message has its joints by number; in their order of `joint_states`."""
    for i, name in enumerate(arm.movable):
        if name in arm.joints:
            yield f"/{arm.name}/joint_states.effort[{i}]"


def _stack(panels: Sequence[Any], direction: str, first: float | None = None) -> Any:
    """Panels beside or below each other, each as large as the others."""
    if len(panels) == 1:
        return panels[0]
    share = 100 / len(panels) if first is None else first
    rest = _stack(panels[1:], direction)
    return {"direction": direction, "first": panels[0], "second": rest, "splitPercentage": share}


def _tab(window: ET.Element, name: str, plots: Sequence[Sequence[str]]) -> None:
    tab = ET.SubElement(window, "Tab", tab_name=name, containers="1")
    share = ";".join([f"{1 / len(plots):g}"] * len(plots))
    splitter = ET.SubElement(
        ET.SubElement(tab, "Container"), "DockSplitter", orientation="-", count=str(len(plots)), sizes=share
    )
    for series in plots:
        area = ET.SubElement(splitter, "DockArea", name="...")
        plot = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        for i, curve in enumerate(series):
            ET.SubElement(plot, "curve", name=curve, color=_COLOURS[i % len(_COLOURS)])
