"""The commands that read stored runs: compare, advise, explain, report, table, plot, movie."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck.cli.options import (
    ASK,
    OUTPUT,
    WHAT,
    AllowCode,
    EnginesFile,
    Files,
    GifFile,
    Github,
    HtmlFile,
    Json,
    MarkdownFile,
    Mp4File,
    PdfFile,
    PngFile,
    Quiet,
    SvgFile,
    Threshold,
    ThresholdsFile,
    admit_engines,
    check_files,
    complete_scenarios,
    complete_tables,
    described,
    engine_option,
    numbers,
    progress_of,
    refuse_others,
    tell_github,
    thresholds_of,
    write_files,
)
from bodycheck.reports.gates.thresholds import THRESHOLD

if TYPE_CHECKING:
    from bodycheck.reports.comparison.change import Status
    from bodycheck.reports.run_files.run_tables import Tables
    from bodycheck.reports.summary.advice import Advice
    from bodycheck.scenarios.free_body import FreeBody

FAIL_ON: dict[str, tuple[Status, ...]] = {
    "worse": ("worse", "missing"),
    "moved": ("worse", "missing", "moved"),
    "never": (),
}
"""--fail-on -> the statuses of changes for which `compare` exits with status 1."""

_FAILED = 1
_PLOTTED = (".svg", ".pdf", ".png")

stored_run_commands = typer.Typer()

_Run = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]
_OneScenario = Annotated[
    str | None, typer.Option(help="A scenario of the run.", show_default="the only one", rich_help_panel=WHAT)
]
_Drawn = Annotated[str | None, engine_option("What to draw", "all")]
_AllowCode = Annotated[
    bool,
    typer.Option(
        "--allow-code", help="Allow the run's scenarios to import functions, which runs their modules' code."
    ),
]


@stored_run_commands.command(
    short_help="Print what changed between two runs.",
    **described(
        ASK,
        "bodycheck compare before after --fail-on worse --github",
        "bodycheck compare before after --html changes.html --markdown changes.md",
    ),
)
def compare(
    before: Annotated[Path, typer.Argument(metavar="RUN_A", help="Folder of the run before the change.")],
    after: Annotated[Path, typer.Argument(metavar="RUN_B", help="Folder of the run after the change.")],
    fail_on: Annotated[
        Literal["worse", "moved", "never"],
        typer.Option(
            help="When to exit with status 1. worse: if anything is worse or missing; moved: also if "
            "anything moved."
        ),
    ] = "never",
    threshold: Threshold = THRESHOLD,
    thresholds: ThresholdsFile = None,
    github: Github = False,
    html: HtmlFile = None,
    markdown: MarkdownFile = None,
    json: Json = False,
) -> None:
    """Print what changed between two runs: outcomes, verdicts, orders, accuracy, speed.

    A change above the threshold is worse or improved, a smaller one moved; rows that only one run has are
    new or missing. With --fail-on worse or moved, the exit status is also 1 if no case is in both runs.
    """
    from bodycheck.reports.comparison.compare import compare as compared
    from bodycheck.reports.comparison.comparison_document import (
        alerts_of,
        comparison_data,
        comparison_document,
        comparison_page,
    )
    from bodycheck.reports.document import answer
    from bodycheck.reports.document import markdown as as_markdown
    from bodycheck.reports.run_files.run_reader import read_tables

    levels = thresholds_of(threshold, thresholds)
    files = {"html": html, "markdown": markdown}
    check_files(files)
    comparison = compared(read_tables(before), read_tables(after), levels)
    document = comparison_document(comparison)
    answer(document, comparison_data(comparison), as_json=json)
    write_files(
        files,
        {"html": lambda: comparison_page(comparison), "markdown": lambda: as_markdown(document)},
        as_json=json,
    )
    if github:
        alerts = alerts_of(comparison, FAIL_ON[fail_on])
        tell_github(alerts, "bodycheck compare", document, as_json=json)
    nothing = fail_on != "never" and not comparison.paired
    if nothing or comparison.of_status(*FAIL_ON[fail_on]):
        raise typer.Exit(_FAILED)


@stored_run_commands.command(
    short_help="Print the cheapest setting that meets an error tolerance, or the error at a step.",
    **described(
        ASK,
        "bodycheck advise --error 1e-3",
        "bodycheck advise full-tensor --dt 5e-3 --run first",
        "bodycheck advise --mass-kg 0.5 --inertia-kg-m2 2e-3,3e-3,4e-3 --spin-rad-s 20 --error 1e-3",
    ),
)
def advise(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            help="Built-in scenarios, suites or .toml files.",
            show_default="all of the run",
            autocompletion=complete_scenarios,
        ),
    ] = None,
    error: Annotated[
        float | None, typer.Option(help="The error tolerance to meet, like 1e-3.", show_default=False)
    ] = None,
    dt: Annotated[
        float | None,
        typer.Option(
            help="Instead of --error: a step size in s. Prints the error of each method.", show_default=False
        ),
    ] = None,
    measure: Annotated[
        str,
        typer.Option(
            help="The measure that has to meet the tolerance: orientation_error_rad, position_error, "
            "energy_drift, angular_momentum_drift or omega_error."
        ),
    ] = "orientation_error_rad",
    horizon_s: Annotated[
        float | None,
        typer.Option(
            help="Time in s over which the error counts.",
            show_default="that of each scenario; 10 rotations for --mass-kg, rounded up to 1, 2, 5, ... s",
        ),
    ] = None,
    search: Annotated[
        bool,
        typer.Option(
            "--search", help="Run each recommended setting until all of them are measured, not predicted."
        ),
    ] = False,
    every: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Also recommend steps below 1e-5 s and settings slower than real time.",
        ),
    ] = False,
    mass_kg: Annotated[
        float | None,
        typer.Option(help="Instead of scenarios: mass in kg of a free body.", show_default=False),
    ] = None,
    inertia_kg_m2: Annotated[
        str | None,
        typer.Option(
            help="Principal moments of that body in kg m^2, like 0.002,0.003,0.004.", show_default=False
        ),
    ] = None,
    spin_rad_s: Annotated[
        str | None,
        typer.Option(
            help="Its angular velocity in rad/s: three components in body axes, or one number, |omega|, for "
            "three equal components.",
            show_default=False,
        ),
    ] = None,
    torque_body_n_m: Annotated[
        str | None,
        typer.Option(
            help="Constant torque on that body in N m, in body axes, like 0,0,1e-3.", show_default="none"
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also draw error against CPU time, with the tolerance and the setting, as .svg, .pdf or "
            ".png; for a run without speeds, against the step.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    engine: Annotated[str | None, engine_option("Engines to choose from", "all of the run")] = None,
    run: Annotated[
        Path | None,
        typer.Option(
            help="Folder of a run.", show_default="the newest run of these scenarios, else a new run"
        ),
    ] = None,
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print the cheapest engine, method and step size that meet an error tolerance.

    Settings between and beyond the measured steps are predicted from the order. A step is at most one
    sample interval of the scenario. bodycheck's own reference comes after all engines. With --dt instead
    of --error, prints the error of each method at that step.
    """
    from bodycheck.reports.document import answer
    from bodycheck.reports.summary.advice_document import advice_document
    from bodycheck.runs import advice_run

    admit_engines(engines, allow_code=allow_code)
    inertia, spin = numbers(inertia_kg_m2, "--inertia-kg-m2"), numbers(spin_rad_s, "--spin-rad-s")
    request = advice_run.AdviceRequest(
        error=error,
        dt_s=dt,
        measure=measure,
        horizon_s=horizon_s,
        search=search,
        scenarios=tuple(scenarios or ()),
        body=_free_body(mass_kg, inertia, spin, numbers(torque_body_n_m, "--torque-body-n-m")),
        every=every,
        engines=() if engine is None else tuple(name.strip() for name in engine.split(",")),
        run=run,
        allow_code=allow_code,
    )
    _check_plot(plot)
    advice = advice_run.advise(request, progress_of(quiet=quiet))
    answer(advice_document(advice), advice, as_json=json)
    if plot is not None:
        drawn = partial(_drawn_advice, advice, request.engines, plot.suffix)
        write_files({"plot": plot}, {"plot": drawn}, as_json=json)


