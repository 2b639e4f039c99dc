"""The documents of `--json`: what check, tune, compare and run found, under keys that keep their meaning.

`schema` grows when a key changes its meaning; keys may be added.  SI units stand in the names; null is not measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from pathlib import Path

    from agent.config.cell import Cell
    from agent.process.run import RunOutcome
    from agent.report.compare import Difference
    from agent.report.shown import ComparedRun
    from agent.verify.check import CheckReport
    from agent.verify.tune import GainSet, Margin, Proposal

SCHEMA: Final = 1


def check_document(cell: Cell, report: CheckReport) -> dict[str, Any]:
    """Every finding, the gravest verdict, the start configurations, and what reality may make of the cell."""
    from agent.report.quantity import json_ready
    from agent.verify.finding import worst

    return {
        **_head(cell),
        "verdict": worst(report.findings).value,
        "findings": [finding.document() for finding in report.findings],
        "q_start_rad": {arm.name: q.tolist() for arm, q in zip(cell.arms, report.q_start, strict=True)},
        "robustness": None if report.robustness is None else json_ready(report.robustness.document()),
    }


def tune_document(
    configured: GainSet, proposals: Sequence[Proposal], chosen: Proposal, margin: Margin, written: Path | None
) -> dict[str, Any]:
    """The gains of the file and of each proposal, and which proposal is taken."""
    from agent.report.quantity import json_ready

    document = {
        **_head(configured.cell),
        "rate_hz": configured.cell.file.rate_hz,
        "margin": {"radius": margin.radius, "damping": margin.damping, "worst": margin.worst},
        "configured": _gains(configured),
        "proposals": {p.form.value: _gains(p.after) | {"changes": _changes(p)} for p in proposals},
        "chosen": chosen.form.value,
        "began": "usual" if chosen.from_usual else "configured",
        "written": None if written is None else str(written),
    }
    ready: dict[str, Any] = json_ready(document)
    return ready


def compare_document(runs: Sequence[ComparedRun]) -> dict[str, Any]:
    """Every figure of the first two logs and what became of it from a to b; of more runs the values, held against a."""
    from agent.report.compare import compare
    from agent.report.quantity import json_ready
    from agent.report.settings import different

    first = runs[0].results
    others = [{d.name: d for d in compare(first, run.results)} for run in runs[1:]]
    names = dict.fromkeys(name for found in others for name in found)
    document = {
        "schema": SCHEMA,
        "a": _run(runs[0]),
        "b": _run(runs[1]),
        "runs": [_run(run) for run in runs],
        "figures": [_compared(name, [found.get(name) for found in others]) for name in names],
        "settings": [{"key": s.key, "values": list(s.values)} for s in different([run.settings for run in runs])],
    }
    ready: dict[str, Any] = json_ready(document)
    return ready


def _compared(name: str, found: Sequence[Difference | None]) -> dict[str, Any]:
    known = next(d for d in found if d is not None)
    a, b = known.a, found[0]
    first = "same" if math.isfinite(a) else "unknown"
    return {
        "name": name,
        "unit": known.unit,
        "a": a,
        "b": b.b if b else None,
        "relative": b.relative if b else None,
        "change": b.change.name.lower() if b else "unknown",
        "values": [a, *(d.b if d else None for d in found)],
        "changes": [first, *(d.change.name.lower() if d else "unknown" for d in found)],
    }


def run_document(outcome: RunOutcome) -> dict[str, Any]:
    """Where everything lies, how the run ended, and the content of results.json."""
    return {
        "schema": SCHEMA,
        "log": str(outcome.log),
        "report": None if outcome.report is None else str(outcome.report),
        "interrupted": outcome.interrupted,
        "gave_up": outcome.gave_up or None,
        "within_bounds": outcome.within_bounds,
        "results": outcome.results.to_json(),
    }


def _head(cell: Cell) -> dict[str, Any]:
    return {"schema": SCHEMA, "cell": cell.file.name, "fingerprint": cell.fingerprint}


def _run(run: ComparedRun) -> dict[str, Any]:
    info = run.results.info
    return {
        "log": str(run.log),
        "cell": info.cell,
        "fingerprint": info.fingerprint,
        "driver": info.driver,
        "rate_hz": info.rate_hz,
    }


def _gains(gains: GainSet) -> dict[str, Any]:
    """Gains in the order x, y, z, and what the sampled loop makes of them."""
    from agent.verify.proposed import OBSERVER_KEYS

    common, seen = gains.gains, gains.observer
    return {
        "k_p_per_s": common.k_p,
        "k_p_rate_per_s": common.k_p_rate,
        "k_eps_rad_per_s": common.k_eps,
        "k_eps_rate_rad_per_s": common.k_eps_rate,
        "observer": None if seen is None else {key: getattr(seen, key) for key in OBSERVER_KEYS},
        "arms": {
            arm.name: {"k_v_N_s_per_m": k_v[:3], "k_v_Nm_s_per_rad": k_v[3:], "torque_noise_Nm": noise}
            for arm, k_v, noise in zip(
                gains.cell.arms,
                (gains.cell.offline(a).gains.k_v for a in gains.cell.arms),
                gains.noise_Nm,
                strict=True,
            )
        },
        "loop": [
            {"inertia_error": error, "spectral_radius": d.radius, "damping_ratio": d.ratio}
            for error, d in gains.damping.items()
        ],
        "slowest_time_constant_s": gains.slowest_s,
        "worst_spectral_radius": gains.criterion.radius,
        "delay_margin_s": gains.criterion.delay_margin_s,
    }


def _changes(proposal: Proposal) -> list[dict[str, Any]]:
    import tomllib

    return [
        {
            "table": change.table,
            "name": change.name,
            "key": change.key,
            "value": tomllib.loads(f"value = {change.toml}")["value"],
        }
        for change in proposal.changes
    ]
