"""What `coop run` refuses before anything is started or removed."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.process.emulate import gripping, require_faults
from agent.process.folder import LOG_NAME, RunError
from agent.process.run import RunOptions, _cell_of
from agent.process.run_kind import RunKind
from sim_backend.wire.faults import FaultError
from tests.support.command import coop
from tests.support.starts import start_joints


def options(duration_s: float) -> RunOptions:
    return RunOptions(Path("paper"), (), duration_s, None, 0, RunKind.LOCKSTEP)


@pytest.mark.parametrize("duration_s", [0.001, 0.0049])
def test_a_run_of_no_cycle_is_refused(duration_s: float) -> None:
    with pytest.raises(RunError, match=f"duration_s of cell paper: found {duration_s} s, expected one cycle .*0.005 s"):
        _cell_of(options(duration_s))


@pytest.mark.parametrize("words", [("agent", "--ring", "ring"), ("guard",)], ids=["agent", "guard"])
def test_a_port_of_an_arm_that_is_simulated_is_refused(tmp_path: Path, words: tuple[str, ...]) -> None:
    command, *more = words
    done = coop(command, "two_wx200", "--arm", "left", "--port", "/dev/ttyDXL_left", *more, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "--port of arm left: found /dev/ttyDXL_left, and an arm that is simulated" in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ("plant", "two_wx200", "--socket", "kept"),
        ("plant", "two_wx200", "--ring", "kept"),
        ("agent", "two_wx200", "--arm", "left", "--ring", "ring", "--control", "kept"),
        ("telemetry", "paper", "--arm", "left", "--ring", "ring", "--connect", "garbage"),
        ("record", "paper", "--listen", "garbage"),
    ],
    ids=lambda words: " ".join(words[::3]),
)
def test_what_is_in_the_way_and_what_is_no_place_has_the_code_of_what_never_began(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    (tmp_path / "kept").write_text("somebody's")
    done = coop(*words, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert len(done.err.splitlines()) == 1
    assert (tmp_path / "kept").read_text() == "somebody's"


def test_a_run_whose_recorder_could_listen_nowhere_is_refused_and_leaves_no_folder(tmp_path: Path) -> None:
    done = coop("run", "paper", "--duration", 1, "--listen", "foo", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "endpoint to listen at: found 'foo', expected like tcp/127.0.0.1:7448" in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_has_the_same_range_in_a_run_a_study_and_a_cell(tmp_path: Path, seed: int) -> None:
    expected = "greater than or equal to 0" if seed < 0 else f"less than {2**63}"
    for words, place in (
        (("run", "paper", "--seed", seed), "seed in the command"),
        (("study", "paper", "--seed", seed), "seed in the command"),
        (("check", "paper", "--set", f"simulation.reality.seed={seed}"), "simulation.reality.seed in "),
    ):
        done = coop(*words, cwd=tmp_path)
        assert (done.code, done.out) == (2, "")
        assert done.err.startswith(f"coop: {place}")
        assert f": found {seed}, expected {expected}; " in done.err
    assert list(tmp_path.iterdir()) == []


def test_the_help_of_a_run_says_what_its_seed_is_of() -> None:
    said = " ".join(coop("run", "--help").out.split())
    assert "Seed of what is random in --faults; without them it changes nothing." in said


def test_the_help_of_a_run_promises_no_length_that_is_refused() -> None:
    (said,) = (line for line in coop("run", "--help").out.splitlines() if "--duration" in line)
    assert "a cycle at least" in said
    assert "x>=0" not in said


def test_a_run_of_one_cycle_is_none_too_short() -> None:
    assert _cell_of(options(0.005)).file.duration_s == 0.005


@pytest.mark.parametrize(
    ("content", "words", "told"),
    [
        (None, ["--wire"], "faults file faults.json: found No such file"),
        (b"\xff\x00", ["--wire"], "faults file faults.json: found bytes that are no text"),
        (b"nonsense", ["--wire"], "faults file faults.json, fault command: line: found 'nonsense'"),
        (
            b'{"kind": "drop", "arm": "middle"}', ["--wire"],
            "faults file faults.json, fault command: arm: found 'middle', expected left or right",
        ),
        (
            b'{"kind": "drop", "arm": "left", "servo": 99}', ["--wire"],
            "faults file faults.json, fault command: servo of arm left: found 99, expected one of [1, 2, 3, ",
        ),
        (
            b'{"kind": "drop", "arm": "right"}', ["--hil", "left"],
            "faults file faults.json, fault command: arm: found 'right', expected left",
        ),
    ],
    ids=["none", "no text", "no JSON", "arm", "servo", "arm that is not in the loop"],
)  # fmt: skip
def test_faults_that_cannot_be_are_refused_before_an_earlier_run_is_removed(
    tmp_path: Path, content: bytes | None, words: list[str], told: str
) -> None:
    log = tmp_path / "out" / LOG_NAME
    log.parent.mkdir()
    log.write_bytes(b"of an earlier run")
    if content is not None:
        (tmp_path / "faults.json").write_bytes(content)
    line = ["run", "paper_real", *words, "--faults", "faults.json", "--duration", "1", "--out", "out", "--force"]
    done = coop(*line, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"coop: {told}")
    assert [path.name for path in log.parent.iterdir()] == [LOG_NAME]
    assert log.read_bytes() == b"of an earlier run"


@pytest.mark.parametrize("cell_name", ["paper_real", "two_wx200"])
def test_faults_may_be_of_every_servo_that_a_run_emulates(tmp_path: Path, cell_name: str) -> None:
    cell, path = load_cell(Path(cell_name)), tmp_path / "faults.json"
    emulated, _ = gripping(cell, start_joints(cell), None)
    for arm in emulated.arms:
        for servo in range(20):
            path.write_text(f'{{"kind": "mute", "arm": "{arm.name}", "servo": {servo}}}')
            if servo in {each.id for each in arm.bus.servos}:
                require_faults(path, cell.arms)
            else:
                with pytest.raises(FaultError, match=f"found {servo}, "):
                    require_faults(path, cell.arms)