def _check_plot(plot: Path | None) -> None:
    """Raise InputError or UnavailableError where --plot cannot be drawn."""
    if plot is not None:
        from bodycheck.reports.render.figures import check_drawable

        if plot.suffix not in _PLOTTED:
            raise InputError(f"--plot {plot}: must end with {', '.join(_PLOTTED)}")
        check_drawable("figures")
        check_files({"plot": plot})


def _drawn_advice(advice: Advice, engines: tuple[str, ...], suffix: str) -> bytes:
    """Return a figure of the scenario that limits the answer, with its tolerance."""
    from bodycheck.adapters.engine_names import REFERENCE
    from bodycheck.reports.render.figures import Appearance, picture
    from bodycheck.reports.run_files.run_reader import read_tables

    tables = read_tables(Path(advice.run))
    first = advice.answers[0]
    scenario = first.scenario or (first.options[0].limiting if first.options else advice.answers[1].scenario)
    shown = engines or tuple(name for name in tables.manifest["engines"] if name != REFERENCE)
    figure = "work-precision" if tables.manifest["speed"] and advice.error is not None else "order"
    appearance = Appearance(2, engines=shown, tolerance=advice.error)
    return picture(tables, figure, str(scenario), advice.measure, suffix, appearance)


def _free_body(
    mass_kg: float | None,
    inertia_kg_m2: list[float] | None,
    spin_rad_s: list[float] | None,
    torque_body_n_m: list[float] | None,
) -> FreeBody | None:
    """Return the body of the options; raises InputError where a required one is missing."""
    from bodycheck.scenarios.free_body import FreeBody

    if mass_kg is None and inertia_kg_m2 is None and spin_rad_s is None and torque_body_n_m is None:
        return None
    if mass_kg is None or inertia_kg_m2 is None or spin_rad_s is None:
        raise InputError("a body needs --mass-kg, --inertia-kg-m2 and --spin-rad-s")
    return FreeBody(mass_kg, inertia_kg_m2, spin_rad_s, torque_body_n_m or ())


