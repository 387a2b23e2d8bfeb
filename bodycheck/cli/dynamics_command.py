"""The command `dynamics`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import (
    MEASURE,
    WHAT,
    AllowCode,
    EnginesFile,
    HtmlFile,
    Json,
    MarkdownFile,
    Quiet,
    TimeoutS,
    admit_engines,
    check_files,
    complete_engines,
    described,
    write_files,
)
from bodycheck.runs.request import TIMEOUT_S

dynamics_commands = typer.Typer()


@dynamics_commands.command(
    short_help="Compare an engine's equations of trees with exact ones, without a motion.",
    **described(
        MEASURE,
        "bodycheck dynamics mujoco",
        "bodycheck dynamics pinocchio double-pendulum robot.urdf",
        "bodycheck dynamics mujoco,pybullet,dart --markdown table.md",
        "bodycheck dynamics pybullet --random 100 --seed 2 --html dynamics.html",
    ),
)
def dynamics(
    engine: Annotated[str, typer.Argument(help="NAME[==VERSION],...", autocompletion=complete_engines)],
    trees: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO|MODEL]...",
            help="Trees: built-in names, scenario files, URDF and MJCF files.",
            show_default="all built-in trees",
        ),
    ] = None,
    random: Annotated[
        int | None,
        typer.Option(
            min=0, help="Number of random trees.", show_default="20; 0 with trees", rich_help_panel=WHAT
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of random trees and states.", rich_help_panel=WHAT)
    ] = 1,
    gates: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Check the gates of dynamics.<reading> in this file in place of the verdicts.",
            show_default="none",
            rich_help_panel=WHAT,
        ),
    ] = None,
    html: HtmlFile = None,
    markdown: MarkdownFile = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare what an engine reports of trees with exact values, without a motion.

    In random states, compares mass matrix, bias, gravity, accelerations, joint wrenches, energy, momenta and
    poses, relative to their largest component. Wrong readings are explained by known faults. Two steps then
    show which state each reading belongs to. The exit status is 1 if a reading is wrong.
    """
    from bodycheck.adapters.engine_names import split_method
    from bodycheck.examine.dynamics.dynamics_document import dynamics_document
    from bodycheck.examine.dynamics.engine_dynamics import dynamics_rows
    from bodycheck.reports import document
    from bodycheck.reports.gates.gate import read_gates
    from bodycheck.reports.gates.gate_output import results_document
    from bodycheck.reports.gates.verdict import check_gates
    from bodycheck.reports.render.progress import status_line
    from bodycheck.reports.run_files.run_tables import Tables
    from bodycheck.runs.dynamics_run import RANDOM_TREES, DynamicsOptions
    from bodycheck.runs.dynamics_run import dynamics as measured
    from bodycheck.scenarios.library import tree_names

    files = {"html": html, "markdown": markdown}
    check_files(files)
    admit_engines(engines, allow_code=allow_code)
    requested = [split_method(name)[0] for name in engine.split(",")]
    bounds = [] if gates is None else [one for one in read_gates(gates) if one.target.source == "dynamics"]
    bounds = [one for one in bounds if any(map(one.matches_engine, requested))]
    if gates is not None and not bounds:
        raise InputError(f"--gates {gates}: no gate of dynamics.<reading> concerns {engine}")
    number = (0 if trees else RANDOM_TREES) if random is None else random
    options = DynamicsOptions(number, seed, timeout_s)
    found = []
    for name in requested:
        with status_line(f"reading the dynamics of trees from {name}", quiet=quiet):
            found.append(measured(name, trees or tree_names(), options))
    shown, failed = dynamics_document(found), any(one.wrong for one in found)
    if bounds:
        rows = [row for one in found for row in dynamics_rows(one)]
        results = check_gates(bounds, Tables(run_id="", manifest={}, cases=(), tables={"dynamics": rows}))
        shown = document.Document(shown.title, (*results_document(results).parts, *shown.parts))
        failed = any(result.is_bad for result in results)
    document.answer(shown, found[0] if len(found) == 1 else found, as_json=json)
    write_files(
        files,
        {
            "html": lambda: document.page(shown),
            "markdown": lambda: document.markdown(shown),
        },
        as_json=json,
    )
    if failed:
        raise typer.Exit(1)
