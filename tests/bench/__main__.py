"""`python -m tests.bench`: run every benchmark, each module in a process of its own, and print or write the figures.

A module of this folder takes part when it has `bench() -> dict[str, Figure]`.  It may list the names of its figures
in `NAMES`; then `--only` need not run it to know that none is wanted.
"""

from __future__ import annotations

import argparse
import importlib
import json
import pkgutil
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import pytest
from rich import box
from rich.console import Console
from rich.table import Table

from tests import bench
from tests.bench.common import Figure

NOT_BENCHMARKS = {"__main__", "common"}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description="speed and memory of this project")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="figures or modules to run")
    parser.add_argument("--module", help=argparse.SUPPRESS)  # what the child processes are called with
    options = parser.parse_args()
    if options.module:
        write(run_module(options.module, options.only), options.out)
        return 0
    figures, failed = run_all(options.only)
    Console().print(table(figures))
    if options.out:
        write(figures, options.out)
    for name in failed:
        Console(stderr=True).print(f"benchmark failed: {name}", style="red")
    return 1 if failed else 0


def run_all(only: list[str] | None) -> tuple[dict[str, Figure], list[str]]:
    """Figures of all modules, and the names of the modules that failed; their errors are on stderr already."""
    figures: dict[str, Figure] = {}
    failed = []
    for name in sorted(m.name for m in pkgutil.iter_modules(bench.__path__) if m.name not in NOT_BENCHMARKS):
        Console(stderr=True).print(f"{name} …", style="dim")
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "figures.json"
            command = [sys.executable, "-m", "tests.bench", "--module", name, "--out", str(out)]
            done = subprocess.run([*command, *(["--only", *only] if only else [])], check=False)
            if done.returncode or not out.exists():
                failed.append(name)
                continue
            for key, content in json.loads(out.read_text(encoding="utf-8")).items():
                if key in figures:
                    raise SystemExit(f"two benchmarks call a figure {key}")
                figures[key] = Figure(**content)
    return figures, failed


def run_module(name: str, only: list[str] | None) -> dict[str, Figure]:
    module = importlib.import_module(f"tests.bench.{name}")
    if not hasattr(module, "bench"):
        return {}
    names = getattr(module, "NAMES", None)
    if only and name not in only and names is not None and not set(names) & set(only):
        return {}
    try:
        figures: dict[str, Figure] = module.bench()
    except pytest.skip.Exception as skipped:
        Console(stderr=True).print(f"not measured: {name}: {skipped.msg}", style="yellow")
        return {}
    return {k: f for k, f in figures.items() if not only or name in only or k in only}


def write(figures: dict[str, Figure], path: Path) -> None:
    path.write_text(json.dumps({k: asdict(f) for k, f in figures.items()}, indent=2) + "\n", encoding="utf-8")


def table(figures: dict[str, Figure]) -> Table:
    shown = Table(box=box.SIMPLE_HEAD)
    for heading in ("figure", "value", "unit", "baseline", "ratio"):
        shown.add_column(heading, justify="left" if heading in ("figure", "unit") else "right")
    for name, f in figures.items():
        baseline = "" if f.baseline is None else f"{f.baseline:.4g}"
        shown.add_row(name, f"{f.value:.4g}", f.unit, baseline, "" if f.ratio is None else f"{f.ratio:.3g}")
    return shown


if __name__ == "__main__":
    sys.exit(main())
