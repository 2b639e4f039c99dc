"""The command `coop latency-test`: is this host fit to run a control loop, whatever else it does?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import AsJson, note, print_json


def latency_test(
    seconds: Annotated[float, typer.Option(min=1.0, max=1e6, help="How long; five minutes say something.")] = 60.0,
    rate: Annotated[float, typer.Option(min=20.0, max=2000.0, help="Of the loop, Hz.")] = 200.0,
    priority: Annotated[int, typer.Option(min=0, max=99, help="SCHED_FIFO priority, or refuse; 0: a normal one.")] = 80,
    load: Annotated[bool, typer.Option(help="Keep all cores, memory and disk busy meanwhile.")] = True,
    out: Annotated[Path | None, typer.Option(help="Keep the result here instead of in the usual place.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure how late this host wakes a control loop; exit code 0 fit, 1 not.  The doctor and the agents show it.

    A test that is stopped is not kept.
    """
    import contextlib
    import os

    from agent.atomic import make_folder, require_writable
    from agent.host import latency
    from agent.host.realtime import become_realtime, granted, quiet_memory
    from agent.host.signals import StopFlag
    from drivers.clock import MonotonicClock

    stop, clock = StopFlag(), MonotonicClock()
    path = out or latency.own_file(os.environ, os.getuid())
    if out is not None:
        latency.require_own(out)
    make_folder(path.parent)  # before somebody has waited for minutes
    require_writable(path)
    cores = len(os.sched_getaffinity(0))
    with latency.load(cores) if load else contextlib.nullcontext():
        quiet_memory()
        if priority:
            become_realtime(priority, "measure without it: --priority 0")
        real_time = granted()
        note(f"{seconds:g} s at {rate:g} Hz, {real_time.text}, {f'load on {cores} cores' if load else 'no load'}")
        begin_ns = clock.now_ns()
        found = latency.measure(seconds, rate, clock, stop)
        took_s, stopped = 1e-9 * (clock.now_ns() - begin_ns), stop()
    result = latency.finished(took_s, rate, loaded=load, real_time=real_time, histogram=found)
    if not stopped:
        latency.keep(path, result)
    if as_json:
        print_json(result.document())
    else:
        typer.echo(f"{result.fitness(rate)}: {result.text}, {found.missed} cycles missed; wanted ≤ {500.0 / rate:g} ms")
        if not stopped:
            note(f"kept in {path}")
    if stopped:
        typer.echo(f"stopped by request; this result is not kept, and {path} is as it was", err=as_json)
        raise typer.Exit(130)
    raise typer.Exit(0 if result.fitness(rate) is latency.Fitness.FIT else 1)
