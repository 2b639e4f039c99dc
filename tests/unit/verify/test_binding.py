"""Of a cell that no gains survive: which stated tolerance binds, and how much of it by itself may stay."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest

import configs
from agent.config.cell import load_cell
from agent.verify import stiffest
from agent.verify.criterion.cases import Ranges
from agent.verify.robustness import ranges_of
from agent.verify.stiffest import Binding, Wanted
from agent.verify.tune import Form, Margin, Tuner
from agent.verify.tune_refusal import NoGains, less

STATED = Ranges((0.8, 1.0, 1.5), 0.4, 0.2, 0.6, (1e3, 1e5), (10.0, 1e3), 0.2)
INERTIA = "safety.inertia_error"


@pytest.mark.parametrize(
    ("key", "half", "exact"),
    [
        ("tolerance.delay", {"delay_periods": (0.9, 1.0, 1.25)}, {"delay_periods": (1.0, 1.0, 1.0)}),
        (INERTIA, {"inertia_error": 0.2}, {"inertia_error": 0.0}),
        ("tolerance.object", {"object_error": 0.1}, {"object_error": 0.0}),
        ("tolerance.friction", {"friction": 0.8}, {"friction": 1.0}),
        ("tolerance.pads_N_per_m", {"pads_N_per_m": (1e4, 1e5)}, {"pads_N_per_m": (1e5, 1e5)}),
        ("tolerance.pads_Nm_per_rad", {"pads_Nm_per_rad": (100.0, 1e3)}, {"pads_Nm_per_rad": (1e3, 1e3)}),
        ("tolerance.pads_damping_ratio", {"pads_damping_ratio": 0.6}, {"pads_damping_ratio": 1.0}),
    ],
)
def test_less_of_a_tolerance_is_nearer_to_what_the_files_say(key: str, half: dict, exact: dict) -> None:
    narrow = stiffest._narrowed(STATED)["inertia" if key == INERTIA else key]
    for part, changed in ((1.0, {}), (0.5, half), (0.0, exact)):
        found, wanted = asdict(narrow(part)), asdict(replace(STATED, **changed))
        assert {name: pytest.approx(value) for name, value in wanted.items()} == found


@pytest.mark.parametrize("kept", [True, False])
def test_of_what_binds_that_comes_first_of_which_most_can_stay_and_three_are_told(
    kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the inertia three quarters, of object and friction half, of the pads' softness none; of others not enough."""
    enough = {"inertia_error": 0.3, "object_error": 0.1, "friction": 0.8, "pads_N_per_m": (1e5, 1e5)}
    tried: list[Ranges] = []

    class Seen:
        def __init__(self, _poses: object, _loop: object, ranges: Ranges, _wanted: Wanted) -> None:
            self.ranges = ranges

        def nearest(self) -> float:
            of = self.ranges
            pads = of.pads_N_per_m[0] >= 0.999e5
            holds = of.inertia_error < 0.31 or of.object_error < 0.11 or of.friction > 0.79 or pads
            return 0.9 if holds else 0.95

        def run(self) -> stiffest.Stiffest:
            tried.append(self.ranges)
            return stiffest.Stiffest(None, None, kept, 0.0)  # type: ignore[arg-type]

        def here(self) -> float:
            of = self.ranges
            return 0.93 if of.inertia_error == 0.0 or of.friction == 1.0 else 0.94

    monkeypatch.setattr(stiffest, "Search", Seen)
    found, least = stiffest.binding([], None, STATED, Wanted(0.9, lambda _: 0.0), INERTIA)  # type: ignore[arg-type]
    keys = [INERTIA, "tolerance.object", "tolerance.friction"]
    assert least == (0.9 if kept else 0.93)
    assert [bind.key for bind in found] == (keys if kept else [INERTIA, "tolerance.friction"]), "not all that may"
    assert all((bind.enough is not None) == kept for bind in found)
    for ranges, (name, value) in zip(tried, enough.items(), strict=False):
        assert getattr(ranges, name) == pytest.approx(value)


def test_what_may_stay_is_told_as_a_cell_file_says_it() -> None:
    cell = load_cell(configs.CELLS_DIR / "paper_real.toml", ["tolerance.friction=[0.5, 1.7]", "loop_delay_s=0.004"])
    stated, believed = ranges_of(cell), cell.file.delay_periods
    assert believed == pytest.approx(0.8)
    enough = {
        "tolerance.delay": replace(stated, delay_periods=(0.9 * believed, believed, 1.1 * believed)),
        "tolerance.friction": replace(stated, friction=0.8),
        "tolerance.pads_N_per_m": replace(stated, pads_N_per_m=(3e3, 1e6)),
        INERTIA: replace(stated, inertia_error=0.21),
        "tolerance.object": replace(stated, object_error=0.11),
        "tolerance.pads_damping_ratio": replace(stated, pads_damping_ratio=0.31),
        "tolerance.pads_Nm_per_rad": replace(stated, pads_Nm_per_rad=(9.0, 1e3)),
    }
    assert less(cell, [Binding(key, ranges) for key, ranges in enough.items()], 0.98) == (
        "state less of what binds, if that is true: tolerance.delay = [0.9, 1.1] or tolerance.friction = [0.8, 1.7] "
        "or tolerance.pads_N_per_m = [3e+03, 1e+06] or safety.inertia_error = 0.21 or tolerance.object = 0.11 "
        "or tolerance.pads_damping_ratio = 0.31 or tolerance.pads_Nm_per_rad = [9, 1e+03] is enough; or raise rate_hz"
    )
    assert less(cell, [Binding("tolerance.object", None), Binding(INERTIA, None)], 0.99512) == (
        "tolerance.object or safety.inertia_error binds (it would be 0.9951 without): "
        "state less of it if that is true, or raise rate_hz"
    )


@pytest.mark.parametrize(
    ("stated", "tries"),
    [
        pytest.param("tolerance.pads_damping_ratio=0.02", 200, marks=pytest.mark.long),
        pytest.param("safety.inertia_error=0.9", 500, marks=pytest.mark.long),
        pytest.param("tolerance.delay=[0.8, 6.0]", 500, marks=pytest.mark.long),
    ],
)
def test_with_as_much_of_what_binds_as_it_names_gains_are_found(
    stated: str, tries: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, count in (("TRIES", tries), ("STARTS", 1), ("SHORT", tries // 2)):
        monkeypatch.setattr(stiffest, name, count)
    paper_real = configs.CELLS_DIR / "paper_real.toml"
    with pytest.raises(NoGains) as caught:
        Tuner(load_cell(paper_real, [stated])).propose(Form.REALITY, Margin())
    _, named, told = str(caught.value).partition("state less of what binds, if that is true: ")
    assert named
    assert told.endswith(" is enough; or raise rate_hz")
    enough = told.partition(" is enough")[0].split(" or ")
    assert stated.partition("=")[0] in [one.partition(" = ")[0] for one in enough]
    for one in enough:
        assert Tuner(load_cell(paper_real, [stated, one])).propose(Form.REALITY, Margin())
