"""The runs of a study on a Dask cluster; dask.distributed is loaded when it is asked for."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Final

from agent.study.measure import RunResult
from agent.study.plan import Task
from agent.study.store import StudyError
from agent.study.work import ATTEMPTS, Done, perform, result_of

CONNECT_S: Final = 10.0


def on_cluster(tasks: Sequence[Task], address: str, tell: Callable[[str], None] = lambda _: None) -> Iterator[Done]:
    """On the cluster whose scheduler is at `address`, as they are done.  Raises StudyError.

    tell: that nobody is there to do them, until somebody comes.
    """
    distributed = _distributed()
    _require_answer(distributed, address)
    with _told_by_refusals():
        client = _client(distributed, address)
        try:
            yield from _done(distributed, client, tasks, address, tell)
        finally:
            client.close()


def _done(
    distributed: Any, client: Any, tasks: Sequence[Task], address: str, tell: Callable[[str], None]
) -> Iterator[Done]:
    if not client.scheduler_info()["workers"]:
        tell(f"scheduler {address} has no workers yet: start some with `dask worker {address}`")
    futures = {client.submit(perform, task, pure=False, retries=ATTEMPTS - 1): task for task in tasks}
    for future in distributed.as_completed(futures, loop=client.loop):
        task = futures.pop(future)
        yield task, _result(distributed, future, task, address)


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


async def _greet(distributed: Any, address: str) -> None:
    trusted = distributed.Security().get_connection_args("client")
    comm = await import_module("distributed.comm").connect(address, timeout=CONNECT_S, **trusted)
    await comm.close()


def _client(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise _no_answer(address, error) from error


def _no_answer(address: str, error: Exception) -> StudyError:
    why = type(error).__name__ if isinstance(error, OSError) else str(error)
    return StudyError(
        f"scheduler {address}",
        found=f"no answer ({why})",
        expected=f"a Dask scheduler that answers within {CONNECT_S:g} s, such as tcp://host:8786",
        remedy="start one with `dask scheduler`, or leave --scheduler out to use this machine",
    )


def _result(distributed: Any, future: Any, task: Task, address: str) -> RunResult:
    try:
        result = future.result()
    except distributed.KilledWorker as error:
        raise StudyError(
            f"run {task.index} of {task.source}",
            found="several workers that died during it",
            expected="workers that live",
            remedy="see the workers' logs",
        ) from error
    except CancelledError as error:
        raise StudyError(
            f"scheduler {address}",
            found="it is gone, or was told to give up the runs",
            expected="one that stays until they are done",
            remedy="start it again, and the study with the same --out: finished runs are kept",
        ) from error
    return result_of(result)
