"""Options shared by several commands, their completion, the parsing of their values, help as plain text."""

from __future__ import annotations

import inspect
import math
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import Field
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args, get_origin

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.runs.request import OptionFacts, Request, options

if TYPE_CHECKING:
    from bodycheck.reports.alerts import Alert
    from bodycheck.reports.document import Document
    from bodycheck.runs.run_progress import ProgressFactory


MEASURE, ASK, WATCH = "Measure", "Query stored runs", "Detect changes"
ADAPTERS, PROJECT = "Add an engine", "Set up a project"
"""The groups of commands."""

WHAT, HOW, OUTPUT = "What to run", "How to run", "Output"
"""The groups of options."""

_WHAT_TO_RUN = ("engines", "dt_s", "tolerances")


def described(group: str, *examples: str) -> dict[str, Any]:
    """Return the keyword arguments that put a command into a group and give it examples."""
    return {"cls": GroupedCommand, "rich_help_panel": group, "epilog": "\n".join(examples)}


_ENGINES = ("engine", "against")
"""The parameters of commands that name engines."""


class GroupedCommand(TyperCommand):
    """A command whose help has its options in groups, and its examples; it refuses repeated options."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; an option with one value must not be given twice: the first would be lost."""
        if ctx.resilient_parsing:  # as for completion
            return list(super().parse_args(ctx, args))
        _, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for option, times in Counter(order).items():
            if times > 1 and isinstance(option, TyperOption) and not (option.multiple or option.is_flag):
                several = (
                    "it takes one" if "," in (option.metavar or "") else "separate several values by commas"
                )
                ctx.fail(f"{option.opts[0]}: given {times} times; {several}")
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


class CommandGroup(TyperGroup):
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


_COMPLETIONS: dict[str, Callable[[str], Any]] = {
    "scenarios": complete_scenarios,
    "engines": complete_engines,
}


def request_words() -> list[str]:
    """Return the names of the parameters of commands for the options of runs."""
    return [words for name, (_, one) in options().items() if (words := _words(name, one))]


def _words(name: str, option: OptionFacts) -> str:
    """Return the name of an option's parameter of a command; "" where it has none."""
    return "scenarios" if name == "scenarios" else option.flag.partition("/")[0].strip("-").replace("-", "_")


def _of_run(name: str) -> Any:
    """Return an option of runs for another command."""
    return _parameter(name, *options()[name]).annotation.__metadata__[0]


def _parameter(name: str, field: Field[Any], option: OptionFacts) -> inspect.Parameter:
    """Return the parameter of a command for an option of runs; many values are one text, with commas."""
    facts: dict[str, Any] = {
        "help": option.about,
        "metavar": option.metavar,
        "autocompletion": _COMPLETIONS.get(option.completion or ""),
    }
    if option.otherwise is not None:
        facts["show_default"] = option.otherwise
    kind, default = field.type, field.default
    if name == "scenarios":
        kind, default, told = list[str] | None, None, typer.Argument(**facts)
    else:
        facts["rich_help_panel"] = WHAT if name in _WHAT_TO_RUN else HOW
        if _is_many(kind):
            kind = str | None
        elif option.flag.startswith("--no-"):
            kind, default = bool, False
            facts["help"] = f"Do not {option.about[0].lower()}{option.about[1:]}"
        elif name == "timeout_s":
            facts["callback"] = _positive_seconds
        elif kind == str | Path | None:
            kind = Path | None
        told = typer.Option(option.flag, **facts)
    return inspect.Parameter(
        _words(name, option),
        inspect.Parameter.POSITIONAL_OR_KEYWORD,
        default=default,
        annotation=Annotated[kind, told],
    )


def _is_many(kind: Any) -> bool:
    return any(get_origin(one) in (Iterable, Sequence) for one in get_args(kind))


def _request(words: Mapping[str, Any], **others: Any) -> Request:
    """Return the request of a command line; others: options that the command decides."""
    given: dict[str, Any] = {}
    for name, value in words.items():
        field, option = options()[name]
        if name == "scenarios":
            given[name] = value or ["standard"]
        elif not _is_many(field.type):
            given[name] = not value if option.flag.startswith("--no-") else value
        elif get_args(get_args(field.type)[0]) == (float,):
            given[name] = numbers(value, option.flag)
        else:
            given[name] = None if value is None else value.split(",")
    return Request(**{**given, **others})


ScenarioOption: TypeAlias = Annotated[
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


Scenarios: TypeAlias = Annotated[list[str] | None, _of_run("scenarios")]
Jobs: TypeAlias = Annotated[int | None, _of_run("jobs")]
TimeoutS: TypeAlias = Annotated[float, _of_run("timeout_s")]
Fresh: TypeAlias = Annotated[bool | None, _of_run("fresh")]
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
AllowCode: TypeAlias = Annotated[bool, _of_run("allow_code")]
EnginesFile: TypeAlias = Annotated[Path | None, _of_run("engines_file")]
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


def takes_request(*left_out: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator: the command takes the options of runs in place of its parameter `request`.

    left_out: the options that it does not take. The programs of --engines are admitted before it is called.
    """
    taken = {name: one for name, one in options().items() if name not in left_out and _words(name, one[1])}

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def with_request(**given: Any) -> None:
            words = {name: given.pop(_words(name, one)) for name, (_, one) in taken.items()}
            admit_engines(words["engines_file"], allow_code=words["allow_code"])
            command(request=partial(_request, words), **given)

        own = inspect.signature(command, eval_str=True)
        derived = [_parameter(name, *one) for name, one in taken.items()]
        kept = [one for one in own.parameters.values() if one.name != "request"]
        before = [one for one in kept if one.default is one.empty]
        signature = [*before, *derived, *(one for one in kept if one not in before)]
        with_request.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
        with_request.__annotations__ = {one.name: one.annotation for one in signature}
        return with_request

    return decorate


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
        from bodycheck.runs.run_progress import no_progress

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


def write_files(
    files: Files, contents: Mapping[str, Callable[[], str | bytes]], *, as_json: bool = False
) -> None:
    """Write each file that is named, and print its path; contents: format -> function that returns it.

    A command calls it after its answer. as_json: that is JSON, after which no path is printed.
    """
    from bodycheck._util.files import write_file

    for format_name, path in files.items():
        if path is not None:
            content = contents[format_name]()
            write_file(path, content.encode() if isinstance(content, str) else content)
            if not as_json:
                print(path)
