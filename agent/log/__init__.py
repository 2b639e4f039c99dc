"""The log of a run: the file, its writer, its readers.  `load("run.mcap")` opens one for analysis."""

from agent.log.run import Rows, Run, load

__all__ = ["Rows", "Run", "load"]
