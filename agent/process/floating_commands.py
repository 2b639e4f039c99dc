"""The typed commands of the processes of `coop float`, and where these meet."""

from __future__ import annotations

from pathlib import Path

from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.host.info import CELL_FILE, RUN_FILE
from agent.host.paths import control_in, emulated_port_in, guard_in, ring_in
from agent.process.commands import AgentCommand, EmulateCommand, GuardCommand, RecordCommand, TelemetryCommand
from agent.process.describe import run_info
from agent.process.floating_cell import FloatOptions, port_for
from agent.process.folder import LOG_NAME
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.row.topics import PLANT
from drivers.clock import utc_offset_ns


class FloatCommands:
    """What each process is told; cell and run are described in files of the folder `runtime`, which all share."""

    def __init__(self, cell: Cell, options: FloatOptions, out: Path, runtime: Path) -> None:
        self._cell, self._options, self._out, self._runtime = cell, options, out, runtime
        self._cell_path, self._run_info_path = runtime / CELL_FILE, runtime / RUN_FILE
        self._cell_path.write_bytes(cell.toml)
        self._run_info_path.write_bytes(run_info(cell, DriverKind.DYNAMIXEL, seed=0))
        self._utc_offset_ns = utc_offset_ns()  # one for all arms: the wall clock may be set between starts

    def record(self) -> RecordCommand:
        """The recorder."""
        return RecordCommand(
            cell=self._cell_path, out=self._out / LOG_NAME, listen=FREE_PORT, driver=DriverKind.DYNAMIXEL,
            truth=False, seed=0, run_info=self._run_info_path,
        )  # fmt: skip

    def emulate(self) -> EmulateCommand:
        """Emulated servos of all arms."""
        return EmulateCommand(
            cell=self._cell_path, ports=self._runtime, ring=self.ring(PLANT), faults=None, seed=0,
            utc_offset_ns=self._utc_offset_ns,
        )  # fmt: skip

    def agent(self, name: str) -> AgentCommand:
        """The process of one arm."""
        return AgentCommand(
            cell=self._cell_path, arm=name, ring=self.ring(name), control=self.control(name),
            driver=DriverKind.DYNAMIXEL, port=self._port(name), emulated=self._options.emulate,
            priority=self._options.priority, guard=guard_in(self._runtime, name),
            allow_no_realtime=self._options.no_realtime, utc_offset_ns=self._utc_offset_ns,
        )  # fmt: skip

    def guard(self, name: str) -> GuardCommand:
        """Its guard."""
        return GuardCommand(
            cell=self._cell_path, arm=name, socket=guard_in(self._runtime, name),
            control=self.control(name), post_mortem=self._out, driver=DriverKind.DYNAMIXEL,
            port=self._port(name), emulated=self._options.emulate, priority=self._options.priority,
        )  # fmt: skip

    def _port(self, name: str) -> str:
        if self._options.emulate:
            return str(emulated_port_in(self._runtime, name))
        return port_for(self._cell, self._options, name)

    def telemetry(self, name: str, endpoint: str) -> TelemetryCommand:
        """Its telemetry; endpoint: the recorder's."""
        return TelemetryCommand(
            cell=self._cell_path, member=name, ring=self.ring(name), connect=endpoint, lockstep=False,
            cell_name=self._cell.file.name, fingerprint=self._cell.fingerprint,
        )  # fmt: skip

    def control(self, name: str) -> Path:
        """The socket where an arm that moves is told to."""
        return control_in(self._runtime, name)

    def ring(self, name: str) -> Path:
        """Rows of an arm or of the plant."""
        return ring_in(self._runtime, name)
