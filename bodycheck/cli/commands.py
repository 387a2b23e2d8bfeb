"""The command line. Heavy imports happen inside the commands, so that --help is instant."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli._app import carry_out
from bodycheck.cli.gate_command import gating
from bodycheck.cli.nightly import nightly
from bodycheck.cli.options import AllowCode, Fresh, Jobs, NoSpeed, Scenarios, TimeoutS, numbers
from bodycheck.cli.stored_runs import questions
from bodycheck.cli.versions_command import environment_commands, versioning
from bodycheck.runs.run_options import TIMEOUT_S

if TYPE_CHECKING:
    import pandas as pd

app = typer.Typer(
    name="bodycheck",
    help="Tells whether a rigid-body engine is right, how right at what speed, and whether that changed.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> None:
    """Run the command line; wrong input ends with status 2 and its message on standard error."""
    carry_out(app, "bodycheck")


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"bodycheck {version('bodycheck')}")
        raise typer.Exit


@app.callback()
def _before_any_command(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version.")
    ] = False,
) -> None: ...


@app.command(short_help="Measure scenarios through engines.")
def run(
    scenarios: Scenarios = None,
    engine: Annotated[
        str | None,
        typer.Option(help="NAME[==VERSION][:METHOD],...; every engine that is installed, unless told."),
    ] = None,
    dt: Annotated[
        str | None, typer.Option(help="Steps in s, like 1e-2,1e-3; each scenario's own, unless told.")
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(help="Of the methods that are told one, like 1e-6,1e-9; their own, unless told."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="A new folder for the results.", show_default="bodycheck-runs/RUN_ID")
    ] = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    no_speed: NoSpeed = False,
    fresh: Fresh = None,
    allow_code: AllowCode = False,
    resume: Annotated[
        Path | None, typer.Option(help="The --out of a run that was stopped: go on with it, as it was asked.")
    ] = None,
) -> None:
    """Measure scenarios through engines: results.csv, methods.csv, trajectories/, report.html."""
    from bodycheck.reports.render.progress import LiveProgress
    from bodycheck.reports.render.terminal import print_summary
    from bodycheck.runs.directory import RunRequest, run_to_folder
    from bodycheck.runs.directory import resume as go_on

    asked = RunRequest(
        scenarios=scenarios or ["standard"],
        engines=None if engine is None else engine.split(","),
        dt_s=numbers(dt, "--dt"),
        tolerances=numbers(tolerance, "--tolerance"),
        speed=not no_speed,
        jobs=jobs,
        timeout_s=timeout_s,
        fresh=fresh,
        allow_code=allow_code,
    )
    if resume is not None:
        if asked != RunRequest() or out is not None:
            raise InputError("--resume goes on with a run as it was asked: give nothing beside it")
        measured, report = go_on(resume, LiveProgress)
    else:
        measured, report = run_to_folder(asked, out, LiveProgress)
    print_summary(measured)
    print(report)


@app.command(short_help="Print the true motion, with its bound.")
def truth(
    scenario: Annotated[str, typer.Argument(help="A built-in name or a .toml file.")],
    at: Annotated[str, typer.Option(help="Times in s, like 0,1,10.")],
    allow_code: AllowCode = False,
) -> None:
    """Print the truth at the times given as CSV; the last column bounds the orientation's error."""
    from bodycheck.reports.render.progress import watched
    from bodycheck.reports.run_files.trajectory_files import trajectory_table
    from bodycheck.runs import runner

    with watched(f"solving the truth of {scenario}"):
        solved = runner.truth(scenario, numbers(at, "--at") or [], allow_code=allow_code)
    table = trajectory_table(solved.trajectory)
    table["bound_rad"] = solved.bound_rad
    _print_csv(table)


@app.command(short_help="Measure a trajectory that any program wrote.")
def judge(
    trajectory: Annotated[Path, typer.Argument(help="A trajectory that any program wrote: .csv or .npz.")],
    scenario: Annotated[str, typer.Option(help="A built-in name or a .toml file.")],
    allow_code: AllowCode = False,
) -> None:
    """Measure a trajectory against the truth of a scenario; prints one measure a line."""
    from bodycheck.runs import runner

    columns = runner.judge(trajectory, scenario, allow_code=allow_code)
    width = max(len(name) for name in columns)
    for name, value in columns.items():
        print(f"{name:{width}}  {value}")


@app.command(short_help="Print mass, centre and inertia of a solid.")
def body(
    solid: Annotated[
        str,
        typer.Argument(
            help="A closed mesh (.stl, .obj, .ply), a shape (box, torus, ...), "
            "or package.module:function, f <= 0 inside."
        ),
    ],
    density_kg_m3: Annotated[float, typer.Option(help="Density in kg/m^3.")],
    size_m: Annotated[str | None, typer.Option(help="The sizes of a shape in m, like 1.0,0.3.")] = None,
    box_m: Annotated[
        str | None, typer.Option(help="A box around f <= 0: xmin,ymin,zmin,xmax,ymax,zmax in m.")
    ] = None,
    unit: Annotated[
        Literal["mm", "cm", "m", "in"] | None,
        typer.Option(help="The unit of the lengths in a mesh file.", show_default="m"),
    ] = None,
    overlap: Annotated[
        Literal["refuse", "count-twice"] | None,
        typer.Option(
            help="Closed parts of a mesh that cross or lie within each other: refuse the mesh, or count the "
            "matter that they share as often as it is drawn.",
            show_default="refuse",
        ),
    ] = None,
    monte_carlo: Annotated[
        bool, typer.Option("--monte-carlo", help="Estimate a torus or an ellipsoid all the same.")
    ] = False,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Let a function be imported.")] = False,
) -> None:
    """Print mass, centre and inertia tensor as TOML: exact with principal axes, or with standard errors."""
    from bodycheck.scenarios.solids import SolidRequest, as_toml, mass_properties

    size, box = numbers(size_m, "--size-m"), numbers(box_m, "--box-m")
    asked = SolidRequest(solid, density_kg_m3, size, box, monte_carlo, allow_code, unit, overlap)
    for line in as_toml(mass_properties(asked)):
        print(line)


@app.command(name="list")
def list_(
    what: Annotated[
        Literal["scenarios", "suites", "engines", "methods", "measures"], typer.Argument(help="What to list.")
    ],
) -> None:
    """List what there is to choose from."""
    from bodycheck.reports.summary.catalogue import print_catalogue

    print_catalogue(what)


app.add_typer(gating)
app.add_typer(questions)
app.add_typer(nightly)
app.add_typer(versioning)
app.add_typer(environment_commands, name="environments")


def _print_csv(table: pd.DataFrame) -> None:
    """Write a table to standard output; a reader that has seen enough may close it."""
    try:
        table.to_csv(sys.stdout, index=False)
    except BrokenPipeError:
        sys.stderr.close()
