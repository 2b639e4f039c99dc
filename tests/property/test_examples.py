"""Hypothesis takes the same examples in every run: none depends on what other tests have loaded."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st


def drawn() -> list[tuple[int, float, str]]:
    """The examples of one test."""
    found = []

    @given(st.integers(), st.floats(allow_nan=False), st.text())
    def note(number: int, share: float, text: str) -> None:
        found.append((number, share, text))

    note()
    return found


def test_examples_stay_when_another_module_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = drawn()
    (tmp_path / "loaded_later.py").write_text("NUMBERS = (987654321987, 0.123456, 'loaded later')")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("loaded_later")
    assert drawn() == before
