"""What alignment took off a disagreement of the arms: of which ticks it is, and when nothing is said."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from agent.log.read import RunLog
from agent.modes import Mode
from agent.report.found_together import WINDOW_S, FoundTogether, found_together
from agent.report.metrics import summarise
from agent.report.prepared import Prepared, prepare
from agent.report.tables import lines
from tests.support.view_run import view_log

RATE_HZ = 200
WINDOW = round(WINDOW_S * RATE_HZ)  # ticks


def test_what_the_shifts_leave_of_a_disagreement_is_said_beside_it() -> None:
    log = view_log()
    assert math.isnan(summarise(log).arm_disagreement_left_m), "nobody has shifted"
    apart, shift = log.agents["right"]["p_object"], log.agents["right"]["shift"]
    apart[:, 1] += 2e-3
    shift[:, 1] = np.linspace(0.0, 1.5e-3, len(shift))
    log.agents["left"]["shift"][:, 2] = 1.2e-3
    found = summarise(log)
    assert found.arm_disagreement_left_m == pytest.approx(math.hypot(0.5e-3, 1.2e-3))
    assert found.to_json()["arm_disagreement_left_m"] == found.arm_disagreement_left_m
    settled(log)
    assert disagreement_line(log) == "2.00\xa0mm; at the end 2.00\xa0mm, and have found together to 1.33\xa0mm"


def settled(log: RunLog) -> None:
    """Its transient is over after half a second."""
    run = json.loads(log.attachments["run.json"])
    log.attachments["run.json"] = json.dumps(run | {"transient_s": 0.5}).encode()


def disagreement_line(log: RunLog) -> str:
    return {line.what: line.figure for line in lines(summarise(log))}["arms disagree on the object by"]


def aligned(apart_m: float, shift_m: float, steps_m: float) -> RunLog:
    """A run of two arms that see the object apart, and readings that step to and fro by so much."""
    log = view_log()
    settled(log)
    right = log.agents["right"]
    right["p_object"][:, 1] += apart_m + steps_m * (-1.0) ** np.arange(len(right))
    right["shift"][:, 1] = shift_m
    return log


def test_arms_without_an_error_have_not_found_together_whatever_the_last_tick_says() -> None:
    """Encoder steps of 0.2 mm and a shift of 0.08 mm: the very last tick would say 0.364 mm to 0.08 or so."""
    log = aligned(1e-4, 8e-5, 2e-4)
    assert summarise(log).arm_disagreement_left_m == pytest.approx(abs(1e-4 - 2e-4 - 8e-5))
    assert disagreement_line(log) == "0.300\xa0mm"
    assert disagreement_line(aligned(5e-3, 4.6e-3, 2e-4)).endswith(
        "; at the end 5.00\xa0mm, and have found together to 0.400\xa0mm"
    )
    assert disagreement_line(aligned(5e-3, -1e-3, 2e-4)) == "5.20\xa0mm", "a shift that makes it worse"


@pytest.mark.parametrize("how", [Mode.HOLD, Mode.FAULT, "struck"])
def test_what_alignment_took_off_is_of_the_time_before_an_arm_holds_fails_or_is_struck(how: Mode | str) -> None:
    log = aligned(5e-3, 4.6e-3, 0.0)
    late = slice(300, None)  # of 400 ticks
    log.agents["right"]["p_object"][late, 1] += 0.05
    if isinstance(how, Mode):
        log.agents["left"]["mode"][late] = how
    else:
        run = prepare(log)
        run = replace(run, info=replace(run.info, struck_s={"left": float(log.agents["left"]["t"][300])}))
        assert found_together(run) == FoundTogether(pytest.approx(5e-3), pytest.approx(4e-4))
        return
    assert disagreement_line(log).endswith("; at the end 5.00\xa0mm, and have found together to 0.400\xa0mm")


def test_nothing_is_said_of_arms_that_held_before_the_transient_was_over_or_never_tracked() -> None:
    log = aligned(5e-3, 4.6e-3, 0.0)
    first = round(200 * (prepare(log).info.transient_s + 0.1))
    log.agents["left"]["mode"][first:] = Mode.HOLD
    assert found_together(prepare(log)) is None
    log.agents["left"]["mode"][:] = Mode.HOLD
    assert found_together(prepare(log)) is None


def test_what_is_left_is_of_both_arms_shifts() -> None:
    log = aligned(5e-3, 2e-3, 0.0)  # left − right: −5 mm seen
    log.agents["left"]["shift"][:, 1] = -1e-3
    assert found_together(prepare(log)) == FoundTogether(pytest.approx(5e-3), pytest.approx(2e-3))


def test_the_mean_is_of_the_last_ticks_on_which_all_arms_track() -> None:
    """Where a disagreement grows from tick to tick, one tick more or less would show."""
    log, ticks = aligned(0.0, 0.0, 0.0), np.arange(400)
    log.agents["right"]["p_object"][:, 1] += 1e-5 * ticks
    log.agents["right"]["shift"][:, 1] = 1e-5 * ticks - 1e-4
    last = 399

    def of_the_ticks_until(last: int) -> FoundTogether:
        return FoundTogether(pytest.approx(1e-5 * (last - (WINDOW - 1) / 2), rel=1e-9), pytest.approx(1e-4))

    run = prepare(log)
    assert found_together(run) == of_the_ticks_until(last)
    assert found_together(struck(run, left=tick_s(run, 300) + 1e-9)) == of_the_ticks_until(300)
    log.agents["left"]["mode"][251:] = Mode.HOLD
    assert found_together(prepare(log)) == of_the_ticks_until(250)


def struck(run: Prepared, **when_s: float) -> Prepared:
    return replace(run, info=replace(run.info, struck_s=when_s))


def tick_s(run: Prepared, tick: int) -> float:
    return float(run.whole["left"]["t"][tick])


def test_ticks_are_paired_by_their_instant_and_one_that_an_arm_lacks_does_not_count() -> None:
    log = aligned(0.0, 0.0, 0.0)
    log.agents["right"]["p_object"][:, 1] += 1e-5 * np.arange(400)
    log.agents["right"]["shift"][:, 1] = 1e-5 * np.arange(400) - 1e-4
    log.agents["right"] = log.agents["right"][np.arange(400) != 380]
    kept = [tick for tick in range(400 - WINDOW, 400) if tick != 380]
    assert found_together(prepare(log)) == FoundTogether(
        pytest.approx(1e-5 * float(np.mean(kept)), rel=1e-9), pytest.approx(1e-4)
    )


def test_arms_without_an_instant_in_common_say_nothing_and_hinder_no_others() -> None:
    """The second of the two lost its rows of those 0.2 s, but for the last, which the first one lost."""
    log = aligned(5e-3, 4.6e-3, 0.0)
    log.agents["left"] = log.agents["left"][:399]
    gone = np.arange(400)
    log.agents["right"] = log.agents["right"][(gone < 399 - WINDOW) | (gone == 399)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert found_together(prepare(log)) is None


def test_a_disagreement_that_is_taken_off_by_more_than_it_scatters_is_said_and_by_less_is_not() -> None:
    """Steps of ± 0.2 mm scatter by 0.2 mm (rms), however many ticks there are."""
    assert found_together(prepare(aligned(5e-3, 0.25e-3, 2e-4))) is not None
    assert found_together(prepare(aligned(5e-3, 0.15e-3, 2e-4))) is None
    assert found_together(prepare(aligned(0.0, 0.0, 0.0))) is None


def test_a_first_tick_is_enough_to_have_begun_and_what_follows_its_end_does_not_count() -> None:
    log = aligned(5e-3, 4.6e-3, 0.0)
    log.agents["left"]["mode"][:120] = Mode.READY
    log.agents["left"]["mode"][121:130] = Mode.HOLD
    assert found_together(prepare(log)) is None


def test_an_arm_that_was_struck_before_it_tracked_says_nothing() -> None:
    run = prepare(aligned(5e-3, 4.6e-3, 0.0))
    assert found_together(struck(run, left=-1.0)) is None


def test_the_transient_may_be_over_with_the_first_of_those_ticks() -> None:
    log = aligned(5e-3, 4.6e-3, 0.0)
    last = round((0.5 + WINDOW_S) * RATE_HZ)
    log.agents["left"]["mode"][last + 1 :] = Mode.HOLD
    assert found_together(prepare(log)) == FoundTogether(pytest.approx(5e-3), pytest.approx(4e-4))
    log.agents["left"]["mode"][last:] = Mode.HOLD
    assert found_together(prepare(log)) is None
