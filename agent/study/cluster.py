"""The runs of a study on a Dask cluster; dask.distributed is loaded when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
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
    client = _client(distributed, address)
    try:
        if not client.scheduler_info()["workers"]:
            tell(f"scheduler {address} has no workers yet: start some with `dask worker {address}`")
        futures = {client.submit(perform, task, pure=False, retries=ATTEMPTS - 1): task for task in tasks}
        for future in distributed.as_completed(futures, loop=client.loop):
            task = futures.pop(future)
            yield task, _result(distributed, future, task, address)
    finally:
        client.close()


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


def _client(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StudyError(
            f"scheduler {address}",
            found=f"no answer ({type(error).__name__})",
            expected=f"a Dask scheduler that answers within {CONNECT_S:g} s, such as tcp://host:8786",
            remedy="start one with `dask scheduler`, or leave --scheduler out to use this machine",
        ) from error


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
