"""The command line. Commands import heavy packages themselves, so that --help is instant."""

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
    help="Measure the accuracy and the speed of rigid-body engines, and detect changes in them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> None:
    """Run the command line; on wrong input, print a message to standard error and exit with status 2."""
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


@app.command(short_help="Run scenarios on engines and measure them.")
def run(
    scenarios: Scenarios = None,
    engine: Annotated[
        str | None,
        typer.Option(
            help="Engines to run, as NAME[==VERSION][:METHOD],...", show_default="every installed engine"
        ),
    ] = None,
    dt: Annotated[
        str | None,
        typer.Option(
            help="Step sizes in s of the fixed-step methods, like 1e-2,1e-3.", show_default="each scenario's"
        ),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            help="Error tolerances of the adaptive methods, like 1e-6,1e-9.", show_default="each method's"
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="New or empty folder for the results.", show_default="bodycheck-runs/RUN_ID"),
    ] = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    no_speed: NoSpeed = False,
    fresh: Fresh = None,
    allow_code: AllowCode = False,
    resume: Annotated[
        Path | None,
        typer.Option(
            help="Continue the interrupted run of this --out folder with its original settings; cannot be "
            "combined with other options."
        ),
    ] = None,
) -> None:
    """Run scenarios on engines, and write results.csv, methods.csv, trajectories/ and report.html."""
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
            raise InputError(
                "--resume: continues a run with its original settings; cannot be combined with other options"
            )
        measured, report = go_on(resume, LiveProgress)
    else:
        measured, report = run_to_folder(asked, out, LiveProgress)
    print_summary(measured)
    print(report)


@app.command(short_help="Print the true motion and its error bound.")
def truth(
    scenario: Annotated[str, typer.Argument(help="A built-in scenario or a .toml file.")],
    at: Annotated[str, typer.Option(help="Times in s, like 0,1,10.")],
    allow_code: AllowCode = False,
) -> None:
    """Print the true motion at the given times as CSV.

    The last column, bound_rad, bounds the orientation error of the truth.
    """
    from bodycheck.reports.render.progress import watched
    from bodycheck.reports.run_files.trajectory_files import trajectory_table
    from bodycheck.runs import runner

    with watched(f"solving the truth of {scenario}"):
        solved = runner.truth(scenario, numbers(at, "--at") or [], allow_code=allow_code)
    table = trajectory_table(solved.trajectory)
    table["bound_rad"] = solved.bound_rad
    _print_csv(table)


@app.command(short_help="Measure a trajectory from any program.")
def judge(
    trajectory: Annotated[Path, typer.Argument(help="A trajectory from any program: .csv or .npz.")],
    scenario: Annotated[str, typer.Option(help="A built-in scenario or a .toml file.")],
    allow_code: AllowCode = False,
) -> None:
    """Measure a trajectory against the truth of a scenario, and print one measure per line."""
    from bodycheck.runs import runner

    columns = runner.judge(trajectory, scenario, allow_code=allow_code)
    width = max(len(name) for name in columns)
    for name, value in columns.items():
        print(f"{name:{width}}  {value}")


@app.command(short_help="Print mass, centre of mass and inertia of a solid.")
def body(
    solid: Annotated[
        str,
        typer.Argument(
            help="A closed mesh (.stl, .obj, .ply), a shape (box, torus, ...), or package.module:function, "
            "called as f(points) -> values with points (n, 3) in m and values (n,); f <= 0 is inside."
        ),
    ],
    density_kg_m3: Annotated[float, typer.Option(help="Density in kg/m^3.")],
    size_m: Annotated[
        str | None, typer.Option(help="Dimensions of a shape in m, like 1.0,0.3; required for a shape.")
    ] = None,
    box_m: Annotated[
        str | None,
        typer.Option(
            help="Box that encloses f <= 0: xmin,ymin,zmin,xmax,ymax,zmax in m; required for a function."
        ),
    ] = None,
    unit: Annotated[
        Literal["mm", "cm", "m", "in"] | None,
        typer.Option(help="Length unit of a mesh file.", show_default="m"),
    ] = None,
    overlap: Annotated[
        Literal["refuse", "count-twice"] | None,
        typer.Option(
            help="What to do if closed parts of a mesh intersect or contain each other: refuse the mesh, or "
            "count the shared volume once per part.",
            show_default="refuse",
        ),
    ] = None,
    monte_carlo: Annotated[
        bool,
        typer.Option(
            "--monte-carlo",
            help="Estimate a torus or an ellipsoid by randomised quasi-Monte Carlo, as for a function, "
            "instead of computing it exactly.",
        ),
    ] = False,
    allow_code: Annotated[
        bool, typer.Option("--allow-code", help="Allow importing the function, which runs its module's code.")
    ] = False,
) -> None:
    """Print mass, centre of mass and inertia tensor of a solid as TOML.

    Meshes and shapes are exact to round-off and come with principal axes, estimates with standard errors.
    """
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
    """List the available scenarios, suites, engines, methods or measures."""
    from bodycheck.reports.summary.catalogue import print_catalogue

    print_catalogue(what)


app.add_typer(gating)
app.add_typer(questions)
app.add_typer(nightly)
app.add_typer(versioning)
app.add_typer(environment_commands, name="environments")


def _print_csv(table: pd.DataFrame) -> None:
    """Write a table to standard output; tolerate a reader that closes the pipe early."""
    try:
        table.to_csv(sys.stdout, index=False)
    except BrokenPipeError:
        sys.stderr.close()
