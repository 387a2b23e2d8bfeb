"""Help as plain text: commands and options in groups, examples at the end."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup

MEASURE, ASK, WATCH = "Measure", "Query stored runs", "Detect changes"
ADAPTERS = "Add an engine"
"""The groups of commands."""

WHAT, HOW, OUTPUT = "What to run", "How to run", "Output"
"""The groups of options."""


def described(group: str, *examples: str) -> dict[str, Any]:
    """Return the keyword arguments that put a command into a group and give it examples."""
    return {"cls": Command, "rich_help_panel": group, "epilog": "\n".join(examples)}


class Command(TyperCommand):
    """A command whose help has its options in groups, and its examples."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, then the options of each group."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                kind = (
                    "Arguments" if parameter.param_type_name == "argument" else _group(parameter, "Options")
                )
                groups.setdefault(kind, []).append(record)
        _write(formatter, groups, last="Options")

    def format_epilog(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002 - click's signature
        """Write one example per line."""
        if self.epilog:
            with formatter.section("Examples"):
                for example in self.epilog.split("\n"):
                    formatter.write(f"{'':{formatter.current_indent}}{example}\n")


class Group(TyperGroup):
    """Commands whose help has them in groups."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands of each group with their one-line descriptions."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                line = command.short_help or command.get_short_help_str(formatter.width)
                groups.setdefault(_group(command, "Commands"), []).append((name, line))
        _write(formatter, groups, last="Commands")


def _group(of: Any, default: str) -> str:
    panel = getattr(of, "rich_help_panel", None)
    return panel if isinstance(panel, str) else default


def _write(formatter: Any, groups: dict[str, list[tuple[str, str]]], last: str) -> None:
    known = ("Arguments", WHAT, HOW, OUTPUT, *groups)
    for name in sorted(groups, key=lambda name: (name == last, known.index(name))):
        with formatter.section(name):
            formatter.write_dl(groups[name])
