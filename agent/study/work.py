"""Who does the runs of a study: this process or several of this machine (a Dask cluster: cluster.py), alike to the bit.

A worker that dies takes nothing with it but time: its run is given to another.
"""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import platform
import queue
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from agent.config.cell import cell_from_toml
from agent.host import python
from agent.host.signals import StopFlag
from agent.study.lab import Laboratory
from agent.study.measure import RunResult, run_once
from agent.study.plan import Task
from agent.study.provenance import apart, provenance
from agent.study.store import StudyError
from drivers.interface import Refusal

ATTEMPTS: Final = 3  # a run during which so many workers have died is not tried again

Done = tuple[Task, RunResult]


@dataclass(frozen=True)
class Refused:
    """Why a run could not be done, by value: a Refusal does not travel between processes."""

    what: str
    found: str
    expected: str
    remedy: str

    def error(self) -> StudyError:
        """The same as an error of this process."""
        return StudyError(self.what, found=self.found, expected=self.expected, remedy=self.remedy)


@lru_cache(maxsize=4)
def _laboratory(cell_toml: bytes, source: str) -> Laboratory:
    return Laboratory(cell_from_toml(cell_toml, source))


def perform(task: Task) -> RunResult | Refused:
    """Do one run; the cell that a process did before is ready."""
    other = _otherwise(f"worker on {platform.node()}", provenance(), task.provenance)
    if other is not None:
        return other
    enabled = gc.isenabled()
    gc.disable()  # nothing in a tick makes cycles
    try:
        lab = _laboratory(task.cell_toml, task.source)
        of_files = {"fingerprint": lab.cell.fingerprint}
        other = _otherwise(
            f"arm files of {task.source} on {platform.node()}", of_files, {"fingerprint": task.fingerprint}
        )
        return other or run_once(lab, task.index, task.seed, task.faults)
    except Refusal as error:
        what = f"run {task.index} of {task.source}, reality {task.seed}: {error.what}"
        return Refused(what, str(error.found), str(error.expected), error.remedy)
    finally:
        if enabled:
            gc.enable()


def able() -> bool:
    """Asked of a worker elsewhere: there it is answered only where what does a run can be loaded."""
    return True


def _otherwise(who: str, found: Mapping[str, str], expected: Mapping[str, str]) -> Refused | None:
    """Why a run is not done here, where it would be another one; None where it is the same."""
    if found == expected:
        return None
    ours, theirs = apart(found, expected)
    remedy = "install the same release there, start the worker again, and the study with the same --out"
    return Refused(who, ours, f"{theirs}, as where the study was started", remedy)


def result_of(answer: RunResult | Refused) -> RunResult:
    """What came back of a run.  Raises StudyError where it could not be done."""
    if isinstance(answer, Refused):
        raise answer.error()
    return answer


def here(tasks: Sequence[Task]) -> Iterator[Done]:
    """In this process, one after the other.  Raises StudyError."""
    for task in tasks:
        yield task, result_of(perform(task))


def in_processes(tasks: Sequence[Task], workers: int) -> Iterator[Done]:
    """In so many processes of this machine, as they are done.  Raises StudyError."""
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    for task in tasks:
        waiting.put(task)
    done: queue.SimpleQueue[tuple[Task, RunResult | Refused]] = queue.SimpleQueue()
    crew = [_Worker(waiting, done) for _ in range(workers)]
    try:
        for worker in crew:
            worker.start()
        for _ in tasks:
            task, answer = done.get()
            yield task, result_of(answer)
    finally:
        for worker in crew:
            worker.stop()
        for worker in crew:
            worker.join()


def until(stop: StopFlag, work: Callable[[Sequence[Task]], Iterator[Done]], tasks: Sequence[Task]) -> Iterator[Done]:
    """The runs that `work` has done until a stop comes, which waits for none.  Raises what it raises."""
    runs = work(tasks)
    for _ in tasks:
        if stop():
            return
        try:
            with stop.interrupting():
                done = next(runs)
        except KeyboardInterrupt:
            return
        yield done


class _Worker(threading.Thread):
    """Hands tasks to a process of its own, and to another one where that has died."""

    def __init__(
        self, waiting: queue.SimpleQueue[Task], done: queue.SimpleQueue[tuple[Task, RunResult | Refused]]
    ) -> None:
        super().__init__(daemon=True)
        self._waiting, self._done = waiting, done
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def run(self) -> None:
        """Work until nothing waits any more."""
        try:
            while not self._stopped:
                task = self._waiting.get_nowait()
                answer = self._given(task)
                if answer is not None:
                    self._done.put((task, answer))
        except queue.Empty:
            pass
        finally:
            self._end()

    def _given(self, task: Task) -> RunResult | Refused | None:
        """What a process makes of the task; None once this worker is stopped."""
        for _ in range(ATTEMPTS):
            if self._stopped:
                return None
            if self._process is None:
                self._process = _start()
            try:
                return self._ask(self._process, task)
            except (EOFError, OSError, pickle.UnpicklingError):
                self._end()
        return Refused(
            f"run {task.index} of {task.source}, reality {task.seed}",
            f"{ATTEMPTS} workers that died during it",
            "workers that live",
            "see whether the machine is short of memory, and give fewer --workers",
        )

    @staticmethod
    def _ask(process: subprocess.Popen[bytes], task: Task) -> RunResult | Refused:
        assert process.stdin is not None
        assert process.stdout is not None
        pickle.dump(task, process.stdin)
        process.stdin.flush()
        answer: RunResult | Refused = pickle.load(process.stdout)
        return answer

    def stop(self) -> None:
        """End the process, and with it what it is doing; called from another thread."""
        self._stopped = True
        process = self._process
        if process is not None:
            process.kill()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()


def _start() -> subprocess.Popen[bytes]:
    one = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # our matrices are small
    return subprocess.Popen(
        python.command("agent.study.worker", str(os.getpid())),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=one | python.surroundings(),
        start_new_session=True,  # Ctrl-C is for the process that started it
    )


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))
