"""The page of a recorded run: time slider with what happened on it, play, the curves beside the picture.

A browser that is moved asks for more pictures than can be shown: the newest wish counts, others are passed over.
While its slider is dragged it says at most twenty times a second where that is: what lies half the way to the newest
place is shown before it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import viser

from agent.report.moments import Moment, around, marks
from agent.view.browser import Nodes
from agent.view.curves import curves_of
from agent.view.plots import Plot
from agent.view.staged import Staged, legend, status_text

EXAGGERATIONS: Final = {"as they were": 1.0, "10 times": 10.0, "100 times": 100.0}
SPEEDS: Final = {"1/4": 0.25, "1": 1.0, "4": 4.0, "16": 16.0}
PLAY_HZ: Final = 30.0
DRAG_S: Final = 0.2  # wishes that come sooner upon each other are of one drag
HALF_WAY_S: Final = 0.025  # half of the 50 ms in which a browser tells one place of a drag
CURVES_S: Final = 0.3  # the mark of now moves in the curves at most this often
WORDS_S: Final = 0.15  # and the text is told at most this often: a browser needs longer for it than for a picture
NOTHING: Final = "–"


class Player:
    """Controls and pictures of one run; `step` shows what is wanted, the browser only says what it wants."""

    def __init__(
        self, server: viser.ViserServer, nodes: Nodes, staged: Staged, moments: Sequence[Moment],
        now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self.pictures = 0  # shown so far
        self._nodes, self._staged, self._moments, self._now = nodes, staged, moments, now
        self._placed, self._t = staged.placed, staged.motion.t
        self._row = self._marked = -1
        self._wish = threading.Condition()
        self._wanted_s: float | None = float(self._t[0])
        self._then_s: float | None = None  # wished for, while what is half the way to it is shown
        self._wished_s, self._dragged = -np.inf, False
        self._started: tuple[float, float] | None = None  # playing: the wall's time and the run's at the last picture
        self._marked_s = self._told_s = self._now()
        self._told = -1
        self._build(server)

    def _build(self, server: viser.ViserServer) -> None:
        gui, first, last = server.gui, float(self._t[0]), float(self._t[-1])
        step = round(float(self._t[1] - self._t[0]), 6) if len(self._t) > 1 else 1.0
        end = max(last, first + step)
        self._slider = gui.add_slider("time [s]", first, end, step, first, marks=marks(self._moments, first, end))
        self._play = gui.add_button("Play")
        self._speed = gui.add_dropdown("speed", list(SPEEDS), initial_value="1")
        happened = {moment.line: moment.t for moment in self._moments}
        self._go_to = gui.add_dropdown("go to", [NOTHING, *happened], visible=bool(happened))
        self._go_to.on_update(
            lambda _: self.want(happened[self._go_to.value]) if self._go_to.value in happened else None
        )
        self._errors = gui.add_dropdown(
            "desired, beliefs", list(EXAGGERATIONS), initial_value="as they were",
            hint="how far these wires stand from the object: as they were, or so many times as far",
        )  # fmt: skip
        self._errors.on_update(lambda _: self._exaggerate(EXAGGERATIONS[self._errors.value]))
        self._words = gui.add_markdown("")
        self._plots = [Plot(server, curve) for curve in curves_of(self._staged.motion)]
        gui.add_markdown(legend(self._staged.scene))
        self._slider.on_update(lambda event: None if event.client is None else self.want(self._slider.value))
        self._play.on_click(lambda _: self._toggle())

    def want(self, t: float) -> None:
        """The picture of this time is wished for."""
        with self._wish:
            now = self._now()
            self._dragged, self._wished_s = now - self._wished_s < DRAG_S and self._started is None, now
            self._wanted_s, self._then_s = t, None
            self._started = None if self._started is None else (now, t)
            self._wish.notify()

    def step(self) -> None:
        """Wait for a wish, or for the next picture while it plays, and show it."""
        with self._wish:
            if self._wanted_s is None:
                self._wish.wait(1.0 / PLAY_HZ if self._then_s is None else HALF_WAY_S)
            t, started = self._next(), self._started
        if t is None and started is not None:
            now = self._now()
            t = min(started[1] + (now - started[0]) * SPEEDS[self._speed.value], float(self._t[-1]))
            with self._wish:
                if self._started is started:  # nobody paused or wished meanwhile
                    self._started = now, t
        if t is not None:
            self._show(self._staged.motion.row_at(t))
        if started is not None and self._row == len(self._t) - 1:
            self._stop()
        self._follow(self._now())

    def _next(self) -> float | None:
        """The time whose picture is wished for now, if any; half the way first, where a drag goes further than that."""
        t, self._wanted_s, then = self._wanted_s, None, self._then_s
        self._then_s = None
        if t is None:
            return then
        half = 0.5 * (t + float(self._t[self._row]))
        if (
            not self._dragged
            or self._row < 0
            or self._staged.motion.row_at(half) in (self._row, self._staged.motion.row_at(t))
        ):
            return t
        self._then_s = t
        return half

    def _follow(self, now: float) -> None:
        """Text and curves go after the picture, each at its own pace; the first text comes with the first picture."""
        row = self._row
        if row < 0:
            return  # it is about to be drawn anew
        t = float(self._t[row])
        if row != self._told and (self._told < 0 or now - self._told_s >= WORDS_S):
            self._told, self._told_s = row, now
            said = [status_text(self._staged.motion, row), *(f"- {moment.line}" for moment in around(self._moments, t))]
            self._words.content = "\n".join(said)
        if row != self._marked and now - self._marked_s >= CURVES_S:
            self._marked, self._marked_s = row, now
            for plot in self._plots:
                plot.mark(t)

    def _show(self, row: int) -> None:
        if row == self._row:
            return
        self._row, t = row, float(self._t[row])
        near = around(self._moments, t)
        self._nodes.show(self._placed, row, status_text(self._staged.motion, row, near))
        if self._started is not None:
            self._slider.value = t  # type: ignore[misc]
        self.pictures += 1

    def _toggle(self) -> None:
        with self._wish:
            if self._started is not None:
                self._stop()
                return
            self._then_s = None
            row = 0 if self._row == len(self._t) - 1 else max(self._row, 0)
            self._started = self._now(), float(self._t[row])
            self._play.label = "Pause"

    def _stop(self) -> None:
        self._started = None
        self._play.label = "Play"

    def _exaggerate(self, factor: float) -> None:
        placed = self._staged.scene.place(self._staged.motion, factor)
        with self._wish:
            self._placed, row = placed, max(self._row, 0)
            wishes = (self._wanted_s, self._then_s, float(self._t[row]))
            self._row, self._wanted_s = -1, next(t for t in wishes if t is not None)
            self._wish.notify()
