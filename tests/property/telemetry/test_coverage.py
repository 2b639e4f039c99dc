"""Coverage behaves as a set of numbers."""

from hypothesis import given
from hypothesis import strategies as st

from agent.telemetry.link.coverage import Coverage, count_of

spans = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)).map(lambda p: (p[0], p[0] + p[1])), max_size=20)


def numbers(ranges: list[tuple[int, int]]) -> set[int]:
    return {n for first, last in ranges for n in range(first, last + 1)}


@given(spans, st.integers(0, 80), st.integers(0, 30))
def test_coverage_is_a_set_of_numbers(added: list[tuple[int, int]], probe: int, width: int) -> None:
    coverage, model = Coverage(), set[int]()
    for first, last in added:
        new = coverage.add(first, last)
        assert numbers(new) == set(range(first, last + 1)) - model
        model |= set(range(first, last + 1))
        assert numbers(coverage.ranges) == model
    assert coverage.count == len(model) == count_of(coverage.ranges)
    assert coverage.end == max(model, default=-1) + 1
    assert all(a[1] + 1 < b[0] for a, b in zip(coverage.ranges, coverage.ranges[1:], strict=False))
    assert numbers(coverage.missing(probe, probe + width)) == set(range(probe, probe + width + 1)) - model
    assert Coverage(coverage.ranges).ranges == coverage.ranges
