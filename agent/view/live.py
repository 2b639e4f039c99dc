"""`coop view CELL --live`: the same picture during a run, from what the cell publishes anyway.

It subscribes and does nothing else: it declares no key, answers nothing, and whoever publishes does not know of it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import viser
from numpy.typing import NDArray

from agent.config.files import CellFiles
from agent.telemetry.link.session import Network, open_session
from agent.telemetry.row import topics
from agent.telemetry.row.event import Event
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, PLANT_STATE
from agent.telemetry.row.topics import PLANT, Address, Kind
from agent.view.browser import PAGE_PX, Nodes
from agent.view.camera import camera_for
from agent.view.curves import curves_of
from agent.view.drawing import CellDrawing, drawing_of_cell
from agent.view.motion import Motion, joined, motion_now
from agent.view.plots import Plot
from agent.view.scene import Scene
from agent.view.server import Server
from agent.view.staged import legend, status_text

PICTURES_HZ: Final = 30.0
FORCE_N: Final = 6.0  # an arrow of this force has full length
CURVES_S: Final = 20.0  # how far back the curves go
CURVES_HZ: Final = 10.0  # instants of the curves; they are sent twice a second
CURVES_SENT_S: Final = 0.5
EVENTS_SHOWN: Final = 6
OTHER_CELL: Final = "Rows are of another cell file, or of one with other values (`--set`, `--duration`)."
SILENT_S: Final = 1.0  # without a row, after which an arm is shown as one that has none
_SAME_CLOCK_S: Final = 2.0  # rows whose UTC is further from now are not of the wall's time
_PAYLOAD_BYTES_MAX: Final = 1 << 18


@dataclass(frozen=True, slots=True)
class LiveReport:
    """How the pictures came; lags in s from sampling to showing, of rows that carry the wall's time."""

    pictures: int
    lags_s: tuple[float, ...]
    refused: int  # messages that were no rows of this cell's arms

    @property
    def behind(self) -> str:
        """The lags in words; empty where the rows do not carry the wall's time, as in lockstep."""
        if not self.lags_s or min(self.lags_s) < -_SAME_CLOCK_S or max(self.lags_s) > _SAME_CLOCK_S:
            return ""
        half, most = np.percentile(1e3 * np.array(self.lags_s), [50.0, 99.0])
        return f", {half:.0f} ms behind (99 %: {most:.0f} ms)"


class Intake:
    """The newest row of each member and the last events; `put` runs in a thread of the network's."""

    def __init__(self, cell: CellFiles) -> None:
        self.refused = 0
        self._other = set[str]()  # members whose last row is of another cell file than this one
        self.events: deque[Event] = deque(maxlen=EVENTS_SHOWN)
        self.news = threading.Event()
        self._config_id = cell.config_id
        self._joints = {arm.name: len(arm.entry.controlled) for arm in cell.arms}
        members = [*self._joints, PLANT]
        self._rows = {Address(cell.file.name, member, Kind.STATE).key: member for member in members}
        self._texts = {Address(cell.file.name, member, Kind.EVENT).key for member in members}
        self._latest: dict[str, NDArray[np.void]] = {}
        self._came_s: dict[str, float] = {}

    @property
    def other_cell(self) -> bool:
        """Whether rows of another cell file than this one come."""
        return bool(self._other)

    def put(self, key: str, payload: bytes) -> None:
        """Take a message; what is no row and no event of this cell is counted."""
        if key in self._rows:
            self._put_rows(self._rows[key], payload)
        elif key in self._texts and payload:
            try:
                event = Event.from_json(payload)
            except ValueError:
                self.refused += 1
                return
            if event not in self.events:  # one that may have been lost is sent again
                self.events.append(event)

    def _put_rows(self, member: str, payload: bytes) -> None:
        dtype = PLANT_STATE.dtype if member == PLANT else AGENT_STATE.dtype
        if not payload:
            return  # the mark of an end
        if len(payload) % dtype.itemsize or len(payload) > _PAYLOAD_BYTES_MAX:
            self.refused += 1
            return
        last = np.frombuffer(payload[-dtype.itemsize :], dtype)
        fits = last["encapsulation"][0] == CDR_LITTLE_ENDIAN
        if not fits or (member != PLANT and int(last["joint_count"][0]) != self._joints[member]):
            self.refused += 1
            return
        if self._is_old(member, last):
            return
        if int(last["config_id"][0]) == self._config_id:
            self._other.discard(member)
        else:
            self._other.add(member)
        self._latest[member], self._came_s[member] = last, time.monotonic()
        self.news.set()

    def _is_old(self, member: str, row: NDArray[np.void]) -> bool:
        """A row that a recorder had missed comes behind newer ones; after a silence any row is one of another run."""
        before = self._latest.get(member)
        late = before is not None and row["utc_ns"][0] < before["utc_ns"][0]
        return bool(late) and time.monotonic() - self._came_s[member] < SILENT_S

    def silent(self) -> frozenset[str]:
        """Members of which a row came once, and none for a while."""
        now_s = time.monotonic()
        return frozenset(member for member, came_s in self._came_s.copy().items() if now_s - came_s > SILENT_S)

    def latest(self) -> Mapping[str, NDArray[np.void]]:
        """The newest row (1,) of each member that has told one."""
        self.news.clear()
        return dict(self._latest)