@stored_run_commands.command(
    short_help="Print the cause of wrong motions, with evidence.",
    **described(
        ASK,
        "bodycheck explain first",
        "bodycheck explain first --case full-tensor,pybullet:multibody@defaults,0.01 --html why.html",
    ),
)
def explain(
    run: _Run,
    case: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO[,ENGINE[:METHOD][,STEP]]",
            help="The cases to explain; patterns are allowed.",
            show_default="one per method and scenario with an unfavourable verdict",
        ),
    ] = None,
    html: HtmlFile = None,
    markdown: MarkdownFile = None,
    svg: SvgFile = None,
    pdf: PdfFile = None,
    png: PngFile = None,
    allow_code: _AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print which fault explains a wrong motion, its fitted parameters, and what would confirm it.

    The reference runs the one-step map of the method with each fault that it knows, alone and in pairs, and
    compares the result with the motion of the engine from sample to sample.
    """
    from bodycheck.examine.explanation.explain import explain_run
    from bodycheck.reports.document import answer
    from bodycheck.reports.document import markdown as as_markdown
    from bodycheck.reports.render.figures import check_drawable
    from bodycheck.reports.render.progress import status_line

    pictures = {"svg": svg, "pdf": pdf, "png": png}
    files = {"html": html, "markdown": markdown, **pictures}
    if any(pictures.values()):
        check_drawable("figures")
    check_files(files)
    with status_line("comparing the motions with each fault", quiet=quiet):
        cases = explain_run(run, case, allow_code=allow_code)
    from bodycheck.examine.explanation import explanation_document as explanations

    document = explanations.explanation_document(cases)
    answer(document, explanations.explanation_data(cases), as_json=json)
    write_files(
        files,
        {
            "html": lambda: explanations.explanation_page(cases),
            "markdown": lambda: as_markdown(document),
            **{kind: partial(explanations.explanation_figure, cases, f".{kind}") for kind in pictures},
        },
        as_json=json,
    )


@stored_run_commands.command(
    short_help="Render the report of a run again.",
    **described(ASK, "bodycheck report first", "bodycheck report first --markdown summary.md"),
)
def report(
    context: typer.Context,
    run: _Run,
    html: HtmlFile = None,
    markdown: MarkdownFile = None,
    allow_code: _AllowCode = False,
) -> None:
    """Render the report.html of a stored run again, or to another file; with --markdown only its summary.

    A run too large for one page has further pages next to it, in the folder report-files.
    """
    from bodycheck.reports.run_files.run_reader import read_run, read_tables

    files = {"html": html, "markdown": markdown}
    if (run / "night.json").exists():
        for path in (html, markdown) if any(files.values()) else (run / "report.html",):
            if path is not None and run.resolve() in path.resolve().parents:
                raise InputError(
                    f"{path}: belongs to a nightly run, which is not changed; "
                    "--html FILE renders its report to another file"
                )
    check_files(files)
    if markdown is not None:
        from bodycheck.reports.document import markdown as as_markdown
        from bodycheck.reports.summary.sentences import run_document

        if html is None:
            refuse_others(context, "--markdown: measures nothing again", ("run", "markdown"))
        write_files({"markdown": markdown}, {"markdown": lambda: as_markdown(run_document(read_tables(run)))})
        if html is None:
            return
    from bodycheck.reports.cache.disk_cache import Cache
    from bodycheck.reports.render.html import report_pages
    from bodycheck.reports.render.progress import status_line
    from bodycheck.reports.run_files.report_files import replace_pages

    page = html or run / "report.html"
    with status_line("measuring the stored motions again"):
        stored = read_run(run, allow_code=allow_code, cache=Cache.default())
        replace_pages(report_pages(stored, page.name), page)
    print(page)


@stored_run_commands.command(
    short_help="Print a table of a run in another format.",
    **described(ASK, "bodycheck table first results --columns engine,method,dt_s --format md"),
)
def table(
    run: _Run,
    which: Annotated[
        str,
        typer.Argument(
            metavar="TABLE",
            help="The table: the name of one of the run's CSV files, without .csv.",
            autocompletion=complete_tables,
        ),
    ] = "results",
    as_: Annotated[
        Literal["csv", "json", "md"], typer.Option("--format", help="Format of the printed table.")
    ] = "csv",
    columns: Annotated[
        str | None, typer.Option(help="Columns to print, like scenario,dt_s.", show_default="all")
    ] = None,
    parquet: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the table as Parquet to this file instead of printing it.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
) -> None:
    """Print a table of a run as CSV, JSON or Markdown, or write it as Parquet."""
    from bodycheck.reports.run_files.run_reader import read_tables
    from bodycheck.reports.run_files.tables import FORMATS, TABLES

    check_files({"parquet": parquet})
    if which not in TABLES:
        raise InputError(f"{which}: no table of a run{suggestion(which, TABLES)}")
    found = getattr(read_tables(run), which)
    if columns is not None:
        requested = [name.strip() for name in columns.split(",")]
        if unknown := [name for name in requested if name not in found.columns]:
            known = suggestion(unknown[0], found.columns)
            raise InputError(f"--columns {columns}: {which} has no {', '.join(unknown)}{known}")
        if len(set(requested)) < len(requested):
            raise InputError(f"--columns {columns}: has a column twice")
        found = found[requested]
    write_files({"parquet": parquet}, {"parquet": lambda: FORMATS["parquet"](found)})
    if parquet is None:
        print(FORMATS[as_](found).decode(), end="")


@stored_run_commands.command(
    short_help="Draw a figure of a run for a paper.",
    **described(ASK, "bodycheck plot first --figure work-precision --svg figure.svg"),
)
def plot(
    run: _Run,
    figure: Annotated[
        Literal["work-precision", "order", "drift", "stability", "polhode", "motion"],
        typer.Option(help="The figure: work-precision, order, drift, stability, polhode or motion."),
    ],
    svg: SvgFile = None,
    pdf: PdfFile = None,
    png: PngFile = None,
    scenario: _OneScenario = None,
    measure: Annotated[
        str | None,
        typer.Option(
            help="The measure to plot: energy_drift, omega_error, ...", show_default="orientation_error_rad"
        ),
    ] = None,
    engine: Annotated[
        str | None, engine_option("What to draw", "the engines; the reference if it is alone")
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Draw the line of this error, and the cheapest setting of an engine that meets it.",
            show_default="none",
        ),
    ] = None,
    label: Annotated[
        list[str] | None,
        typer.Option(metavar="ENGINE:METHOD=TEXT", help="Name a method so. May be given several times."),
    ] = None,
    columns: Annotated[
        int, typer.Option(help="Width in columns of a paper: 1 (3.5 in) or 2 (7.2 in).", min=1, max=2)
    ] = 1,
    style: Annotated[Path | None, typer.Option(help="A matplotlib style file.", show_default="none")] = None,
    allow_code: _AllowCode = False,
) -> None:
    """Draw a figure of one scenario for a paper.

    Error against CPU time, against step size, or over time; stable steps; the polhode; the body at six times.
    """
    from bodycheck.adapters.engine_names import REFERENCE
    from bodycheck.reports.cache.disk_cache import Cache
    from bodycheck.reports.measurement.measures import MEASURES
    from bodycheck.reports.render.figures import (
        BODIES,
        NEED_MOTIONS,
        STABILITY,
        Appearance,
        check_drawable,
        picture,
    )
    from bodycheck.reports.run_files.run_reader import read_run, read_tables

    files = _required("plot", {"svg": svg, "pdf": pdf, "png": png})
    check_drawable("figures")
    check_files(files)
    is_of_body = figure in (STABILITY, *BODIES)
    for option, value in (("--measure", measure), ("--tolerance", tolerance)):
        if value is not None and is_of_body:
            raise InputError(f"{option} {value}: not used by --figure {figure}")
    if measure is not None and measure not in MEASURES:
        raise InputError(f"--measure {measure}: unknown measure{suggestion(measure, MEASURES)}")
    if tolerance is not None and not 0.0 < tolerance < math.inf:
        raise InputError(f"--tolerance {tolerance!r}: must be a positive number")
    labels = dict(_pair(one) for one in label or ())
    tables = read_tables(run)
    scenario = _scenario_of(tables, scenario)
    engines = _engines_of(tables, engine)
    if not engines and figure not in BODIES:
        engines = tuple(name for name in tables.manifest["engines"] if name != REFERENCE)
    appearance = Appearance(columns, style, engines, allow_code, tolerance, labels)
    needs_motions = figure in NEED_MOTIONS
    found = read_run(run, allow_code=allow_code, cache=Cache.default()) if needs_motions else tables
    shown = measure or "orientation_error_rad"
    drawn = {kind: partial(picture, found, figure, scenario, shown, f".{kind}", appearance) for kind in files}
    write_files(files, drawn)


def _pair(text: str) -> tuple[str, str]:
    """Return the method and the text of a --label."""
    name, sign, shown = text.partition("=")
    if not (name and sign and shown):
        raise InputError(f"--label {text}: must be ENGINE:METHOD=TEXT")
    return name, shown


def _required(command: str, files: Files) -> dict[str, Path]:
    """Return the files that are named, by format; raises InputError if there is none."""
    named = {kind: path for kind, path in files.items() if path is not None}
    if not named:
        raise InputError(f"{command}: name a file with {' or '.join(f'--{kind}' for kind in files)}")
    return named


def _scenario_of(tables: Tables, scenario: str | None) -> str:
    """Return the scenario that --scenario names, or the only one; raises InputError if there is none."""
    available = list(tables.manifest["scenarios"])
    if scenario is None and len(available) == 1:
        return available[0]
    if scenario is None or scenario not in available:
        fault = "is required" if scenario is None else f"{scenario}: not in this run"
        raise InputError(f"--scenario {fault}{suggestion(scenario or '', available)}")
    return scenario


def _engines_of(tables: Tables, engine: str | None) -> tuple[str, ...]:
    """Return the engines and methods that --engine names; raises InputError if one is not in the run."""
    from bodycheck.reports.run_files.run_tables import check_engines

    engines = tuple(name.strip() for name in engine.split(",")) if engine else ()
    check_engines(tables, engines)
    return engines


@stored_run_commands.command(
    short_help="Write an animation of the motions of a run.",
    **described(
        ASK,
        "bodycheck movie first --scenario intermediate-axis --gif flip.gif",
        "bodycheck movie first --engine mujoco:euler,dart --dt 0.01 --mp4 flip.mp4",
    ),
)
def movie(
    run: _Run,
    gif: GifFile = None,
    mp4: Mp4File = None,
    svg: SvgFile = None,
    scenario: _OneScenario = None,
    engine: _Drawn = None,
    dt: Annotated[
        float | None,
        typer.Option(help="Step size in s.", show_default="the coarsest that most methods share"),
    ] = None,
    allow_code: _AllowCode = False,
    quiet: Quiet = False,
) -> None:
    """Write an animation of one scenario: the body of each engine, with the truth in grey.

    For each engine, the method farthest from the truth is shown; equal motions are one body with all their
    names. An animation has at most 200 frames, each a stored sample, and lasts about 10 s; MP4 needs ffmpeg
    on the path. An SVG is a strip of six frames.
    """
    from bodycheck.reports.cache.disk_cache import Cache
    from bodycheck.reports.document import print_document
    from bodycheck.reports.render import movie as films
    from bodycheck.reports.render.progress import status_line
    from bodycheck.reports.run_files.run_reader import read_run, read_tables

    files = _required("movie", {"gif": gif, "mp4": mp4, "svg": svg})
    films.check_movie(mp4)
    check_files(files)
    tables = read_tables(run)
    scenario = _scenario_of(tables, scenario)
    engines = _engines_of(tables, engine)
    with status_line("drawing the frames", quiet=quiet):
        found = read_run(run, allow_code=allow_code, cache=Cache.default())
        drawn = {kind: films.movie(found, scenario, f".{kind}", engines, dt) for kind in files}
    print_document(films.movie_document(found, scenario, engines, dt))
    write_files(files, {kind: partial(bytes, film) for kind, film in drawn.items()})
