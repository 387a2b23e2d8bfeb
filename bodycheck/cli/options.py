"""Options shared by several commands, their completion, the parsing of their values, help as plain text."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.thresholds import Thresholds

if TYPE_CHECKING:
    from bodycheck.reports.alerts import Alert
    from bodycheck.reports.document import Document
    from bodycheck.runs.run_options import ProgressFactory


MEASURE, ASK, WATCH = "Measure", "Query stored runs", "Detect changes"
ADAPTERS = "Add an engine"
"""The groups of commands."""

WHAT, HOW, OUTPUT = "What to run", "How to run", "Output"
"""The groups of options."""


def described(group: str, *examples: str) -> dict[str, Any]:
    """Return the keyword arguments that put a command into a group and give it examples."""
    return {"cls": Command, "rich_help_panel": group, "epilog": "\n".join(examples)}


_ENGINES = ("engine", "against")
"""The parameters of commands that name engines."""


class Command(TyperCommand):
    """A command whose help has its options in groups, and its examples; it refuses repeated options."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; an option with one value must not be given twice: the first would be lost."""
        if ctx.resilient_parsing:  # as for completion
            return list(super().parse_args(ctx, args))
        _, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for option, times in Counter(order).items():
            if times > 1 and isinstance(option, TyperOption) and not (option.multiple or option.is_flag):
                ctx.fail(f"{option.opts[0]}: given {times} times; separate several values by commas")
        return list(super().parse_args(ctx, args))

    def invoke(self, ctx: Any) -> Any:
        """Call the command, which may start the programs that the user names as engines."""
        named = [word for key in _ENGINES for word in str(ctx.params.get(key) or "").split(",")]
        if any(word.startswith("cmd:") for word in named):
            from bodycheck.adapters.engine_names import admit  # imports pydantic

            admit(named, allow_code=True)
        return super().invoke(ctx)

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


def complete_scenarios(incomplete: str) -> list[tuple[str, str]]:
    """Return the built-in scenarios and suites with their descriptions, and the .toml files."""
    from bodycheck.scenarios.library import scenario_summaries, suites

    names = [*scenario_summaries().items(), *((name, "suite") for name in suites())]
    folder = Path(incomplete).parent if "/" in incomplete else Path()
    files = [(str(path), "file") for path in sorted(folder.glob("*.toml"))] if folder.is_dir() else []
    return [(name, about) for name, about in (*names, *files) if name.startswith(incomplete)]


def complete_tables(incomplete: str) -> list[str]:
    """Return the tables of a run."""
    from bodycheck.reports.run_files.tables import TABLES

    return [name for name in TABLES if name.startswith(incomplete)]


def complete_engines(incomplete: str) -> list[str]:
    """Return the words that complete the last of NAME[:METHOD],...: engines, then an engine's methods."""
    first, comma, last = incomplete.rpartition(",")
    return [f"{first}{comma}{word}" for word in _engine_words(last) if word.startswith(last)]


def _engine_words(incomplete: str) -> Iterator[str]:
    from bodycheck.adapters.registry import engine_names

    engine, colon, _ = incomplete.partition(":")
    if not colon:
        yield from engine_names()
        return
    for method in methods_of(engine):
        yield f"{engine}:{method}"


def methods_of(engine: str) -> tuple[str, ...]:
    """Return the methods of an engine; none for an unknown or unavailable one.

    Those of an optional engine are what its adapter states: completion installs nothing.
    """
    from bodycheck.adapters.contract import Engine
    from bodycheck.adapters.registry import engine_names, optional_engines, stated_by
    from bodycheck.adapters.workers.engine_pool import announced

    if engine in optional_engines():
        return tuple(stated_by(engine).methods)
    if engine not in engine_names():
        return ()
    found = announced([engine])[engine]
    return tuple(found.methods) if isinstance(found, Engine) else ()


def _positive_seconds(value: float) -> float:
    if not 0.0 < value < math.inf:
        raise InputError(f"--timeout-s {value}: must be a positive number of seconds")
    return value


Scenarios: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        help="Built-in scenarios, suites or .toml files.",
        show_default="standard",
        autocompletion=complete_scenarios,
    ),
]
Scenario: TypeAlias = Annotated[
    str, typer.Option(help="A built-in scenario or a .toml file.", autocompletion=complete_scenarios)
]


