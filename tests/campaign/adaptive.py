"""The adaptive law and arms that disagree, for 100 s each: what they press with must stay small and must not grow."""

from __future__ import annotations

from typing import Final, NamedTuple

from tests.soak.watch import say
from tests.support.disagreement import Pressed, pressed

DURATION_S: Final = 100.0
FORCE_N: Final = 1.5
GROWTH_N: Final = 0.15  # of the mean from one stretch of 20 s to a later one
ERROR_TIMES: Final = 2.0
X, Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
HALF, TWICE = (("start='nominal'", f"start_scale={scale}") for scale in (0.5, 2.0))


class Disagreeing(NamedTuple):
    """One run: how it differs from the cell as its file has it."""

    words: str
    off_mm: float
    direction: tuple[float, float, float] = Y
    start: tuple[str, ...] = ()
    object_times: float = 1.0


RUNS: Final = (
    *(Disagreeing(f"{off:g} mm in x", off, X) for off in (0.5, 2.0, 5.0)),
    *(Disagreeing(f"{off:g} mm in y", off) for off in (0.2, 0.5, 1.0, 2.0, 5.0)),
    Disagreeing("2 mm, from half of the parameters", 2.0, start=HALF),
    Disagreeing("2 mm, from twice the parameters", 2.0, start=TWICE),
    Disagreeing("2 mm, object twice as heavy", 2.0, object_times=2.0),
)


def missed(found: Pressed, agreed: Pressed) -> list[str]:
    """What a run does not keep; agreed: the one in which the arms agree."""
    last, before = found.mean_N(80.0, 100.0), found.mean_N(40.0, 60.0)
    error, usual = found.error_after_m(30.0), agreed.error_after_m(30.0)
    return [
        *found.told,
        *([f"{last:.2f} N at the end"] if last > FORCE_N else []),
        *([f"grows from {before:.2f} to {last:.2f} N"] if last > before + GROWTH_N else []),
        *([f"{error * 1e3:.2f} mm, {usual * 1e3:.2f} mm where all agree"] if error > ERROR_TIMES * usual else []),
    ]


def disagreements() -> bool:
    """All runs; whether every one keeps its bounds."""
    agreed, good = pressed(0.0, DURATION_S), True
    say(f"adaptive, all agree: {agreed.mean_N(80.0, 100.0):.2f} N, {agreed.error_after_m(30.0) * 1e3:.2f} mm")
    for run in RUNS:
        start = [f"controller.adaptive.{change}" for change in run.start]
        found = pressed(run.off_mm, DURATION_S, *start, direction=run.direction, object_times=run.object_times)
        wrong = missed(found, agreed)
        good &= not wrong
        force, error = found.mean_N(80.0, 100.0), found.error_after_m(30.0) * 1e3
        say(f"adaptive, {run.words}: {force:.2f} N, {error:.2f} mm{'; ' + ', '.join(wrong) if wrong else ''}")
    return good
