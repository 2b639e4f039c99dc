"""The runs of a study on a Dask cluster; dask.distributed is loaded when it is asked for.

A run travels as bytes that become a call on the worker: one without this package says so, where a task that its
message cannot be read without it would end the worker, and the study would wait for ever.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import pickle
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Final

from agent.study.measure import RunResult
from agent.study.plan import Task
from agent.study.store import StudyError
from agent.study.work import ATTEMPTS, Done, able, perform, result_of

CONNECT_S: Final = 10.0
LOOK_EVERY_S: Final = 0.05  # for runs that are done
WORKERS_EVERY_S: Final = 5.0  # for workers, while none is

_GARBLED: Final = (MemoryError, struct.error)  # an answer of another protocol, its first bytes read as a length
_UNABLE: Final = (ImportError, AttributeError, SyntaxError, OSError)  # what is raised where our modules do not load


class _Call:
    """A run as bytes, which do it where they are read."""

    def __init__(self, task: Task) -> None:
        self._task = task

    def __reduce__(self) -> tuple[Any, ...]:
        return perform, (self._task,)


def on_cluster(tasks: Sequence[Task], address: str, tell: Callable[[str], None] = lambda _: None) -> Iterator[Done]:
    """On the cluster whose scheduler is at `address`, as they are done.  Raises StudyError.

    tell: that nobody is there to do them, or nobody any more, until somebody comes.
    """
    distributed = _distributed()
    _require_answer(distributed, address)
    with _told_by_refusals():
        client = _client(distributed, address)
        try:
            yield from _done(distributed, client, tasks, address, tell)
        finally:
            with contextlib.suppress(OSError):  # of a scheduler that has gone
                client.close()


def _done(
    distributed: Any, client: Any, tasks: Sequence[Task], address: str, tell: Callable[[str], None]
) -> Iterator[Done]:
    watch = _Watch(client, address, tell)
    watch.look("yet")
    with _answering(distributed, address):
        futures = {client.submit(pickle.loads, pickle.dumps(_Call(task)), pure=False, retries=ATTEMPTS - 1): task
                   for task in tasks}  # fmt: skip
        coming = distributed.as_completed(futures, loop=client.loop)
    while futures:
        for future in coming.next_batch(block=False):
            task = futures.pop(future)
            yield task, _result(distributed, client, future, task, address)
            watch.seen()
        watch.wait()


class _Watch:
    """Tells of a scheduler without workers, once each time that the last one has gone."""

    def __init__(self, client: Any, address: str, tell: Callable[[str], None]) -> None:
        self._client, self._address, self._tell = client, address, tell
        self._manned = True
        self.seen()

    def seen(self) -> None:
        """Somebody has done a run just now."""
        self._due_s = time.monotonic() + WORKERS_EVERY_S

    def wait(self) -> None:
        """For a moment in which runs may be done."""
        time.sleep(LOOK_EVERY_S)
        if time.monotonic() >= self._due_s:
            self.look("any more")
            self.seen()

    def look(self, when: str) -> None:
        """Tell where there are no workers: yet, or any more."""
        with contextlib.suppress(OSError):  # of a scheduler that has gone: its runs say so
            manned = bool(self._client.scheduler_info()["workers"])
            if self._manned and not manned:
                address = self._address
                self._tell(f"scheduler {address} has no workers {when}: start some with `dask worker {address}`")
            self._manned = manned


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise StudyError(
            "scheduler",
            found="no dask.distributed on this host",
            expected="the package",
            remedy="pip install 'widowx-coop[study]'",
        ) from error


@contextmanager
def _told_by_refusals() -> Iterator[None]:
    """Keep distributed's client, which logs a traceback where its scheduler goes away, from saying it as well."""
    client = logging.getLogger("distributed.client")
    before = client.level
    client.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        client.setLevel(before)


def _require_answer(distributed: Any, address: str) -> None:
    """Greet who listens at `address`, within CONNECT_S.  Raises StudyError.

    A `Client` waits without end for the greeting of one that listens and says nothing, and one that failed is told of
    again, as of a defect, when it is collected.
    """
    try:
        asyncio.run(asyncio.wait_for(_greet(distributed, address), CONNECT_S))
    except (OSError, ValueError, TypeError) as error:  # TypeError: no certificates, or a transport without its package
        raise _no_answer(address, error) from error
    except _GARBLED as error:
        raise _no_scheduler(address, "an answer that is no Dask scheduler's, as of SSH or HTTP") from error


async def _greet(distributed: Any, address: str) -> None:
    trusted = distributed.Security().get_connection_args("client")
    comm = await import_module("distributed.comm").connect(address, timeout=CONNECT_S, **trusted)
    await comm.close()


def _client(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise _no_answer(address, error) from error


@contextmanager
def _answering(distributed: Any, address: str) -> Iterator[None]:
    """For what is asked of the scheduler, or by way of it.  Raises StudyError where it has gone."""
    try:
        yield
    except (OSError, CancelledError, distributed.client.ClosedClientError) as error:
        raise _gone(address) from error


def _gone(address: str) -> StudyError:
    return StudyError(
        f"scheduler {address}",
        found="it is gone, or was told to give up the runs",
        expected="one that stays until they are done",
        remedy="start it again, and the study with the same --out: finished runs are kept",
    )


def _no_answer(address: str, error: Exception) -> StudyError:
    why = type(error).__name__ if isinstance(error, OSError) else str(error)
    return _no_scheduler(address, f"no answer ({why})")


def _no_scheduler(address: str, found: str) -> StudyError:
    return StudyError(
        f"scheduler {address}",
        found=found,
        expected=f"a Dask scheduler that answers within {CONNECT_S:g} s, such as tcp://host:8786",
        remedy="start one with `dask scheduler`, or leave --scheduler out to use this machine",
    )


def _result(distributed: Any, client: Any, future: Any, task: Task, address: str) -> RunResult:
    try:
        result = future.result()
    except distributed.KilledWorker as error:
        raise StudyError(
            f"run {task.index} of {task.source}",
            found="several workers that died during it",
            expected="workers that live",
            remedy="see the workers' logs",
        ) from error
    except (CancelledError, *_UNABLE) as error:
        if future.status != "error":  # not the run has failed, but what brings its result
            raise _gone(address) from error
        with _answering(distributed, address):
            unable = _unable(client)
        if not unable:
            raise
        who, why = min(unable.items())
        raise StudyError(
            f"worker {who}",
            found=f"it cannot load widowx-coop ({why})",
            expected="this release on every worker",
            remedy="install it there (pip install 'widowx-coop[study]'), start the worker again, and the study with "
            "the same --out: finished runs are kept",
        ) from error
    return result_of(result)


def _unable(client: Any) -> dict[str, str]:
    """The workers on which our modules do not load, by address, and why."""
    answers = client.run(able, on_error="return")
    return {address: str(answer) for address, answer in answers.items() if answer is not True}
