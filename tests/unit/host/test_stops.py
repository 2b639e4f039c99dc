"""A stop ends a command, tidily and with 130, whatever the library that it is in makes of the exception."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("number", "ignored", "ended"), [("SIGTERM", False, True), ("SIGHUP", False, True), ("SIGHUP", True, False)]
)
def test_a_command_that_is_told_to_end_tidies_up(number: str, ignored: bool, ended: bool) -> None:
    """As at Ctrl-C: `coop report` left its draft behind.  Under `nohup` it goes on."""
    code = f"""
import signal
from agent.cli.main import main
signal.signal(signal.{number}, signal.{"SIG_IGN" if ignored else "SIG_DFL"})
try:
    main(["where", "cells"])
except SystemExit:
    pass
try:
    signal.raise_signal(signal.{number})
except KeyboardInterrupt:
    print("tidied")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.endswith("tidied\n") is ended


@pytest.mark.parametrize("ignored", [False, True])
def test_a_command_that_moves_an_arm_ends_at_ctrl_z_as_at_ctrl_c_unless_that_is_ignored(ignored: bool) -> None:
    before = "signal.signal(signal.SIGTSTP, signal.SIG_IGN)" if ignored else ""
    code = f"""import signal
from agent.host.stops import hear_ctrl_z
{before}
hear_ctrl_z()
try:
    signal.raise_signal(signal.SIGTSTP)
    print("goes on")
except KeyboardInterrupt:
    print("ends")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True, start_new_session=True
    )
    assert done.stdout == ("goes on\n" if ignored else "ends\n")


# a command whose work is given here; the handler runs within whatever the work is in when it raises the signal
COMMAND = """
import signal, sys, time, weakref
from agent.cli import __main__, main
class Thing: pass
def stop(*_):
    signal.raise_signal(signal.{number})
    time.sleep(0.0)  # the interpreter looks for signals
def work():
{work}
main._command = lambda first: lambda *_, **__: work()
print("loaded", flush=True)
__main__.main()
"""
DROPPED = """
    thing = Thing()
    kept = weakref.ref(thing, stop)
    del thing
    print("goes on", flush=True)
    {then}
"""
TURNED = """
    try:
        stop()
    except KeyboardInterrupt:
        raise ValueError("Invalid bounding box") from None
"""


def ran(work: str, number: str) -> tuple[int, str, str]:
    code = COMMAND.format(number=number, work=work)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize(
    ("work", "said"),
    [
        (DROPPED.format(then="time.sleep(20.0); print('its end')"), "loaded\ngoes on\n"),  # it comes again
        (DROPPED.format(then="return 0"), "loaded\ngoes on\n"),
        (TURNED, "loaded\n"),
    ],
    ids=["dropped", "dropped at the end", "another exception"],
)
def test_a_stop_that_is_lost_where_it_came_ends_the_command_all_the_same(work: str, said: str, number: str) -> None:
    assert ran(work, number) == (130, said, "")


def test_what_fails_without_a_stop_keeps_its_words() -> None:
    code, _, words = ran('    raise ValueError("a defect")', "SIGINT")
    assert code == 1
    assert "ValueError: a defect" in words
    _, _, words = ran("    Thing.__del__ = lambda self: 1 / 0\n    Thing()\n    return 0", "SIGINT")
    assert "ZeroDivisionError" in words
