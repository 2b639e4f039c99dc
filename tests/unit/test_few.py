"""Of cases that state the same some are in `make test`, and none is lost."""

from __future__ import annotations

from tests.support.few import few, long


def test_what_is_not_kept_is_marked_long_and_every_case_is_there() -> None:
    cases = few(("a", "b", "c"), "b".__eq__)
    assert cases[1] == "b"
    assert [case.values for case in (cases[0], cases[2])] == [("a",), ("c",)]
    assert all([mark.name for mark in case.marks] == ["long"] for case in (cases[0], cases[2]))


def test_a_tuple_is_several_parameters() -> None:
    assert few([(1, "x")], lambda _: True) == [(1, "x")]
    assert long((1, "x")).values == (1, "x")
