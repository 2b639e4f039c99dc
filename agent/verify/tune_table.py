"""What `coop tune` shows: configured gains and the proposals side by side, and lines to paste."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from rich.table import Table

from agent.config import observer
from agent.config.cell import Cell
from agent.verify.proposed import OBSERVER_KEYS
from agent.verify.tune import GainSet, Proposal


def tune_table(configured: GainSet, proposals: Sequence[Proposal]) -> Table:
    """One row per gain and per property of the loop, one column per set of gains."""
    file = configured.cell.file
    table = Table(
        title=f"{file.name} at {file.rate_hz:g} Hz, {file.delay_s * 1e3:.3g} ms delay",
        title_justify="left",
    )
    table.add_column("")
    table.add_column("configured")
    for proposal in proposals:
        table.add_column(f"--form {proposal.form.value}")
    sets = [configured, *(p.after for p in proposals)]
    for label, value in _rows(configured.cell):
        table.add_row(label, *(value(s) for s in sets))
    return table


def toml_lines(proposal: Proposal) -> str:
    """The changed keys under their headers, ready to paste."""
    lines: list[str] = []
    for change in proposal.changes:
        header = f"[{change.table}]" if change.name is None else f"[[{change.table}]] # {change.name}"
        if header not in lines:
            lines.append(header)
        lines.append(f"{change.key} = {change.toml}")
    return "\n".join(lines)


def _rows(cell: Cell) -> list[tuple[str, Callable[[GainSet], str]]]:
    rows: list[tuple[str, Callable[[GainSet], str]]] = [
        ("k_p_per_s", lambda s: _numbers(s.gains.k_p)),
        ("k_p_rate_per_s", lambda s: _numbers(s.gains.k_p_rate)),
        ("k_eps_rad_per_s", lambda s: _numbers(s.gains.k_eps)),
        ("k_eps_rate_rad_per_s", lambda s: _numbers(s.gains.k_eps_rate)),
    ]
    for i, arm in enumerate(cell.arms):
        rows += [
            (f"k_v_N_s_per_m, {arm.name}", lambda s, i=i: _numbers(_k_v(s, i)[:3])),  # type: ignore[misc]
            (f"k_v_Nm_s_per_rad, {arm.name}", lambda s, i=i: _numbers(_k_v(s, i)[3:])),  # type: ignore[misc]
        ]
    if observer.build(cell.file) is not None:
        rows += [(f"observer, {key}", lambda s, key=key: f"{getattr(s.observer, key):g}") for key in OBSERVER_KEYS]  # type: ignore[misc]
    error = cell.inertia_error
    for e in dict.fromkeys((0.0, -error, error)):
        what = "" if e == 0.0 else f", arms' inertia {e:+.0%}"
        rows += [
            (f"spectral radius{what}", lambda s, e=e: _judged(s.damping[e].radius, s.damping[e].radius < 1.0)),  # type: ignore[misc]
            (f"least damping ratio{what}", lambda s, e=e: _judged(s.damping[e].ratio, s.damping[e].ratio > 0.0)),  # type: ignore[misc]
        ]
    rows.append(
        ("largest radius that reality may make", lambda s: _judged(s.criterion.radius, s.criterion.radius < 1.0))
    )
    rows.append(("longest delay that all survives", lambda s: _delay(s.criterion.delay_margin_s)))
    rows.append(("slowest mode, time constant", lambda s: "—" if math.isinf(s.slowest_s) else f"{s.slowest_s:.2f} s"))
    rows.append(("torque noise of the encoders' grids, rms", lambda s: f"{max(s.noise_Nm):.3f} N·m"))
    return rows


def _k_v(gains: GainSet, arm: int) -> tuple[float, ...]:
    return gains.cell.offline(gains.cell.arms[arm]).gains.k_v


def _numbers(values: Sequence[float]) -> str:
    return f"{values[0]:g}" if len(set(values)) == 1 else ", ".join(f"{v:g}" for v in values)


def _delay(margin_s: float | None) -> str:
    return "[red]none[/]" if margin_s is None else f"{margin_s * 1e3:.3g} ms"


def _judged(value: float, stable: bool) -> str:
    return f"{value:.4g}" if stable else f"[red]{value:.4g}[/]"
