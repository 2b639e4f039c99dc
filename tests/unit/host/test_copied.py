"""A process that begins as a copy of another one has nothing of it but what was loaded."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

TYPED = "to the other\n" * 2000  # more than is read ahead
Told = Callable[[str], list[str]]

BEGIN = """
import atexit, os, signal, sys, threading, time
from pathlib import Path
from agent.host.copied import Copy, is_alone

def copied(be, name="arm-left"):
    with open("words", "wb") as words:
        return Copy(name, be, words)

def of(be, name="arm-left"):
    copy = copied(be, name)
    said = copy.stdout.read().decode()
    print(copy.wait(), repr(said), repr(Path("words").read_text()))
"""


@pytest.fixture
def told(tmp_path: Path) -> Told:
    """What a process with one thread prints that does this: a copy of the tests would have theirs."""

    def run(body: str) -> list[str]:
        command = [sys.executable, "-c", BEGIN + body]
        done = subprocess.run(command, cwd=tmp_path, input=TYPED, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        return done.stdout.splitlines()

    return run


def test_a_copy_of_a_process_without_standard_streams_is_heard(tmp_path: Path) -> None:
    """As of a `coop run` of a service or `>&- 2>&-`; one that says nothing is waited for."""
    code = f"""from agent.host.starting import settle
settle()
{BEGIN}
def be():
    print("READY", flush=True)
    with open("file", "wb") as file:
        print(file.fileno() > 2, file=sys.stderr)
    return 0
copy = copied(be)
Path("told").write_text(f"{{copy.stdout.read().decode()}}{{copy.wait()}}")
"""
    closed = ["sh", "-c", 'exec "$0" -c "$1" <&- >&- 2>&-', sys.executable, code]
    subprocess.run(closed, cwd=tmp_path, check=True, timeout=60)
    assert (tmp_path / "told").read_text() == "READY\n0"
    assert (tmp_path / "words").read_text() == "True\n"


def test_a_copy_of_a_process_that_has_all_its_files_open_closes_them_first(told: Told) -> None:
    """A traceback stood before the line that says so."""
    body = """import resource
def be():
    with open("file", "wb"):
        return 6
with open("words", "wb") as words:
    inside = [os.open("/", os.O_RDONLY) for _ in range(20)]
    for fd in inside[:2]:  # the pipe between the two
        os.close(fd)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(inside) + 1, max(inside) + 1))
    copy = Copy("arm-left", be, words)
for fd in inside[2:]:
    os.close(fd)
print(copy.wait())
print(repr(Path("words").read_text()))
"""
    assert told(body) == ["6", "''"]


@pytest.mark.parametrize(
    ("end", "code", "words"),
    [
        ("return 0", 0, ""),
        ("return 6", 6, ""),
        ("sys.exit()", 0, ""),
        ("sys.exit(3)", 3, ""),
        ("sys.exit('the other is gone')", 1, "the other is gone\n"),
        ("os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL, ""),
    ],
)
def test_it_ends_as_any_process_does(told: Told, end: str, code: int, words: str) -> None:
    assert told(f"def be():\n    {end}\nof(be)") == [f"{code} '' {words!r}"]


def test_an_error_of_its_own_is_written_where_its_words_go_and_nothing_of_the_other_goes_on(told: Told) -> None:
    [line] = told("""
def be():
    raise LookupError("of the copy")
atexit.register(print, end="")
try:
    of(be)
finally:
    Path(f"tidied-{os.getpid()}").touch()
""")
    assert line.startswith("1 '' 'Traceback (most recent call last):")
    assert line.endswith("LookupError: of the copy\\n'")


def test_who_is_copied_tidies_up_once(told: Told, tmp_path: Path) -> None:
    told("""
def tidy():
    Path(f"left-{os.getpid()}").touch()
atexit.register(tidy)
try:
    of(lambda: 0)
finally:
    Path(f"tidied-{os.getpid()}").touch()
""")
    assert len(list(tmp_path.glob("left-*"))) == len(list(tmp_path.glob("tidied-*"))) == 1


def test_what_it_writes_goes_to_who_copied_it_and_what_waited_there_is_written_once(told: Told) -> None:
    lines = told("""
assert sys.stdin.readline()
sys.stdout = os.fdopen(1, "w", closefd=False)  # as of a process whose reader may leave
sys.stdout.write("before ")
def be():
    print("READY")
    sys.stderr.write("a word, \\u00fc, \\udcff\\n")
    return len(sys.stdin.read())
of(be)
""")
    assert lines == ["before 0 'READY\\n' 'a word, ü, \\\\udcff\\n'"]


def test_it_has_a_name_a_session_and_no_file_of_the_other(told: Told) -> None:
    [line] = told("""
held = open("held", "w")
os.set_inheritable(held.fileno(), True)
def be():
    files = sorted(int(link.name) for link in Path("/proc/self/fd").iterdir())
    print(Path("/proc/self/comm").read_text().strip(), os.getsid(0) == os.getpid(), files[:3], len(files))
    return 0
of(be, "telemetry-of-the-left-arm")
""")
    assert line == r"0 'telemetry-of-th True [0, 1, 2] 4\n' ''"  # the fourth lists the others


def test_a_signal_reaches_it_as_any_process_however_soon_it_comes_and_however_the_other_hears(told: Told) -> None:
    lines = told("""
heard = []
for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
    signal.signal(number, lambda *signal: heard.append(signal))
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
def wait():
    time.sleep(60.0)
for number in (signal.SIGTERM, signal.SIGHUP):
    for _ in range(20):
        copy = copied(wait)
        copy.send_signal(number)
        assert copy.wait(30.0) == -number
copy = copied(wait)
copy.send_signal(signal.SIGINT)
print(copy.wait(30.0), Path("words").read_text().splitlines()[-1], heard)
def ignored():
    return int(signal.getsignal(signal.SIGTTOU) is signal.SIG_IGN and not signal.pthread_sigmask(0, []))
print(copied(ignored).wait(30.0), signal.pthread_sigmask(0, []))
""")
    assert lines == ["1 KeyboardInterrupt []", "1 set()"]


def test_who_waits_for_it_waits_no_longer_than_he_says(told: Told) -> None:
    lines = told("""
import subprocess
copy = copied(lambda: time.sleep(60.0))
try:
    copy.wait(0.01)
except subprocess.TimeoutExpired:
    print("it runs", copy.poll(), copy.returncode)
copy.kill()
print(copy.wait(), copy.poll(), copy.returncode)
copy.send_signal(9)
copy.kill()
""")
    assert lines == ["it runs None None", "-9 -9 -9"]


def test_a_process_with_another_thread_is_not_copied_but_starts_one_anew(told: Told) -> None:
    lines = told("""
from agent.host.child import Child
def be(arguments):
    return 40 + len(arguments)
def code(be):
    return Child("plant", ["nothing", "at all"], Path.cwd(), be).process.wait()
print(is_alone(), code(be), code(None))
wait = threading.Event()
other = threading.Thread(target=wait.wait)
other.start()
print(is_alone(), code(be))
wait.set()
other.join()
""")
    assert lines == ["True 42 2", "False 2"]
