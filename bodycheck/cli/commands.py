"""The command line. Commands import heavy packages themselves, so that --help is instant."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli._app import run_app
from bodycheck.cli.dynamics_command import dynamics_commands
from bodycheck.cli.engine_commands import adapter_commands, identity_commands
from bodycheck.cli.gate_command import gate_commands
from bodycheck.cli.merge_command import merge_commands
from bodycheck.cli.nightly import nightly
from bodycheck.cli.options import (
    HOW,
    MEASURE,
    OUTPUT,
    WATCH,
    WHAT,
    AllowCode,
    CommandGroup,
    HtmlFile,
    Json,
    OutFolder,
    Quiet,
    check_files,
    complete_scenarios,
    described,
    engine_option,
    numbers,
    progress_of,
    refuse_others,
    takes_request,
    write_files,
)
from bodycheck.cli.project_commands import project_commands
from bodycheck.cli.rooms import rooms
from bodycheck.cli.stored_runs import stored_run_commands
from bodycheck.cli.versions_command import environment_commands, version_commands
from bodycheck.runs.request import Request

if TYPE_CHECKING:
    from bodycheck.scenarios.given_motion import GivenMotion

app = typer.Typer(
    name="bodycheck",
    cls=CommandGroup,
    help="Measure the accuracy and the speed of rigid-body engines, and detect changes in them.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> None:
    """Run the command line; on wrong input, print a message to standard error and exit with status 2."""
    run_app(app, "bodycheck")


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        print(f"bodycheck {version('bodycheck')}")
        raise typer.Exit


_START = """\
bodycheck measures the accuracy and the speed of rigid-body engines.

  bodycheck run smoke                      three scenarios, in seconds
  bodycheck advise tumbling --error 1e-3   the cheapest engine, method and step
  bodycheck doctor                         what works on this machine

bodycheck --help lists all commands.
"""


@app.callback()
def _before_any_command(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001 - its callback acts
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(_START, end="")


@app.command(
    short_help="Run scenarios on engines and measure them.",
    **described(
        MEASURE,
        "bodycheck run intermediate-axis --engine mujoco,dart --out first",
        "bodycheck run smoke my.toml --engine mujoco:rk4 --dt 1e-2,1e-3 --no-speed",
        "bodycheck run --resume first",
    ),
)
@takes_request()
def run(
    context: typer.Context,
    request: Callable[..., Request],
    out: OutFolder = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            help="Continue the interrupted run of this --out folder with its original settings; can be "
            "combined with --json, --quiet, --engines and --allow-code only.",
            rich_help_panel=HOW,
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run scenarios on engines, and write results.csv, methods.csv, trajectories/ and report.html."""
    from bodycheck.adapters.registry import engines_to_install
    from bodycheck.reports.document import answer
    from bodycheck.reports.summary.sentences import run_data, run_document
    from bodycheck.runs.directory import resume as go_on
    from bodycheck.runs.directory import run_to_folder

    make_progress, requested = progress_of(quiet=quiet), request()
    if resume is not None:
        refuse_others(
            context,
            "--resume: continues a run with its original settings",
            ("resume", "json", "quiet", "engines", "allow_code"),
        )
        measured, report = go_on(resume, make_progress, allow_code=requested.allow_code)
    else:
        if requested.engines is None and not quiet and (how := engines_to_install()):
            print(f"no engine is installed, only the reference is measured: {how}", file=sys.stderr)
        measured, report = run_to_folder(requested, out, make_progress)
    answer(run_document(measured), {**run_data(measured), "report": report}, as_json=json)
    if not json:
        print(report)


