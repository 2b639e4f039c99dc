"""Of the operator as the loop of one arm sees them."""

from __future__ import annotations

from tests.mutate.equivalent.entries import Entries

_A_WAY_DOWN_SETS_IT = "a way down that is given sets it, and nothing asks for it before"
_THE_SHORT_WAY = "the short way: what follows finds nothing either"
_IF_NOTHING = "if not (happened or released or watched or self._stopped or self._signals.stopped):"
_MAPPED = "self._lower, self._lower_ns = (lower, 0 if lower is None else lower.start_utc_ns - utc_offset_ns())"
_ASKED = "asked = Event.STOP in happened and (not self._session)"
_HOLDS = "self._stopped, self._trouble, self._holds = (True, reason, self._holds + 1)"
_NO_SESSION = "if not self._session and mode is Mode.HOLD:"

OPERATOR: Entries = {
    "agent.process.operated": {
        ("Operator.__init__", "self._lower_ns = 0", "pass"): _A_WAY_DOWN_SETS_IT,
        ("Operator.__init__", "self._lower_ns = 0", "self._lower_ns = 1"): _A_WAY_DOWN_SETS_IT,
        ("Operator._said", _MAPPED, _MAPPED.replace("0 if", "1 if")): _A_WAY_DOWN_SETS_IT,
        ("Operator._said", "if requests.words:", "if True:"): "saves the taking of no words",
        ("Operator.events", _IF_NOTHING, "if False:"): _THE_SHORT_WAY,
        ("Operator.events", "return happened", "pass  (2)"): _THE_SHORT_WAY,
        (
            "Operator.events",
            _ASKED,
            "asked = Event.STOP in happened and True",
        ): "a session that goes on from a stop says one more by how many there have been, and is held for as many",
        ("Operator.hold", _HOLDS, _HOLDS.replace("+ 1", "+ 2")): "what counts is that the number grows",
        (
            "Operator.mode",
            _NO_SESSION,
            "if True and mode is Mode.HOLD:",
        ): "of a session only an arm that took nothing comes here, and its mode is APPROACH",
    },
}
