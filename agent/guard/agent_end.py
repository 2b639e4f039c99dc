"""The agent's end of the line to its guard: it connects, says words, and learns of what is answered without waiting."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agent.guard.line import MAX_BYTES, GuardError, Word, close_all, received
from agent.host.unix_socket import said_of

REPLY_S = 2.0
LEAST_S = 1e-3  # of one wait, for 0 would be none


class AgentEnd:
    """The agent's end."""

    def __init__(self, path: Path, fingerprint: str, patience_s: float = REPLY_S) -> None:
        """Connect; patience_s: 0 never blocks.  Raises GuardError when nobody listens."""
        self._path = path
        self._fingerprint = fingerprint
        self._put_by = deque[Mapping[str, Any]]()  # answers to what was said before, which came first
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
        self._socket.settimeout(patience_s)
        try:
            self._socket.connect(str(path))
            self._socket.setblocking(False)
        except BlockingIOError as error:
            self._socket.close()
            raise self._busy("others who wait for its answer") from error
        except OSError as error:
            self._socket.close()
            raise GuardError(
                f"guard at {path}", found=said_of(error), expected="the guard of this arm",
                remedy="start it first (`coop guard`)",
            ) from error  # fmt: skip

    def ask(self, word: Word, fds: Sequence[int] = (), **content: Any) -> tuple[int, ...]:
        """Say a word and wait for its answer; the descriptors that came with it.  Raises GuardError.

        An answer to what was said before is for `heard`.
        """
        with contextlib.suppress(GuardError):  # who is refused at the door is told so, and then cannot say it
            self.say(word, fds, **content)
        deadline_s = time.monotonic() + REPLY_S
        try:
            while True:
                self._socket.settimeout(max(LEAST_S, deadline_s - time.monotonic()))
                data, got = received(self._socket)
                answer: dict[str, Any] = json.loads(data)
                if answer.get("to", word) == word:
                    break
                close_all(got)
                self._put_by.append(answer)
        except TimeoutError as error:
            raise self._busy(f"no answer to {word.value!r} within {REPLY_S:g} s") from error
        except (OSError, ValueError) as error:
            raise self._gone(word) from error
        finally:
            self._socket.setblocking(False)
        if not answer.get("ok"):
            close_all(got)
            why = {name: answer[name] for name in ("found", "expected", "remedy")}
            whose = answer.get("what") if word is Word.PORT else None  # the port's own refusal, which names it
            raise GuardError(whose or f"the guard at {self._path} refuses {word.value!r}", **why)
        return got

    def say(self, word: Word, fds: Sequence[int] = (), **content: Any) -> None:
        """Say a word and go on; its answer is for `heard`.  Raises GuardError when it cannot be said."""
        message = json.dumps({"word": word.value, "fingerprint": self._fingerprint, **content}).encode()
        try:
            socket.send_fds(self._socket, [message], list(fds))
        except OSError as error:
            raise self._gone(word) from error

    def heard(self) -> Mapping[str, Any] | None:
        """An answer that has come, {} when none has; None when the guard is gone.  Never blocks.

        `to` is the word that it is to; none: to whatever was said last.
        """
        if self._put_by:
            return self._put_by.popleft()
        try:
            data = self._socket.recv(MAX_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return {}
        except OSError:
            return None
        if not data:
            return None
        try:
            answer = json.loads(data)
        except ValueError:
            return None
        return answer if isinstance(answer, dict) else None

    def close(self) -> None:
        """Hang up.  Safe twice."""
        self._socket.close()

    def _busy(self, found: str) -> GuardError:
        return GuardError(
            f"guard at {self._path}", found=found, expected="a guard that waits for its agent",
            remedy="if it holds the arm in an agent's place (`coop status`), support the object and `coop release`; "
            "else its log says why it hangs",
        )  # fmt: skip

    def _gone(self, word: Word) -> GuardError:
        return GuardError(
            f"guard at {self._path}", found=f"that it went before it answered {word.value!r}", expected="an answer",
            remedy="its log says why; start it again, and then this arm",
        )  # fmt: skip