@app.command(
    short_help="Print the true motion and its error bound.",
    **described(MEASURE, "bodycheck truth intermediate-axis --at 0,1,10"),
)
def truth(
    scenario: Annotated[
        str,
        typer.Argument(help="A built-in scenario or a .toml file.", autocompletion=complete_scenarios),
    ],
    at: Annotated[str, typer.Option(help="Times in s, like 0,1,10.")],
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print the true motion at the given times as CSV.

    The last column, bound_rad, bounds the orientation error of the truth. A tree has the columns
    body.NAME.x_m and so on, joint.NAME.q_rad or q_m, and joint.NAME.rate; then come its bounds.
    """
    from bodycheck.reference_impl.truth.truth import QUANTITIES
    from bodycheck.reports.render.progress import status_line
    from bodycheck.reports.run_files.tables import FORMATS
    from bodycheck.reports.run_files.trajectory_files import trajectory_table, tree_table
    from bodycheck.runs import runner
    from bodycheck.scenarios.library import load_one
    from bodycheck.scenarios.model import Scenario

    with status_line(f"solving the truth of {scenario}", quiet=quiet):
        solved = runner.truth(scenario, numbers(at, "--at") or [], allow_code=allow_code)
    found = load_one(scenario, allow_code=allow_code)
    if isinstance(found, Scenario):
        table = trajectory_table(solved.trajectory).assign(bound_rad=solved.bound_rad)
    else:
        table = tree_table(found.scene, solved.trajectory)
        table = table.assign(**{f"bound_{name}": getattr(solved, f"bound_{name}") for name in QUANTITIES})
    sys.stdout.write(FORMATS["json" if json else "csv"](table).decode())


@app.command(
    short_help="Judge trajectories from any program.",
    **described(
        MEASURE,
        "bodycheck judge sim.csv --inertia-kg-m2 40,60,85 --html sim.html",
        "bodycheck judge motion.csv --scenario symmetric-top --dt 0.01",
        "bodycheck judge Atmos_02_sim_05.csv --like nesc",
        "bodycheck judge log.csv --scenario top.toml --map 't_s=time, wx_body_rad_s=p*deg, ignore=*'",
        "bodycheck judge a.csv b.csv c.csv d.csv --scenario boxes --dt 8e-3,4e-3,2e-3,1e-3",
    ),
)
def judge(
    trajectories: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRAJECTORY...",
            help="Trajectories from any program: tables of text, .npz, .parquet, .jsonl, .mcap or .aem.",
        ),
    ],
    scenario: Annotated[
        str | None,
        typer.Option(
            help="A built-in scenario or a .toml file.",
            show_default="the one that --like knows for the file",
            autocompletion=complete_scenarios,
            rich_help_panel=WHAT,
        ),
    ] = None,
    inertia_kg_m2: Annotated[
        str | None,
        typer.Option(
            help="Instead of a scenario: the principal moments in kg m^2 of a body that starts at the first "
            "row, like 40,60,85, or the 9 numbers of its tensor.",
            show_default=False,
            rich_help_panel=WHAT,
        ),
    ] = None,
    mass_kg: Annotated[
        float | None,
        typer.Option(help="Mass of that body in kg.", show_default="1", rich_help_panel=WHAT),
    ] = None,
    torque_body_n_m: Annotated[
        str | None,
        typer.Option(
            help="Constant torque on it in N m, in body axes, like 0,0,0.1.",
            show_default="none",
            rich_help_panel=WHAT,
        ),
    ] = None,
    gravity: Annotated[
        str | None,
        typer.Option(
            help="Its gravity in m/s^2, in world axes, like 0,0,-9.81.",
            show_default="none",
            rich_help_panel=WHAT,
        ),
    ] = None,
    map_: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="PAIRS",
            help="What the columns are: KEY=VALUE, ..., each quantity a product of a column, numbers and "
            "units, or a .toml file of these. May be given several times.",
            show_default="the columns of docs/recordings.md",
            rich_help_panel=HOW,
        ),
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            help="Use the map of a known source: aem, euroc, jsbsim, kitti, mcap, nesc or tum.",
            show_default="none",
            rich_help_panel=HOW,
        ),
    ] = None,
    dt: Annotated[
        str | None,
        typer.Option(
            help="The step of each file in s, like 1e-2,5e-3; from four files on, orders are fitted.",
            show_default="none",
            rich_help_panel=HOW,
        ),
    ] = None,
    start: Annotated[
        Literal["scenario", "first-sample"] | None,
        typer.Option(
            help="Where the truth starts: at the start of the scenario, or at the first sample.",
            show_default="scenario",
            rich_help_panel=HOW,
        ),
    ] = None,
    resolution: Annotated[
        str | None,
        typer.Option(
            help="The resolution of the quantities for the diagnosis, in SI units: 1e-3, or "
            "omega=1e-3, attitude=1e-5.",
            show_default="that of the digits in the file",
            rich_help_panel=HOW,
        ),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Also print the evidence for the likely cause, and diagnose each of several files.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    html: HtmlFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
) -> None:
    """Print what is conserved, how far a motion is from the truth, and the likely cause; rank several files.

    The truth is that of a scenario, or of a body that starts at the first row. An energy drift is relative to
    the truth, and with the suffix _from_start relative to the file's first sample.
    """
    from bodycheck.recordings.judge import examined, explained_motion
    from bodycheck.recordings.judge_document import conclusion, conclusions, judgement_document
    from bodycheck.reports.document import Document, answer, print_document
    from bodycheck.reports.render.progress import status_line
    from bodycheck.runs import runner

    check_files({"html": html})
    steps_s = numbers(dt, "--dt")
    body = _given_motion(inertia_kg_m2, mass_kg, torque_body_n_m, gravity)
    if body is not None and start is not None:
        raise InputError("--start: a body of --inertia-kg-m2 always starts at the first sample")
    if scenario is not None and body is None and runner.is_tree(scenario):
        unsupported = {"--map": map_, "--like": like, "--start": start, "--resolution": resolution}
        if given := [option for option, value in unsupported.items() if value]:
            raise InputError(f"{given[0]}: unsupported for {scenario}, a tree of bodies")
        if len(trajectories) > 1:
            raise InputError(f"{trajectories[1]}: files of a tree are judged one at a time")
        _judge_tree(trajectories[0], scenario, steps_s, html, json=json)
        return
    with status_line(f"solving the truth of {scenario or like or 'the body'}"):
        ranking = runner.rank(
            trajectories,
            scenario,
            steps_s,
            column_map=map_ or (),
            like=like,
            start=start or "scenario",
            body=body,
            allow_code=allow_code,
        )
    is_alone = len(ranking.motions) == 1 and not ranking.motions[0].is_true
    diagnosed = explain or html is not None or is_alone
    opening = ""
    if diagnosed and len(ranking.motions) == 1 and not json:  # the search may take minutes
        (motion,), (row,) = ranking.motions, ranking.rows
        examined(motion, row.get("dt_s"), resolution)  # wrong options are refused before anything is printed
        first = conclusions(motion, None)[0]
        opening = first.text
        print_document(Document("", (first,)))
    with status_line("searching for what made the motion"):
        cases = [
            explained_motion(motion, row.get("dt_s"), resolution)
            for motion, row in zip(ranking.motions if diagnosed else (), ranking.rows, strict=False)
        ]
    document = judgement_document(ranking, cases, evidence=explain, opening=opening)
    data = ranking.data
    if cases:
        from bodycheck.examine.explanation.explanation_document import explanation_data

        sentences = [conclusion(motion, case) for motion, case in zip(ranking.motions, cases, strict=True)]
        data = {"conclusions": sentences, **data, "explanations": explanation_data(cases)}
    answer(document, data, as_json=json)
    if html is not None:
        from bodycheck.recordings.judge_page import judgement_page

        write_files({"html": html}, {"html": lambda: judgement_page(ranking, cases)}, as_json=json)


def _judge_tree(
    file: Path, scenario: str, steps_s: Sequence[float] | None, html: Path | None, *, json: bool
) -> None:
    from bodycheck.recordings.judged_tree import tree_judgement, tree_judgement_data
    from bodycheck.reports.document import answer, page
    from bodycheck.reports.render.progress import status_line
    from bodycheck.runs import runner

    with status_line(f"solving the truth of {scenario}"):
        found = runner.judge_tree(file, scenario, steps_s)
    document = tree_judgement(found)
    answer(document, tree_judgement_data(found), as_json=json)
    write_files({"html": html}, {"html": lambda: page(document)}, as_json=json)


def _given_motion(
    inertia_kg_m2: str | None, mass_kg: float | None, torque_body_n_m: str | None, gravity: str | None
) -> GivenMotion | None:
    """Return the body of the options; raises InputError where its inertia is missing."""
    from bodycheck.scenarios.given_motion import GivenMotion

    inertia = numbers(inertia_kg_m2, "--inertia-kg-m2")
    given = {"--mass-kg": mass_kg, "--torque-body-n-m": torque_body_n_m, "--gravity": gravity}
    if inertia is None:
        if lone := [option for option, value in given.items() if value is not None]:
            raise InputError(f"{lone[0]}: needs --inertia-kg-m2; a scenario has its own body and loads")
        return None
    torque, acceleration = numbers(torque_body_n_m, "--torque-body-n-m"), numbers(gravity, "--gravity")
    return GivenMotion(inertia, 1.0 if mass_kg is None else mass_kg, torque, acceleration)


@app.command(
    short_help="Print mass, centre of mass and inertia of a solid.",
    **described(
        MEASURE,
        "bodycheck body part.stl --density-kg-m3 1240 --unit mm",
        "bodycheck body part.obj --mass-kg 4",
        "bodycheck body torus --size-m 1.0,0.3 --density-kg-m3 1000",
    ),
)
def body(
    solid: Annotated[
        str,
        typer.Argument(
            help="A closed mesh (.stl, .obj, .ply, .off, .glb, ...), a shape (box, torus, ...), or "
            "package.module:function, called as f(points) -> values with points (n, 3) in m and values (n,); "
            "f <= 0 is inside."
        ),
    ],
    density_kg_m3: Annotated[
        float | None, typer.Option(help="Density in kg/m^3; required, unless --mass-kg is given.")
    ] = None,
    mass_kg: Annotated[
        float | None, typer.Option(help="Mass in kg, instead of the density of a mesh or a shape.")
    ] = None,
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
    json: Json = False,
) -> None:
    """Print mass, centre of mass and inertia tensor of a solid as TOML.

    Meshes and shapes are exact to round-off and come with principal axes, estimates with standard errors.
    """
    import tomllib

    from bodycheck.reports.document import json_text
    from bodycheck.scenarios.solids import SolidRequest, as_toml, mass_properties

    size, box = numbers(size_m, "--size-m"), numbers(box_m, "--box-m")
    request = SolidRequest(solid, density_kg_m3, size, box, monte_carlo, allow_code, unit, overlap, mass_kg)
    found = mass_properties(request)
    lines = "\n".join(as_toml(found))
    print(json_text({**tomllib.loads(lines), "notes": list(found.notes)}) if json else lines)


@app.command(
    name="list",
    short_help="List scenarios, suites, engines, methods or measures.",
    **described(MEASURE, "bodycheck list methods --engine mujoco", "bodycheck list scenarios --match torque"),
)
def list_(
    what: Annotated[
        Literal["scenarios", "suites", "engines", "methods", "measures"], typer.Argument(help="What to list.")
    ],
    engine: Annotated[str | None, engine_option("Engines to list, or whose methods to list", "all")] = None,
    match: Annotated[
        str | None, typer.Option(help="List only lines with this text.", show_default="all lines")
    ] = None,
    json: Json = False,
) -> None:
    """List the available scenarios, suites, engines, methods or measures."""
    from bodycheck.reports.document import answer
    from bodycheck.reports.summary.catalogue import catalogue, catalogue_document

    if engine is not None and what not in ("engines", "methods"):
        raise InputError(f"--engine: applies to engines and methods, not to {what}")
    entries = catalogue(what, engine.split(",") if engine else (), match or "")
    answer(catalogue_document(what, entries), entries, as_json=json)


app.add_typer(dynamics_commands)
app.add_typer(stored_run_commands)


@app.command(
    short_help="Print what works on this machine and what does not.", **described(MEASURE, "bodycheck doctor")
)
def doctor(json: Json = False) -> None:
    """Start every engine once; print the versions, the caches, and what works on this machine."""
    from bodycheck.reports.document import answer
    from bodycheck.reports.render.progress import status_line
    from bodycheck.runs.doctor import diagnosis, diagnosis_document

    with status_line("starting every engine"):
        found = diagnosis()
    answer(diagnosis_document(found), found, as_json=json)


app.add_typer(gate_commands)
app.add_typer(nightly)
app.add_typer(merge_commands)
app.add_typer(version_commands)
app.add_typer(identity_commands)
app.add_typer(adapter_commands)
for room in rooms():
    app.add_typer(room.commands)
app.add_typer(project_commands)
app.add_typer(environment_commands, name="environments", rich_help_panel=WATCH)
