"""Nobody ignores `[[simulation.fault]]`: what would not happen is refused before anything begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.config.cell import Cell, ConfigError, load_cell
from agent.process import emulate, plant
from agent.process.befallen import require_done, stop_in
from sim_backend.served.options import LostArm
from sim_backend.wire.serve import ServeOptions
from tests.support.command import coop

OUT = r"or leave the fault out \(--set simulation.fault=\[\]\)"
LOOPED = 'hil.arms=["left"]'


def never(*_: object) -> None:
    raise AssertionError("something is served")


def cell(kind: str, arm: str = "left", *changes: str) -> Cell:
    return load_cell(Path("two_wx200"), [f"simulation.fault=[{{kind='{kind}', arm='{arm}', at_s=2.0}}]", *changes])


def test_who_does_everything_is_refused_nothing() -> None:
    for kind in ("limp", "hold", "locked", "open"):
        require_done(cell(kind), stops=True)
    for kind in ("limp", "locked", "open"):
        require_done(cell(kind), stops=False)
        require_done(cell(kind, "right"), stops=True, alone=("left",))


def test_an_arm_is_stopped_in_the_first_cycle_in_which_the_cell_says_that_it_holds() -> None:
    faults = (("hold", "left", 2.0), ("hold", "left", 1.003), ("limp", "left", 0.1), ("hold", "right", 0.5))
    table = ", ".join(f"{{kind='{kind}', arm='{arm}', at_s={at_s}}}" for kind, arm, at_s in faults)
    befallen = load_cell(Path("two_wx200"), [f"simulation.fault=[{table}]"])
    assert [stop_in(befallen, arm) for arm in ("left", "right")] == [201, 100]
    assert [stop_in(cell("limp"), arm) for arm in ("left", "right")] == [None, None]


def test_a_plant_by_hand_stops_nobody(tmp_path: Path) -> None:
    held, match = cell("hold"), f"simulation.fault: hold left at 2 s: found a plant by hand.*coop run CELL.*{OUT}"
    with pytest.raises(ConfigError, match=match):
        plant.run_plant(
            held, tmp_path / "socket", tmp_path / "ring", lockstep=True, lost_arm=LostArm.END_RUN, stop=lambda: True,  # type: ignore[arg-type]
            ready=lambda _: None,
        )  # fmt: skip
    with pytest.raises(ConfigError, match=match):
        emulate.run_emulate(
            held, ServeOptions({}), tmp_path / "ring", timing=False, stop=lambda: True, ready=lambda _: None  # type: ignore[arg-type]
        )  # fmt: skip
    assert list(tmp_path.iterdir()) == []


def test_the_plant_moves_no_arm_in_the_loop(tmp_path: Path) -> None:
    looped, match = cell("limp", "left", LOOPED), rf"limp left at 2 s: found an arm on its own or in the loop.*{OUT}"
    with pytest.raises(ConfigError, match=match):
        plant.run_plant(
            looped, tmp_path / "socket", tmp_path / "ring", lockstep=False, lost_arm=LostArm.END_RUN, stop=lambda: True,  # type: ignore[arg-type]
            ready=lambda _: None, stops=True,
        )  # fmt: skip
    with pytest.raises(ConfigError, match=match):
        emulate.run_emulate_alone(looped, ServeOptions({}), timing=False, stop=lambda: True, ready=lambda _: None)  # type: ignore[arg-type]
    require_done(cell("limp", "right", LOOPED), stops=True, alone=("left",))


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("--wire", "--whole"), "a run from rest to rest"),
        (("--hil", "left"), "an arm on its own or in the loop, which the simulated cell does not move"),
    ],
)
def test_a_run_that_could_not_do_it_is_refused_in_one_line_and_leaves_nothing(
    tmp_path: Path, words: tuple[str, ...], found: str
) -> None:
    fault = "simulation.fault=[{kind='locked', arm='left', at_s=2.0}]"
    done = coop("run", "two_wx200", *words, "--set", fault, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert f"simulation.fault: locked left at 2 s: found {found}, expected " in done.err
    assert done.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_the_cell_is_none_beside_those_that_are_injected(tmp_path: Path) -> None:
    fault = "simulation.fault=[{kind='locked', arm='left', at_s=2.0}]"
    done = coop("faults", "inject", "two_wx200", "arm-off", "--set", fault, cwd=tmp_path)
    assert done.code == 2
    assert "simulation.fault: locked left at 2 s: found a fault of the cell's own in `coop faults inject`, " in done.err


@pytest.mark.parametrize(
    ("kind", "words", "found"),
    [
        ("hold", ("plant",), "a plant by hand, which stops nobody"),
        ("hold", ("emulate", "--ports", "ports"), "a plant by hand, which stops nobody"),
        ("limp", ("emulate", "--ports", "ports", "--whole"), "a run from rest to rest"),
    ],
)
def test_a_process_by_hand_refuses_what_it_cannot_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, words: tuple[str, ...], found: str
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for module in (plant, emulate):
        monkeypatch.setattr(module, "serve", never)
    path = tmp_path / "cell.toml"
    path.write_bytes(cell(kind).toml)
    done = coop(words[0], path, *words[1:], cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert f"simulation.fault: {kind} left at 2 s: found {found}, expected " in done.err
