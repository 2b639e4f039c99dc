"""The help of a group of commands: each one in full, under headings, in plain text that needs no rich."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

OTHERS = "Commands"


class Commands(TyperGroup):
    """A group of commands; without one on the line it shows its help and ends with the code of a wrong line."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """What is left of the line for a command.  Raises Exit."""
        if not args and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            raise typer.Exit(2)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands by heading (their `rich_help_panel`), no line of them cut."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                heading = getattr(command, "rich_help_panel", None)
                row = (name, " ".join((command.help or "").split()))
                sections.setdefault(heading if isinstance(heading, str) else OTHERS, []).append(row)
        widest = max((len(name) for rows in sections.values() for name, _ in rows), default=0)
        for heading, rows in sections.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(widest), text) for name, text in rows])
