"""A run ready to be shown: its scene, where everything is at each instant, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.log.collect import Needs
from agent.log.when import STARTED_S
from agent.modes import Mode
from agent.report.moments import Moment
from agent.report.prepared import Prepared
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from agent.view.camera import Camera, camera_for
from agent.view.drawing import drawing_of_log
from agent.view.error import ViewError
from agent.view.motion import Motion, motion_of
from agent.view.scene import Placed, Scene

NEEDS: Final[Needs] = {  # of a log of another release
    AGENT_STATE.ros_name: frozenset({
        "sequence", "stamp_ns", "utc_ns", "mode", "flags", "joint_count", "t", "q", "p_object_des", "quat_object_des",
        "p_object", "quat_object", "e_eta", "wrench_cmd", "wrench_internal",
    }),
    PLANT_STATE.ros_name: frozenset({
        "sequence", "stamp_ns", "utc_ns", "t", "p_object", "quat_object", "grasp_wrench", "contact_error_m",
    }),
}  # fmt: skip
TEXT_MAX: Final = 40
_CAMERA_LOOKS: Final = 40  # instants that the camera must hold


@dataclass(frozen=True, slots=True)
class Staged:
    """A scene and where everything in it is."""

    scene: Scene
    motion: Motion
    placed: Placed

    def camera(self, size: tuple[int, int]) -> Camera:
        """One that holds everything at all instants, for a picture of so many pixels."""
        rows = np.unique(np.linspace(0, len(self.motion.t) - 1, _CAMERA_LOOKS).astype(int))
        points = np.vstack([self.scene.points(self.placed, row) for row in rows.tolist()])
        return camera_for(self.scene, points, size[0] / size[1])


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


def status_text(motion: Motion, row: int, moments: Sequence[Moment] = ()) -> str:
    """What is said of an instant: its time, the modes, and what of weight happened just before."""
    weighty = [moment for moment in moments if moment.weighty]
    told = "".join(f" · {moment.source}: {shortened(moment.text)}" for moment in weighty[:2])
    instant = f"t = {motion.t[row]:.1f} s" if motion.t[row] > STARTED_S else "not started"
    return f"{instant} · {modes_at(motion, row)}{told}"


def shortened(text: str) -> str:
    """At most so many characters that two stand beside each other."""
    return text if len(text) <= TEXT_MAX else f"{text[: TEXT_MAX - 1]}…"


def legend(scene: Scene) -> str:
    """What the wires and arrows are, and how long the arrows (Markdown)."""
    scales = {arrow.name.partition("/")[0]: arrow.metres for arrow in scene.arrows}
    lengths = {kind: f"{100.0 * scale:.2g} cm for 1 N" for kind, scale in scales.items() if scale}
    said = [
        "Black edges: the desired pose. Edges in an arm's colour: where that arm believes the object to be.",
        *([f"Arrows in an arm's colour: its commanded force, {lengths['wrench']}."] if "wrench" in lengths else []),
        *([f"Purple arrows: internal force, {lengths['internal']}."] if "internal" in lengths else []),
    ]
    return "  \n".join(said)


def stage(run: Prepared, pictures_hz: float, begin_s: float = 0.0, end_s: float = np.inf) -> Staged:
    """A run, or a part of it, staged.

    Raises ViewError for a log without a row there, or that does not say how the cell looks.
    """
    if not run.rows:
        raise ViewError(
            f"{run.log.path} cannot be shown", found="no row of any arm in the time of the run", expected="some",
            remedy="see the log's report",
        )  # fmt: skip
    last = max(float(rows["t"][-1]) for rows in run.rows.values())
    if not (begin_s < end_s and begin_s <= last):
        raise ViewError(
            "part of the run", found=f"{begin_s:g} to {min(end_s, last):g} s", expected=f"some of 0 to {last:g} s",
            remedy="correct --from and --to",
        )  # fmt: skip
    motion = motion_of(run, pictures_hz, begin_s, end_s)
    scene = Scene.of(drawing_of_log(run.log), motion)
    return Staged(scene, motion, scene.place(motion))