def engine_option(purpose: str, default: str | bool) -> Any:
    """Return the option --engine of a command; purpose: what it does with the engines."""
    return typer.Option(
        "--engine",
        help=f"{purpose}, as NAME[==VERSION][:METHOD],... or cmd:COMMAND.",
        show_default=default,
        rich_help_panel=WHAT,
        autocompletion=complete_engines,
    )


def steps_option(default: str) -> Any:
    """Return the option --dt of a command that takes several steps."""
    return typer.Option(
        "--dt",
        help="Step sizes in s of fixed-step methods, like 1e-2,1e-3.",
        show_default=default,
        rich_help_panel=WHAT,
    )


def folder_option(purpose: str, default: str | bool) -> Any:
    """Return the option --out of a command; purpose: what the folder is for."""
    return typer.Option(
        "--out", help=f"New or empty folder {purpose}.", show_default=default, rich_help_panel=OUTPUT
    )


Engines: TypeAlias = Annotated[str | None, engine_option("Engines to run", "every installed engine")]
Jobs: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Number of cases to run in parallel.", show_default="one per core", rich_help_panel=HOW
    ),
]
TimeoutS: TypeAlias = Annotated[
    float,
    typer.Option(
        help="Time limit of one case in s.",
        callback=_positive_seconds,
        rich_help_panel=HOW,
    ),
]
Fresh: TypeAlias = Annotated[
    bool | None,
    typer.Option(
        "--fresh/--reuse",
        help="Run every case again, or reuse results of earlier runs by the same build of an engine.  "
        "[default: --fresh for gate; --reuse for run and versions, but --fresh for plug-ins and editable "
        "installs]",
        show_default=False,
        rich_help_panel=HOW,
    ),
]
ShardOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--shard",
        metavar="K/N",
        help="Run part K of N, chosen by a hash, like 3/8; `bodycheck merge` combines the parts.",
        show_default="the whole run",
        rich_help_panel=HOW,
    ),
]
NoSpeed: TypeAlias = Annotated[
    bool, typer.Option("--no-speed", help="Do not measure CPU time.", rich_help_panel=HOW)
]
Commit: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="ID",
        help="The commit of the engine that is measured; changes are reported with their range of commits.",
        show_default="that of the environment of GitHub Actions, GitLab CI, ...",
        rich_help_panel=HOW,
    ),
]
Threshold: TypeAlias = Annotated[
    float,
    typer.Option(
        help="Relative change above which a measure is worse or improved; a smaller change is moved."
    ),
]
ThresholdsFile: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--thresholds",
        metavar="FILE",
        help="TOML file with [[change]] tables: thresholds of individual measures.",
    ),
]
AllowCode: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--allow-code",
        help="Allow files to name code that runs: programs, and functions f(t, position, R, velocity, omega) "
        "-> force, torque in scenarios; R is (3, 3), t a number, the others (3,).",
        rich_help_panel=HOW,
    ),
]
EnginesFile: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="TOML file that gives programs names for --engine, see docs/workers.md; needs --allow-code.",
        show_default="none",
        rich_help_panel=HOW,
    ),
]
Json: TypeAlias = Annotated[
    bool,
    typer.Option("--json", help="Print the answer as JSON, in full precision.", rich_help_panel=OUTPUT),
]
Quiet: TypeAlias = Annotated[
    bool,
    typer.Option("--quiet", "-q", help="Do not show progress on standard error.", rich_help_panel=OUTPUT),
]
OutFolder: TypeAlias = Annotated[
    Path | None, folder_option("for the results", "a new one in bodycheck-runs/")
]
PartFolder: TypeAlias = Annotated[Path | None, folder_option("for the shard, with --shard", False)]


def _file(option: str, what: str) -> Any:
    return typer.Option(option, metavar="FILE", help=f"Write {what} to this file.", rich_help_panel=OUTPUT)


