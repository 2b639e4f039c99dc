"""A value of a ready line comes back as it was, whatever is in it, and a plain one is read as it stands."""

from __future__ import annotations

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.host.ready_line import READY, pairs, values_of


@given(st.dictionaries(st.sampled_from(["ring", "socket", "page"]), st.binary(max_size=40).map(os.fsdecode)))
def test_what_is_said_is_what_is_heard_in_one_line_of_plain_letters(values: dict[str, str]) -> None:
    line = READY + pairs(**values)
    assert values_of(line) == values
    assert len(line.split()) == 1 + len(values)
    assert line.isascii()
    assert line.isprintable()


def test_plain_values_are_said_as_they_are() -> None:
    plain = {"ring": "/run/coop/paper/left.ring", "endpoint": "tcp/[::1]:7447", "page": "http://a:1/?b=c&d#e"}
    assert pairs(**plain) == " ".join(f"{key}={value}" for key, value in plain.items())


def test_a_line_of_another_kind_is_no_ready_line() -> None:
    with pytest.raises(ValueError, match="TELLS"):
        values_of("TELLS ring=a")
