"""The tables of a TOML text, remembered: what one reader does to them is nothing to the next."""

from __future__ import annotations

import tomllib

import pytest

from agent.config import tables as module
from agent.config.tables import LARGEST_REMEMBERED, says, tables

TEXT = 'a = 1\n[table]\nlist = [{ name = "x" }, 2.5]\n'


def test_what_a_reader_changes_is_not_seen_by_the_next() -> None:
    first = tables(TEXT)
    assert first == tomllib.loads(TEXT)
    first["table"]["list"][0]["name"] = "y"
    first["table"]["list"].append(3)
    first["a"] = 2
    assert tables(TEXT) == tomllib.loads(TEXT)


def test_a_text_is_parsed_once() -> None:
    module._remembered.cache_clear()
    for _ in range(3):
        tables(TEXT)
    assert module._remembered.cache_info().misses == 1


def test_a_text_says_its_own_document_and_no_other() -> None:
    for text in (TEXT, TEXT + "#" * LARGEST_REMEMBERED):
        assert says(text, tomllib.loads(TEXT))
        assert not says(text, tables("a = 1"))
        with pytest.raises(tomllib.TOMLDecodeError):
            says(text + "\na = 2\na = 3\n=", {})


def test_a_long_text_is_not_kept() -> None:
    module._remembered.cache_clear()
    assert tables("#" * LARGEST_REMEMBERED + "\na = 1") == {"a": 1}
    assert module._remembered.cache_info().currsize == 0


@pytest.mark.parametrize("text", ["a = ", "a = 1\na = 2", "[" * 10_000])
def test_what_is_no_toml_is_refused_each_time_as_tomllib_refuses_it(text: str) -> None:
    for _ in range(2):
        with pytest.raises((ValueError, RecursionError)):
            tables(text)


def test_what_is_deep_but_toml_is_the_same_document() -> None:
    deep = "a = " + "[" * 60 + "]" * 60
    assert tables(deep) == tomllib.loads(deep)
