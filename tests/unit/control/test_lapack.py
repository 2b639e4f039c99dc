"""LAPACK without scipy.linalg around it: the same functions in whichever order both are imported, and a way back."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from agent.control import lapack


def python(code: str) -> None:
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_neither_the_control_law_nor_a_motion_through_poses_loads_more_of_scipy() -> None:
    python(
        "import sys, agent.control.known, configs\n"
        "from agent.config.cell import load_cell\n"
        "load_cell(configs.CELLS_DIR / 'three_wx250s.toml').trajectory()\n"
        "loaded = sorted(m for m in sys.modules if m.startswith('scipy'))\n"
        "assert loaded == ['scipy.linalg._flapack'], loaded"
    )


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("from agent.control import lapack as ours", "from scipy.linalg import lapack as theirs"),
        ("from scipy.linalg import lapack as theirs", "from agent.control import lapack as ours"),
    ],
)
def test_both_ways_give_the_same_functions(first: str, second: str) -> None:
    python(
        f"{first}\n{second}\nimport numpy as np, scipy.linalg\n"
        "for name in ('dgesv', 'dposv', 'dpbtrf', 'dpbsv'):\n"
        "    assert getattr(ours, name) is getattr(theirs, name), name\n"
        "A = np.array([[2.0, 1.0], [0.0, 4.0]])\n"
        "assert np.allclose(scipy.linalg.inv(A) @ A, np.eye(2))"
    )


@pytest.mark.parametrize("trouble", ["not there", "other routines", "cannot be loaded"])
def test_where_the_extension_is_otherwise_scipy_is_asked(monkeypatch: pytest.MonkeyPatch, trouble: str) -> None:
    def extension() -> object:
        if trouble == "cannot be loaded":
            raise ImportError
        return None if trouble == "not there" else object()

    monkeypatch.setattr(lapack, "_extension", extension)
    for name in [m for m in sys.modules if m == "scipy.linalg"]:
        monkeypatch.delitem(sys.modules, name)
    found = lapack._module()
    assert found.__name__ == "scipy.linalg.lapack"
    *_, inverse, info = found.dgesv(np.array([[2.0, 1.0], [0.0, 4.0]]), np.eye(2))
    assert info == 0
    np.testing.assert_allclose(inverse, [[0.5, -0.125], [0.0, 0.25]])


def test_where_scipy_is_loaded_already_it_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    import scipy.linalg

    monkeypatch.setattr(lapack, "_extension", lambda: pytest.fail("loaded twice"))
    assert lapack._module() is scipy.linalg.lapack


def test_a_scipy_without_the_file_is_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lapack, "find_spec", lambda _: None)
    assert lapack._extension() is None
