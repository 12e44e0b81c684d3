"""Pages of help: commands by group, examples as they are typed."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup

from scenarios.cli.examples import examples_text
from scenarios.commands.failures import Stopped

WHOLE = 1000  # characters: a line too long for the terminal is folded, not cut


class GroupedCommands(TyperGroup):
    """Lists the commands under the headings of their groups (the command-line library asks for a class here)."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write one section a group, in the order in which the commands were declared."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            panel = getattr(command, "rich_help_panel", None)
            groups.setdefault(panel if isinstance(panel, str) else "Commands", []).append((name, command.get_short_help_str(WHOLE)))
        for group, rows in groups.items():
            with formatter.section(group):
                formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; Ctrl-C leaves with what it says is kept."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stopped:
            raise Stopped(str(stopped)) from None


class WithExamples(TyperCommand):
    """A command whose help ends with examples, each on a line of its own however long it is."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples as they stand."""
        text = examples_text(self.name or "")
        if text:
            formatter.write_paragraph()
            formatter.write(f"{text}\n")