class LivePage:
    """What is seen of a cell that runs."""

    def __init__(self, server: viser.ViserServer, drawing: CellDrawing, start: Motion) -> None:
        self.scene = Scene(drawing, force_N=FORCE_N, internal_N=FORCE_N)
        points = self.scene.points(self.scene.place(start), 0)
        self._nodes = Nodes(server, self.scene, camera_for(self.scene, points, PAGE_PX[0] / PAGE_PX[1]))
        self._words = server.gui.add_markdown("Waiting for the first row of an arm.")
        self._server, self._plots = server, list[Plot]()
        server.gui.add_markdown(legend(self.scene))
        self._past: deque[Motion] = deque(maxlen=round(CURVES_S * CURVES_HZ))
        self._kept_s = self._sent_s = 0.0

    def show(self, motion: Motion, events: list[Event], note: str, now_s: float) -> None:
        """The picture of now."""
        text = status_text(motion, 0)
        self._nodes.show(self.scene.place(motion), 0, text)
        if now_s - self._kept_s >= 1.0 / CURVES_HZ:
            self._kept_s = now_s
            if self._past and (motion.t[0] < self._past[-1].t[0] or motion.arms.keys() != self._past[-1].arms.keys()):
                self._past.clear()  # another run, or one more arm
            self._past.append(motion)
        if now_s - self._sent_s >= CURVES_SENT_S and len(self._past) > 1:
            self._sent_s = now_s
            self._send_curves()
            told = "\n".join(f"- {event.source}: {event.text}" for event in reversed(events))
            self._words.content = "\n\n".join(filter(None, (f"**{text}**", note, told)))

    def _send_curves(self) -> None:
        curves = curves_of(joined(list(self._past)))
        if [len(c.lines) for c in curves] != [plot.lines for plot in self._plots]:
            for plot in self._plots:
                plot.remove()
            self._plots = [Plot(self._server, curve) for curve in curves]
        for plot, curve in zip(self._plots, curves, strict=True):
            plot.replace(curve)


def serve(
    cell: CellFiles, network: Network, port: int, stop: Callable[[], bool], ready: Callable[[str], None]
) -> LiveReport:
    """Serve the live page until a stop; `ready` is told its address.  Raises Refusal."""
    intake, drawing = Intake(cell), drawing_of_cell(cell)
    lags: deque[float] = deque(maxlen=100_000)
    pictures, silent = 0, frozenset[str]()
    with open_session(network) as opened:
        subscriber = opened.session.declare_subscriber(
            topics.cell_keys(cell.file.name),
            lambda sample: intake.put(str(sample.key_expr), sample.payload.to_bytes()),
        )
        server = Server(port, f"{cell.file.name}, live")
        try:
            page = LivePage(server, drawing, _start(cell))
            ready(server.address)
            while not stop():
                began_s = time.monotonic()
                came, now_silent = intake.news.wait(0.1), intake.silent()
                if came or now_silent != silent:
                    rows, silent = intake.latest(), now_silent
                    seen = {arm.name: rows[arm.name] for arm in drawing.arms if arm.name in rows}
                    motion = motion_now(seen, rows.get(PLANT), silent)
                    if motion is not None:
                        note = OTHER_CELL if intake.other_cell else ""
                        page.show(motion, list(intake.events), note, began_s)
                        pictures += 1
                        if came:
                            lags.append(1e-9 * (time.time_ns() - max(int(r["utc_ns"][0]) for r in rows.values())))
                time.sleep(max(0.0, 1.0 / PICTURES_HZ - (time.monotonic() - began_s)))
        finally:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
            server.stop()
    return LiveReport(pictures, tuple(lags), intake.refused)


def _start(cell: CellFiles) -> Motion:
    """Before the first row: the object at its start, the arms near theirs."""
    rows = {}
    for arm in cell.arms:
        row = np.zeros(1, AGENT_STATE.dtype)
        row["joint_count"] = len(arm.entry.controlled)
        row["q"][0, : len(arm.entry.q_near_rad)] = arm.entry.q_near_rad
        for name in ("p_object", "p_object_des"):
            row[name] = cell.file.p_place_m
        for name in ("quat_object", "quat_object_des"):
            row[name] = cell.file.object.quat_start
        rows[arm.name] = row
    motion = motion_now(rows, None)
    assert motion is not None  # a cell has arms
    return motion
