"""Which cores the processes of a run keep to."""

from __future__ import annotations

import pytest

from agent.host.share import share_out


@pytest.mark.parametrize(
    ("arms", "allowed", "expected"),
    [
        (2, {0}, [{0}, {0}]),
        (2, {3, 5, 7, 9}, [{3}, {5}]),
        (3, {0, 1, 2, 3}, [{0}, {1}, {2}]),
        (1, {4, 6}, [{4}]),
        (0, {0, 1}, []),
        (2, {0, 1}, [{1}, {1}]),
        (2, {3, 5}, [{5}, {5}]),
        (3, {0, 1}, [{1}, {1}, {0}]),
        (4, {0, 1}, [{1}, {1}, {1}, {0}]),
        (3, {0, 1, 2}, [{1}, {2}, {1}]),
        (4, {0, 2, 4, 6}, [{2}, {4}, {6}, {2}]),
        (5, {0, 1, 2}, [{1}, {2}, {1}, {2}, {1}]),
    ],
)
def test_arms_keep_to_distinct_cores_where_one_is_to_spare_and_else_to_those_with_the_least_to_do(
    arms: int, allowed: set[int], expected: list[set[int]]
) -> None:
    assert list(share_out(arms, allowed).arms) == expected


@pytest.mark.parametrize(
    ("arms", "allowed", "plant"),
    [(2, {0}, {0}), (2, {0, 1}, {0}), (2, {3, 5}, {3}), (3, {0, 1}, {0}), (4, {0, 2, 4, 6}, {0}), (5, {1, 2}, {1})],
)
def test_without_a_core_to_spare_the_plant_keeps_to_one_and_listeners_to_none(
    arms: int, allowed: set[int], plant: set[int]
) -> None:
    cores = share_out(arms, allowed)
    assert (cores.plant, cores.listeners) == (plant, allowed)


@pytest.mark.parametrize(("arms", "allowed"), [(1, {4, 6}), (2, {3, 5, 7}), (4, {0, 1, 2, 3, 4})])
def test_where_a_core_is_to_spare_plant_and_listeners_are_free(arms: int, allowed: set[int]) -> None:
    cores = share_out(arms, allowed)
    assert cores.plant == cores.listeners == allowed
