"""Four LAPACK routines of scipy, without the 0.2 s that `import scipy.linalg` costs every process.

The routines are functions of one extension module, which needs nothing of the package around it.  Where it is not
found or is built otherwise, they come by the long way; the functions are the same objects either way.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Final

_NAME: Final = "scipy.linalg._flapack"
_ROUTINES: Final = ("dgesv", "dposv", "dpbtrf", "dpbsv")


def _module() -> ModuleType:
    """A module that has the routines."""
    if "scipy.linalg" not in sys.modules:
        try:
            found = _extension()
        except ImportError:
            found = None
        if found is not None and all(hasattr(found, routine) for routine in _ROUTINES):
            return found
    return import_module("scipy.linalg.lapack")


def _extension() -> ModuleType | None:
    """The extension module alone; None where it is not found.  Raises ImportError."""
    package = find_spec("scipy")  # finds, does not import
    for folder in (package and package.submodule_search_locations) or ():
        for suffix in EXTENSION_SUFFIXES:
            path = Path(folder) / "linalg" / f"_flapack{suffix}"
            spec = spec_from_file_location(_NAME, path) if path.is_file() else None
            if spec is not None and spec.loader is not None:
                module = module_from_spec(spec)
                spec.loader.exec_module(module)
                return module
    return None


_flapack = _module()
dgesv, dposv, dpbtrf, dpbsv = (getattr(_flapack, routine) for routine in _ROUTINES)
