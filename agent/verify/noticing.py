"""From which unexpected wrench on the arms of a cell they hold, and whether they are looked at before, as findings."""

from __future__ import annotations

from agent.config import noticing
from agent.config.cell import Cell, ConfigError
from agent.config.schema.cell import DriverKind
from agent.monitors.bounds import Name
from agent.monitors.gravity import WINDOW_S, WINDOWS
from agent.verify.finding import Finding, Verdict


def rested(cell: Cell) -> list[Finding]:
    """Whether the torque at rest is looked at before the motion, and where not, why; nothing where nobody is to."""
    file = cell.file
    if Name.GRAVITY in file.safety.monitors.off:
        return []
    what, ready_s, least_s = "torque at rest before the motion", file.simulation.ready_s, WINDOW_S * WINDOWS
    if file.driver is DriverKind.SIM and ready_s < least_s:
        return [
            Finding(what, "cell", f"not looked at: simulated arms are READY for {ready_s:g} s alone", f"{least_s:g} s")
        ]
    return [Finding(what, "cell", "looked at while READY", f"{least_s:g} s")]


def noticed(cell: Cell) -> list[Finding]:
    """The thresholds, derived or given; nothing where `[safety.noticing]` is off."""
    spec = cell.file.safety.noticing
    if not spec.enabled:
        return []
    what = "an arm holds above an unexpected wrench of"
    try:
        x = noticing.thresholds(cell)
    except ConfigError as error:
        return [Finding(what, "cell", str(error.found), str(error.expected), Verdict.REFUSED, error.remedy)]
    given = [spec.fast_N, spec.fast_Nm, spec.slow_N, spec.slow_Nm]
    source = "derived from the cell" if given == [None] * 4 else "given" if None not in given else "partly given"
    pulled = noticing.against(cell)
    along = ""
    if pulled is not None:
        along = f"; {pulled.level_N:g} N down or against the motion, or thrice {pulled.climb_N:g} N against it"
    found = f"{x.fast_N:g} N, {x.fast_Nm:g} N·m at once; {x.slow_N:g} N, {x.slow_Nm:g} N·m that stay{along} ({source})"
    return [Finding(what, "cell", found, "")]
