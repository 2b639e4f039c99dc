"""The layouts of viewers name what a real log has: topics, fields, joints, frames."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import configs
from agent.config.files import load_files
from agent.host.shipped import Shipped, folder
from agent.log.layouts import foxglove, plotjuggler
from agent.process.scene import scene_of
from tests.support.command import coop
from tests.support.coop import PAPER

Messages = dict[str, Any]


@pytest.fixture(scope="module")
def messages(paper_runs: tuple[Path, Path]) -> Messages:
    """The last message of every topic of a run of the paper's cell."""
    with AnyReader([paper_runs[0] / "run.mcap"]) as reader:
        return {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}


def shipped(name: str) -> str:
    return (folder(Shipped.LAYOUTS) / name).read_text(encoding="utf-8")


def values_of(layout: Any, *keys: str) -> Iterator[str]:
    """Texts under these keys, wherever they are."""
    if isinstance(layout, dict):
        for key, value in layout.items():
            if key in keys and isinstance(value, str):
                yield value
            yield from values_of(value, *keys)
    elif isinstance(layout, list):
        for each in layout:
            yield from values_of(each, *keys)


def number(message: Any, path: str) -> float:
    """What a path of Foxglove's means: fields by dots, elements by numbers."""
    for name, index in re.findall(r"\.(\w+)(?:\[(\d+)\])?", path):
        message = getattr(message, name)
        message = message[int(index)] if index else message
    return float(message)


def test_foxglove_plots_numbers_that_are_there_and_known(messages: Messages) -> None:
    paths = [value for value in values_of(json.loads(shipped("foxglove.json")), "value") if value.startswith("/")]
    assert len(paths) > 15
    for path in paths:
        topic = re.match(r"[^.]+", path)[0]  # type: ignore[index]
        assert np.isfinite(number(messages[topic], path.removeprefix(topic))), path


def test_foxglove_shows_topics_frames_and_robots_that_are_there(messages: Messages) -> None:
    layout = json.loads(shipped("foxglove.json"))
    view = layout["configById"]["3D!cell"]
    named = {*values_of(layout, "topicToRender", "topic"), *view["topics"]}
    assert named <= set(messages)
    assert {"/left/robot_description", "/right/robot_description", "/object/pose", "/diagnostics"} <= named
    frames = {t.header.frame_id for t in messages["/tf_static"].transforms}
    assert view["followTf"] in frames
    children = {t.child_frame_id for t in messages["/tf_static"].transforms}
    for layer in view["layers"].values():
        if layer["layerId"] == "foxglove.Urdf":
            assert layer["framePrefix"] + "base_link" in children


def test_every_panel_of_foxglove_is_placed_once(messages: Messages) -> None:
    layout = json.loads(shipped("foxglove.json"))
    placed = list(values_of(layout["layout"], "first", "second"))
    assert sorted(placed) == sorted(layout["configById"])


def test_plotjuggler_has_curves_of_numbers_that_are_there(messages: Messages) -> None:
    curves = [str(curve.get("name")) for curve in ET.fromstring(shipped("plotjuggler.xml")).iter("curve")]
    assert len(curves) > 15
    for curve in curves:
        topic = next(topic for topic in sorted(messages, key=len, reverse=True) if curve.startswith(f"{topic}/"))
        fields = curve.removeprefix(f"{topic}/").split("/")
        message = messages[topic]
        if topic.endswith("/joint_states"):  # PlotJuggler has joints by name
            joint, quantity = fields
            found = getattr(message, quantity)[message.name.index(joint)]
        else:
            found = number(message, "".join(f".{field}" for field in fields))
        assert np.isfinite(found), curve


def test_what_ships_is_what_the_command_prints() -> None:
    scene = scene_of(load_files(PAPER))
    assert shipped("foxglove.json") == foxglove(scene) == coop("layout", PAPER).out
    assert shipped("plotjuggler.xml") == plotjuggler(scene) == coop("layout", PAPER, "--viewer", "plotjuggler").out


@pytest.mark.parametrize("cell", sorted(configs.CELLS_DIR.glob("*.toml")), ids=lambda path: path.stem)
def test_every_cell_has_layouts_with_all_of_its_arms(cell: Path) -> None:
    scene = scene_of(load_files(cell))
    layers = json.loads(foxglove(scene))["configById"]["3D!cell"]["layers"]
    assert {name.removeprefix("urdf-") for name in layers} - {"grid"} == {arm.name for arm in scene.arms}
    tabs = [tab.get("tab_name") for tab in ET.fromstring(plotjuggler(scene)).iter("Tab")]
    assert tabs == ["object", *(arm.name for arm in scene.arms)]
