"""Which signals ask a process to stop, and that it ends with the one that started it."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from agent.host.signals import StopFlag
from tests.support.stops import CAUGHT

OF_JOB_CONTROL = (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)


@pytest.fixture
def handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in CAUGHT}
    for number in (signal.SIGHUP, *OF_JOB_CONTROL):  # these tests may themselves run under `nohup`
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGTSTP])
def test_each_request_to_stop_is_counted(number: signal.Signals) -> None:
    flag, heard = StopFlag(), list[str]()
    flag.heard = heard.append
    assert (flag(), flag.stops, flag.released) == (False, 0, False)
    assert callable(signal.getsignal(number)), "or it suspends these tests"
    signal.raise_signal(number)
    signal.raise_signal(number)
    assert (flag(), flag.stops, flag.released) == (True, 2, False)
    assert flag.why.startswith(f"{number.name}: "), "and why is told"
    assert heard == [flag.why] * 2, "at once, each time"


@pytest.mark.usefixtures("handlers")
def test_a_release_is_no_stop() -> None:
    flag = StopFlag()
    signal.raise_signal(signal.SIGUSR1)
    assert (flag(), flag.released) == (False, True)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTSTP])
def test_a_process_that_is_to_outlive_its_terminal_does(number: signal.Signals) -> None:
    signal.signal(number, signal.SIG_IGN)  # as `nohup` starts it
    flag = StopFlag()
    signal.raise_signal(number)
    assert not flag()


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("suspends", [False, True])
def test_a_terminal_in_front_of_which_another_is_suspends_only_who_watches_over_nothing(suspends: bool) -> None:
    flag = StopFlag(suspends=suspends)
    kept = [signal.getsignal(number) is signal.SIG_DFL for number in OF_JOB_CONTROL]
    assert kept == [suspends] * len(OF_JOB_CONTROL)
    if not suspends:
        for number in (signal.SIGTTIN, signal.SIGTTOU):
            signal.raise_signal(number)
        assert not flag()


@pytest.mark.usefixtures("handlers")
def test_a_stop_interrupts_work_that_asks_nobody_but_not_what_tidies_up_after_it() -> None:
    flag = StopFlag()

    def work() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGTERM)
            flag.released = True  # as a draft that is removed

    with pytest.raises(KeyboardInterrupt), flag.interrupting():
        work()
    assert flag.released
    assert (flag(), flag.stops) == (True, 2)


@pytest.mark.usefixtures("handlers")
def test_a_stop_that_is_lost_in_such_work_ends_it_all_the_same() -> None:
    flag = StopFlag()

    def dropped() -> None:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)

    def turned() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise ValueError from None

    for work in (dropped, turned):
        with pytest.raises(KeyboardInterrupt), flag.interrupting():
            work()
    with pytest.raises(ZeroDivisionError), flag.interrupting():
        _ = 1 / 0


@pytest.mark.usefixtures("handlers")
def test_a_stop_before_or_after_such_work_interrupts_nothing() -> None:
    flag = StopFlag()
    signal.raise_signal(signal.SIGINT)
    with flag.interrupting():
        pass
    signal.raise_signal(signal.SIGINT)
    assert flag.stops == 2


# a process whose parent has gone before it says that it ends with it; argument 1 says who adopts it
ORPHAN = """
import ctypes, os, sys, time
from agent.host.signals import begin
if sys.argv[1] == "subreaper":  # as a session's `systemd --user` is
    ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)
ours, theirs = os.pipe()
if not (parent := os.fork()):
    if os.fork():
        os._exit(0)
    starter = int(os.read(ours, 20))
    while os.getppid() == starter:
        time.sleep(0.001)
    try:
        begin(starter, at_once=sys.argv[2] == "at once")
        print("goes on", flush=True)
    except SystemExit as end:
        print(end, flush=True)
    os._exit(0)
os.write(theirs, str(parent).encode())
try:
    while True:
        os.wait()
except ChildProcessError:
    pass
"""


@pytest.mark.parametrize("how", ["by SIGTERM", "at once"])
@pytest.mark.parametrize("adopted_by", ["subreaper", "whoever is there"])
def test_a_process_whose_parent_is_gone_already_does_not_begin_whoever_has_adopted_it(
    adopted_by: str, how: str
) -> None:
    said = subprocess.run(
        [sys.executable, "-c", ORPHAN, adopted_by, how], capture_output=True, text=True, check=True, timeout=60.0
    )
    assert said.stdout == "the process that started this one is gone\n", said.stderr
