"""How tests are dealt out to workers: each once, files whole, what waits or builds something at the head of shares."""

from __future__ import annotations

import pytest

from tests.support.shares import dealt

WAITING = [f"{file}{k}" for file in "ABCDE" for k in range(3)]
BUILDING = [f"{file}{k}" for file in "mno" for k in range(4)]
OTHERS = [f"{file}{k}" for file in "xyz" for k in range(30)]


def order(tests: list[str], workers: int) -> list[str]:
    return dealt(tests, workers, str.isupper, lambda test: test[0] in "mno", lambda test: test[0])


@pytest.mark.parametrize("workers", [1, 2, 3, 4, 7])
def test_each_test_is_dealt_once_and_files_stay_together(workers: int) -> None:
    tests = [*WAITING, *BUILDING, *OTHERS]
    found = order(tests, workers)
    assert sorted(found) == sorted(tests)
    assert [test for test in found if test[0] in "xyz"] == OTHERS
    for whole in (WAITING, BUILDING):
        for file, count in {test[0]: sum(other[0] == test[0] for other in whole) for test in whole}.items():
            at = found.index(f"{file}0")
            assert found[at : at + count] == [f"{file}{k}" for k in range(count)]


def test_half_of_the_workers_begin_with_what_waits() -> None:
    found, share = order([*OTHERS, *WAITING], 4), len(OTHERS + WAITING) // 4
    assert found[:9] == [f"{file}{k}" for file in "ACE" for k in range(3)]
    assert found[share : share + 6] == [f"{file}{k}" for file in "BD" for k in range(3)]
    assert [k for k, test in enumerate(found) if test.isupper()] == [*range(9), *range(share, share + 6)]


def test_the_other_half_begins_with_what_builds_something() -> None:
    found, share = order([*OTHERS, *WAITING, *BUILDING], 4), len(OTHERS + WAITING + BUILDING) // 4
    assert found[2 * share : 2 * share + 8] == [f"{file}{k}" for file in "mo" for k in range(4)]
    at = found.index("n0")
    assert at == 2 * share + (len(found) - 2 * share) // 2
    assert found[at : at + 4] == [f"n{k}" for k in range(4)]


def test_one_worker_keeps_the_order() -> None:
    assert order([*OTHERS, *WAITING], 1) == [*OTHERS, *WAITING]


def test_more_of_what_waits_than_a_share_holds_is_dealt_all_the_same() -> None:
    assert sorted(order([*WAITING, "x0"], 6)) == sorted([*WAITING, "x0"])
