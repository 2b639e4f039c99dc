"""Changes that change nothing a test could see, each with the reason; whoever adds one has tried to write the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tests.mutate.mutants import Mutant

Key = tuple[str, str, str]  # where, first line of the statement before and after

EQUIVALENT: Mapping[str, Mapping[Key, str]] = {
    "agent.runner": {
        ("Runner._cycle", "happened |= Event.STOP", "happened |= Event.TROUBLE"): "either makes the object held",
        ("Runner._cycle", "if happened:", "if True:"): "saves a call: nothing changes without an event (test_runner)",
        (
            "Runner._started",
            "if zero_ns is not None and zero_ns != self._zero_ns:",
            "if zero_ns is not None and True:",
        ): "the same start gives the same phase",
        (
            "Runner._change_mode",
            "if mode is Mode.HOLD and state is not None and (self._outcome is not None):",
            "if True and state is not None and (self._outcome is not None):",
        ): "every other change ends the loop, or begins to track and forgets what was held",
    },
    "agent.operator.socket": {
        ("ControlSocket.poll", "if self._clients:", "if True:"): "saves the making of an empty list",
        (
            "ControlSocket._answer",
            "start_utc_ns = int(request['start_utc_ns']) if verb is Verb.START else 0",
            "start_utc_ns = int(request['start_utc_ns']) if verb is Verb.START else 1",
        ): "only a start's instant is read",
        ("ControlSocket._answer", "if verb is Verb.RELEASE:", "if True:"): "there are three verbs",
        ("", "REPLY_TIMEOUT_S = 2.0", "REPLY_TIMEOUT_S = 4.0"): "how long a person waits for an agent that hangs",
    },
}


def why_equivalent(mutant: Mutant) -> str:
    """The reason, or nothing."""
    return EQUIVALENT.get(mutant.module, {}).get(mutant.key, "")


def unused_entries(module: str, mutants: Sequence[Mutant]) -> list[str]:
    """Entries that are no change to the module any more."""
    keys = {mutant.key for mutant in mutants}
    return [f"equivalent.py names no change: {key}" for key in EQUIVALENT.get(module, {}) if key not in keys]
