"""What telemetry and the recorder do with their typed commands, whoever started them; each loads what it needs."""

from __future__ import annotations

from typing import Final

from agent.config.schema.driver import DriverKind
from agent.host.signals import begin
from agent.host.starting import ready
from agent.log.lacking import missing
from agent.process.commands import RecordCommand, TelemetryCommand
from agent.process.started import Listener

INCOMPLETE: Final = 1  # exit code: done, and rows are missing


def telemetry(command: TelemetryCommand, listener: Listener) -> int:
    """One ring over Zenoh."""
    from agent.host.paths import ring_path
    from agent.process.telemetry import run_telemetry
    from agent.telemetry.link.session import Network

    requested = begin(command.with_parent, at_once=command.at_once)
    member, config = command.member, command.network_config
    cell, fingerprint, joints = _of_cell(command)
    report = run_telemetry(
        cell,
        fingerprint,
        member,
        command.ring or ring_path(cell, member),
        Network(config_file=config) if config else Network(connect=(command.connect,)),
        joints=joints,
        lockstep=command.lockstep,
        follow=command.follow,
        fresh=command.ring is None,  # where every run of the cell has its ring
        stop=requested,
        ready=ready,
        say=lambda text: listener.say(f"{member}: {text}"),
    )
    listener.say(
        f"{member}: {report.rows_written} rows, {report.rows_lost} lost in the ring"
        + (f", which was cut to {report.cut}" if report.cut else "")
        + f", {report.rows_unrecorded} not confirmed by the recorder"
        + (f", whose log has ended: {report.unrecorded_why}" if report.unrecorded_why else "")
    )
    return _code(command, whole=not (report.rows_lost or report.rows_unrecorded))


def _code(command: TelemetryCommand | RecordCommand, *, whole: bool) -> int:
    """1 where rows are missing; 0 of a process of a run, whose report says so from the log."""
    return 0 if whole or command.with_parent is not None else INCOMPLETE


def _of_cell(command: TelemetryCommand) -> tuple[str, str, tuple[str, ...] | None]:
    """Name and fingerprint of the cell, which has this member, and the member's joints; None in a run, which knows."""
    if command.cell_name is not None and command.fingerprint is not None:
        return command.cell_name, command.fingerprint, None
    from agent.config.files import load_files
    from agent.telemetry.row.topics import PLANT

    files, joints = load_files(command.cell), tuple[str, ...]()
    if command.member != PLANT:
        arm = files.arms[files.index(command.member)]  # refuses a member that the cell does not have
        joints = tuple(arm.entry.controlled)
    return files.file.name, files.fingerprint, joints


def record(command: RecordCommand, listener: Listener) -> int:
    """Everything that the cell publishes into one log, or one after the other."""
    from agent.atomic import make_folder
    from agent.config.files import load_files
    from agent.host.paths import log_path
    from agent.log.file import require_no_log
    from agent.log.parts import Limits
    from agent.process.recorder import described, run_recorder
    from agent.telemetry.link.session import Network

    requested, config = begin(command.with_parent, at_once=command.at_once), command.network_config
    files = load_files(command.cell)
    kind = command.driver if command.driver is not None else files.file.driver
    known = None if command.run_info is None else command.run_info.read_bytes()
    if command.out is None:
        make_folder(command.out_dir)
    else:
        require_no_log(command.out)
    report = run_recorder(
        files,
        command.out if command.out is not None else log_path(command.out_dir, files.file.name),
        Network(config_file=config) if config else Network(listen=command.listen),
        known if known is not None else described(command.cell, kind, command.seed),
        has_plant=command.truth or kind is DriverKind.SIM,
        limits=Limits(_bytes(command.split_mb), command.split_s, _bytes(command.keep_mb)),
        alone=known is None,
        stop=requested,
        ready=ready,
        ended=lambda log, why: listener.alert(f"{log}: the log ENDS HERE: {why}; the arms go on without it"),
    )
    for mended in report.repaired:
        kept = f", the damaged original is kept as {mended.original}" if mended.original is not None else ""
        listener.say(f"repaired {mended.path}{kept}")
    for error in report.not_repaired:
        listener.say(f"not repaired: {error}")
    for path in report.logs[1:]:
        listener.say(f"went on in {path}")
    for key, count in report.completeness.items():
        if key.startswith("rejected."):
            listener.say(f"left out {count} messages: {key.removeprefix('rejected.').replace('_', ' ')}")
    if report.complete:
        listener.say(f"{report.path}: complete")
    else:
        why = report.failure or "; ".join(missing(report.completeness)) or "an earlier one of its logs says what"
        listener.say(f"{report.logs[-1]}: INCOMPLETE: {why}")
    return 4 if report.failure else _code(command, whole=report.complete)


def _bytes(megabytes: int | None) -> int | None:
    return None if megabytes is None else megabytes << 20