HtmlFile: TypeAlias = Annotated[Path | None, _file("--html", "a page")]
MarkdownFile: TypeAlias = Annotated[Path | None, _file("--markdown", "a summary in Markdown")]
BadgeFile: TypeAlias = Annotated[Path | None, _file("--badge", "a badge for img.shields.io/endpoint")]
JunitFile: TypeAlias = Annotated[Path | None, _file("--junit", "the results as JUnit XML")]
SarifFile: TypeAlias = Annotated[Path | None, _file("--sarif", "the findings as SARIF")]
SvgFile: TypeAlias = Annotated[Path | None, _file("--svg", "the picture as SVG")]
PdfFile: TypeAlias = Annotated[Path | None, _file("--pdf", "the picture as PDF")]
PngFile: TypeAlias = Annotated[Path | None, _file("--png", "the picture as PNG")]
GifFile: TypeAlias = Annotated[Path | None, _file("--gif", "the animation as GIF")]
Mp4File: TypeAlias = Annotated[Path | None, _file("--mp4", "the animation as MP4")]
Github: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--github",
        help="Print annotations of GitHub Actions, and append the answer to the summary of the job.",
        rich_help_panel=OUTPUT,
    ),
]
Files: TypeAlias = Mapping[str, Path | None]
"""The files that options name, by format: the name of the option without its dashes."""


def admit_engines(file: Path | None, *, allow_code: bool) -> None:
    """Let the programs of the file of --engines start; raises InputError if it is wrong or not allowed."""
    if file is not None:
        from bodycheck.adapters.engine_names import admit_file  # imports pydantic

        admit_file(file, allow_code=allow_code)


def numbers(text: str | None, option: str) -> list[float] | None:
    """Parse a comma-separated list of numbers; None if there is no list.

    Raises InputError, which names the option, for a word that is not a number.
    """
    if text is None:
        return None
    found = []
    for word in text.split(","):
        try:
            found.append(float(word))
        except ValueError:
            raise InputError(
                f"{option} {text}: {word.strip()!r} is not a number (expected numbers like 1e-2,1e-3)"
            ) from None
    return found


def refuse_others(context: typer.Context, reason: str, applicable: Collection[str]) -> None:
    """Raise InputError for the first given option or argument that is not applicable; reason: why."""
    for parameter in context.command.params:
        name = str(parameter.name)
        source = context.get_parameter_source(name)
        if name not in applicable and source is not None and source.name == "COMMANDLINE":
            negated = parameter.secondary_opts and context.params[name] is False
            written = (parameter.secondary_opts if negated else parameter.opts)[0]
            shown = written if isinstance(parameter, TyperOption) else written.upper()
            raise InputError(f"{reason}; {shown} does not apply")


def thresholds_of(threshold: float, file: Path | None) -> Thresholds:
    """Return the thresholds of all measures; raises InputError if the option or the file is wrong."""
    if not 0.0 <= threshold < math.inf:
        raise InputError(f"--threshold {threshold}: must be 0 or more, like 0.02 for 2 %")
    if file is None:
        return Thresholds(threshold)
    from bodycheck.reports.gates.gate import read_thresholds  # imports pydantic

    return read_thresholds(file, threshold)


def progress_of(*, quiet: bool, label: str = "") -> ProgressFactory:
    """Return what shows the progress of a run, with a label before each phase."""
    if quiet:
        from bodycheck.runs.run_options import no_progress

        return no_progress
    from bodycheck.reports.render.progress import LiveProgress

    return lambda cases_listed: LiveProgress(cases_listed, label)


def tell_github(alerts: Sequence[Alert], title: str, document: Document, *, as_json: bool) -> None:
    """Print alerts as annotations, on standard error where standard output is JSON, and add the summary."""
    from bodycheck.reports.alerts import add_job_summary, github_commands

    for line in github_commands(alerts, title):
        print(line, file=sys.stderr if as_json else sys.stdout)
    add_job_summary(document)


def check_files(files: Files) -> None:
    """Raise InputError for a file that cannot be written; call it before a long computation."""
    from bodycheck._util.files import check_file

    for format_name, path in files.items():
        check_file(f"--{format_name}", path)


def write_files(files: Files, contents: Mapping[str, Callable[[Path], str | bytes]]) -> None:
    """Write each file that is named; contents: format -> function path -> content."""
    from bodycheck._util.files import write_file

    for format_name, path in files.items():
        if path is not None:
            content = contents[format_name](path)
            write_file(path, content.encode() if isinstance(content, str) else content)
