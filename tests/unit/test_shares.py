"""How tests are dealt out to workers: each once, files whole, what waits at the head of half of the shares."""

from __future__ import annotations

import pytest

from tests.support.shares import dealt

WAITING = [f"{file}{k}" for file in "ABCDE" for k in range(3)]
OTHERS = [f"{file}{k}" for file in "xyz" for k in range(30)]


def order(tests: list[str], workers: int) -> list[str]:
    return dealt(tests, workers, str.isupper, lambda test: test[0])


@pytest.mark.parametrize("workers", [1, 2, 3, 4, 7])
def test_each_test_is_dealt_once_and_files_stay_together(workers: int) -> None:
    tests = [*WAITING, *OTHERS]
    found = order(tests, workers)
    assert sorted(found) == sorted(tests)
    assert [test for test in found if not test.isupper()] == OTHERS
    for file in "ABCDE":
        at = found.index(f"{file}0")
        assert found[at : at + 3] == [f"{file}{k}" for k in range(3)]


def test_half_of_the_workers_begin_with_what_waits() -> None:
    found, share = order([*OTHERS, *WAITING], 4), len(OTHERS + WAITING) // 4
    assert found[:9] == [f"{file}{k}" for file in "ACE" for k in range(3)]
    assert found[share : share + 6] == [f"{file}{k}" for file in "BD" for k in range(3)]
    assert [k for k, test in enumerate(found) if test.isupper()] == [*range(9), *range(share, share + 6)]


def test_one_worker_keeps_the_order() -> None:
    assert order([*OTHERS, *WAITING], 1) == [*OTHERS, *WAITING]


def test_more_of_what_waits_than_a_share_holds_is_dealt_all_the_same() -> None:
    assert sorted(order([*WAITING, "x0"], 6)) == sorted([*WAITING, "x0"])
