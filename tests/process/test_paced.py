"""A test that is `paced` is made again where the machine had no core, with fixtures of its own, and only there."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import stalls

FOLDERS: list[Path] = []


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("paced")


@pytest.mark.paced
def test_what_fails_on_a_machine_without_cores_is_made_again(folder: Path) -> None:
    before, FOLDERS[len(FOLDERS) :] = stalls.SOMEBODY_WAITED, [folder]
    stalls.SOMEBODY_WAITED = -1.0 if len(FOLDERS) == 1 else 0.9  # somebody always waits for longer than that
    assert before == -1.0, "the first time"
    assert len(set(FOLDERS)) == 2
