"""What operator and agent say to each other: one JSON document each way, of at most MAX_BYTES."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from agent.modes import Mode
from agent.operator.table import Verb

MAX_BYTES = 4096
REASON_MAX = 400  # characters of a reason: a driver's is some 300 with its remedy
UTC_MAX_NS = (1 << 63) - 1
_REFUSAL = ("found", "expected", "remedy")


@dataclass(frozen=True)
class Request:
    """What an operator asks an agent."""

    verb: Verb
    fingerprint: str = ""  # of the cell that the operator means; of stop and release nobody asks for it
    start_utc_ns: int = 0  # start, lower
    prepare: bool = False  # only say whether it would be accepted; of a cancel: only forget that it was asked
    clock_bound_s: float | None = None  # start: by how much this host's clock may be off; None: not known
    token: str = ""  # of what has an instant: the same when it is prepared, given and taken back, and of nobody else
    asked_ns: int = 0  # of what has an instant: when the first arm was asked, on CLOCK_MONOTONIC

    def encode(self) -> bytes:
        """As it is sent."""
        content: dict[str, Any] = {"verb": self.verb.value, "prepare": self.prepare}
        if self.token:
            content |= {"token": self.token, "asked_ns": self.asked_ns}
        if self.fingerprint:
            content["fingerprint"] = self.fingerprint
        if self.verb is Verb.START:
            content |= {"start_utc_ns": self.start_utc_ns, "clock_bound_s": self.clock_bound_s}
        elif self.start_utc_ns:
            content["start_utc_ns"] = self.start_utc_ns
        return json.dumps(content).encode()

    @classmethod
    def decode(cls, data: bytes) -> Request:
        """A request of anybody.  Raises ValueError when it is none."""
        try:
            content = json.loads(data)
            verb = Verb(content["verb"])
            prepare, token = content.get("prepare", False) is True, str(content.get("token", ""))
            asked_ns = int(content.get("asked_ns", 0))
            utc_ns = int(content["start_utc_ns"] if verb is Verb.START else content.get("start_utc_ns", 0))
            if not 0 <= utc_ns <= UTC_MAX_NS:
                raise ValueError(f"not a request: {utc_ns} ns")
            fingerprint = str(content.get("fingerprint", ""))
            if verb is not Verb.START:
                return cls(verb, fingerprint, utc_ns, prepare=prepare, token=token, asked_ns=asked_ns)
            bound_s = content.get("clock_bound_s")
            return cls(
                verb, fingerprint, utc_ns,
                prepare=prepare, clock_bound_s=None if bound_s is None else float(bound_s), token=token,
                asked_ns=asked_ns,
            )  # fmt: skip
        except (KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(f"not a request: {error!r}") from error


@dataclass(frozen=True)
class Reply:
    """What an agent answers: who it is and how it is, and of a refused word found, expected and remedy."""

    ok: bool
    arm: str
    mode: str  # name of an agent.modes.Mode
    reason: str = ""  # of a hold or a fault
    fingerprint: str = ""
    refusal: Mapping[str, str] = field(default_factory=dict)  # found, expected, remedy
    details: Mapping[str, Any] = field(default_factory=dict)  # pid, start, timing, real time, clock ...

    def encode(self) -> bytes:
        """As it is sent."""
        content = {
            "ok": self.ok, "arm": self.arm, "mode": self.mode, "reason": self._reason(),
            "fingerprint": self.fingerprint, **self.refusal, "details": dict(self.details),
        }  # fmt: skip
        return json.dumps(content).encode()

    def _reason(self) -> str:
        return self.reason if len(self.reason) <= REASON_MAX else f"{self.reason[: REASON_MAX - 1]}…"

    @classmethod
    def decode(cls, data: bytes) -> Reply:
        """A reply of anybody.  Raises ValueError when it is none."""
        try:
            content = json.loads(data)
            texts = {name: str(content[name]) for name in ("arm", "mode", "reason", "fingerprint")}
            Mode[texts["mode"]]
            refusal = {} if content["ok"] is True else {name: str(content[name]) for name in _REFUSAL}
            return cls(content["ok"] is True, refusal=refusal, details=dict(content["details"]), **texts)
        except (KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"not a reply: {error!r}") from error
