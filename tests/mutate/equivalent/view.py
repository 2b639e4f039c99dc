"""Of the pages that show a run."""

from __future__ import annotations

from tests.mutate.equivalent.entries import Entries

_NO_ROW = "self._row = self._marked = -1"
_STEP = "step = round(float(self._t[1] - self._t[0]), 6) if len(self._t) > 1 else 1.0"
_ANEW = "self._row, self._wanted_s = (-1, next((t for t in wishes if t is not None)))"
_PLAYING = "if t is None and started is not None:"
_AT_END = "if started is not None and self._row == len(self._t) - 1:"
_TELLS = "if row != self._told and (self._told < 0 or now - self._told_s >= slower * WORDS_S):"
_MIDDLE = "middle = look_at + 0.5 * (y.max() + y.min()) * Camera(look_at + back, look_at, up).axes[1]"
_ALONE = "if np.linalg.norm(along) < 1e-06:"
_ACROSS = "along = np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0])"
_SIZED = "sized = np.where(np.isfinite(values), np.abs(values), -1.0)"
_CONJUGATE = "turn = product(pose[:, 3:], against[:, 3:] * [1.0, -1.0, -1.0, -1.0])"
_SHORTER = "turn = np.where(turn[:, :1] < 0.0, -turn, turn)"
_AXIS = "axis = np.divide(turn[:, 1:], sine, out=np.zeros_like(turn[:, 1:]), where=sine > _STILL)"

_WITHIN = "which = (self.t >= begin_s - 1e-09) & (self.t < end_s - 1e-09)"

VIEW: Entries = {
    "agent.view.motion": {
        ("Motion.within", _WITHIN, _WITHIN.replace(">=", ">")): "no instant is exactly a nanosecond before",
        ("Motion.within", _WITHIN, _WITHIN.replace("<", "<=")): "no instant is exactly a nanosecond before",
    },
    "agent.view.camera": {
        ("camera_for", _MIDDLE, _MIDDLE.replace("+ back", "- back")): "seen from behind up is up",
        ("_front", _ALONE, _ALONE.replace("<", "<=")): "no two arms are exactly so near",
        ("_front", _ALONE, _ALONE.replace("1e", "2e")): "no two arms are so near",
        ("_front", _ACROSS, _ACROSS.replace("<", "<=")): "either axis does for a slanting up",
        ("_front", _ACROSS, _ACROSS.replace("0.0, 1.0]", "0.0, 2.0]")): "its length does not matter",
        ("_front", _ACROSS, _ACROSS.replace("[1.0", "[2.0")): "its length does not matter",
        ("_front", _ACROSS, _ACROSS.replace("[1.0, 0.0, 0.0", "[1.0, 0.0, 1.0")): "up is along z there",
    },
    "agent.view.curves": {
        ("thinned", _SIZED, _SIZED.replace("-1.0", "-2.0")): "any size below zero is below all others",
    },
    "agent.view.player": {
        ("Player.__init__", _NO_ROW, _NO_ROW.replace("-1", "1")): "the first picture is that of row 0",
        ("Player.__init__", _NO_ROW, _NO_ROW.replace("-1", "-2")): "any number below zero is no row",
        (
            "Player.__init__",
            "self._wished_s, self._dragged = (-np.inf, False)",
            "self._wished_s, self._dragged = (-np.inf, True)",
        ): "nothing is on its way before the first wish, and each wish says whether it is of a drag",
        ("Player.__init__", "self._told = -1", "self._told = -2"): "any number below zero is no row",
        ("Player._build", _STEP, _STEP.replace("6)", "7)")): "the step of a slider has few decimals",
        ("Player._build", _STEP, _STEP.replace("6)", "5)")): "the step of a slider has few decimals",
        ("Player.step", _PLAYING, _PLAYING.replace("t is None", "True")): "a wish sets the start of playing, too",
        ("Player.step", _AT_END, _AT_END.replace("started is not None", "True")): "what does not play stops as well",
        ("Player._exaggerate", _ANEW, _ANEW.replace("-1", "-2")): "any number below zero is no row",
        ("Player._follow", _TELLS, _TELLS.replace("row != self._told", "True")): "the same text is told again",
    },
    "agent.view.pose": {
        ("", "_STILL: Final = 1e-12", "_STILL: Final = 2e-12"): "no half angle of a log is between the two",
        ("exaggerated", _CONJUGATE, _CONJUGATE.replace(" * ", " / ")): "1 and −1 are their own inverses",
        ("exaggerated", _SHORTER, _SHORTER.replace("<", "<=")): "half a turn is the same in both senses",
        ("exaggerated", _AXIS, _AXIS.replace(">", ">=")): "no half angle is exactly so small",
    },
}
