"""The commands on many random bodies: the distribution of errors, and the search for the worst start."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import (
    HOW,
    MEASURE,
    OUTPUT,
    WHAT,
    AllowCode,
    EnginesFile,
    Jobs,
    Json,
    OutFolder,
    Quiet,
    TimeoutS,
    admit_engines,
    complete_engines,
    complete_scenarios,
    described,
    engine_option,
    numbers,
    progress_of,
    refuse_others,
    steps_option,
)
from bodycheck.cli.rooms import Room
from bodycheck.runs.request import TIMEOUT_S

if TYPE_CHECKING:
    from bodycheck.ensembles.ensemble_result import EnsembleRequest
    from bodycheck.reports.document import Document

ensemble_commands = typer.Typer()

_Template = Annotated[
    str,
    typer.Argument(
        help="A built-in scenario or a .toml file, for duration, mass and loads.",
        autocompletion=complete_scenarios,
    ),
]
_Seed = Annotated[int, typer.Option(help="Seed of the random bodies.", rich_help_panel=WHAT)]
_Samples = Annotated[
    int,
    typer.Option(
        help="Number of times at which motions are compared, including 0 and the end.", rich_help_panel=WHAT
    ),
]
_Trace = Annotated[
    str | None,
    typer.Option(
        metavar="LOW,HIGH",
        help="Range of I1 + I2 + I3, log-uniform.",
        show_default="1e-9,1e3; that of the scenario if a load acts",
        rich_help_panel=WHAT,
    ),
]
_Torque = Annotated[
    str | None,
    typer.Option(
        metavar="LOW,HIGH",
        help="Range of a constant torque of random direction in body axes, log-uniform.",
        show_default="none",
        rich_help_panel=WHAT,
    ),
]


_OF_A_BODY = (
    "scenario",
    "row",
    "seed",
    "samples",
    "trace_kg_m2",
    "spin_rad_s",
    "torque_n_m",
    "allow_code",
    "quiet",
)


def _range(text: str | None, option: str) -> tuple[float, float] | None:
    ends = numbers(text, option)
    if ends is None:
        return None
    if len(ends) not in (1, 2):
        raise InputError(f"{option} {text}: must be one number or LOW,HIGH")
    return ends[0], ends[-1]


@ensemble_commands.command(
    name="ensemble",
    short_help="Measure methods on many random bodies.",
    **described(
        MEASURE,
        "bodycheck ensemble intermediate-axis --n 100000 --engine reference:rk4,reference:m1 --out bodies",
        "bodycheck ensemble intermediate-axis --n 1000 --engine mujoco:rk4 --dt 1e-2",
        "bodycheck ensemble intermediate-axis --row 4711 > row.toml",
    ),
)
def ensemble(
    context: typer.Context,
    scenario: _Template,
    engine: Annotated[str | None, engine_option("Engines to run", "required without --row")] = None,
    n: Annotated[int, typer.Option("--n", help="Number of bodies.", rich_help_panel=WHAT)] = 1000,
    dt: Annotated[str | None, steps_option("a thousandth of the duration")] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            help="Error tolerances of the adaptive methods.",
            show_default="each method's",
            rich_help_panel=WHAT,
        ),
    ] = None,
    seed: _Seed = 1,
    samples: _Samples = 5,
    trace_kg_m2: _Trace = None,
    spin_rad_s: Annotated[
        str | None,
        typer.Option(
            metavar="LOW,HIGH",
            help="Range of |omega|, log-uniform.",
            show_default="0.1 to 10 times that of the scenario",
            rich_help_panel=WHAT,
        ),
    ] = None,
    torque_n_m: _Torque = None,
    first_row: Annotated[
        int, typer.Option(help="Number of the first body, to continue an ensemble.", rich_help_panel=WHAT)
    ] = 0,
    row: Annotated[
        int | None,
        typer.Option(
            help="Print the body with this number as a scenario file, and run nothing.", rich_help_panel=WHAT
        ),
    ] = None,
    worst: Annotated[
        int, typer.Option(help="Number of worst bodies to write as scenario files.", rich_help_panel=OUTPUT)
    ] = 10,
    out: OutFolder = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="K/N",
            help="Run the K-th of N consecutive parts of the bodies; `bodycheck merge` combines them.",
            show_default="all bodies",
            rich_help_panel=HOW,
        ),
    ] = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure methods on random bodies, and write quantiles with error bars, a dataset and the worst bodies.

    Moments of inertia are uniform in the triangle of possible ones, attitudes and directions are uniform, and
    |omega| and the trace of the inertia are log-uniform. Seed and row determine a body.
    """
    from bodycheck.ensembles.ensemble_result import EnsembleRequest
    from bodycheck.ensembles.ensemble_run import row_text

    admit_engines(engines, allow_code=allow_code)
    request = EnsembleRequest(
        scenario=scenario,
        engines=() if engine is None else engine.split(","),
        n=n,
        seed=seed,
        first_row=first_row,
        dt_s=numbers(dt, "--dt"),
        tolerances=numbers(tolerance, "--tolerance"),
        samples=samples,
        trace_kg_m2=_range(trace_kg_m2, "--trace-kg-m2"),
        spin_rad_s=_range(spin_rad_s, "--spin-rad-s"),
        torque_n_m=_range(torque_n_m, "--torque-n-m"),
        worst=worst,
        shard=shard,
        jobs=jobs,
        timeout_s=timeout_s,
        allow_code=allow_code,
    )
    if row is not None:
        refuse_others(context, "--row: prints the scenario file of one body", _OF_A_BODY)
        print(row_text(request, row), end="")
        return
    if not request.engines:
        raise InputError("--engine: name the engines to run, like --engine reference:rk4,mujoco:rk4")
    _run(request, out, as_json=json, quiet=quiet)


def _new_folder(name: str) -> Path:
    """Return a folder of runs that does not exist yet: NAME, NAME-2, NAME-3, ..."""
    from bodycheck.runs.directory import RUNS

    names = (name if k == 1 else f"{name}-{k}" for k in count(1))
    return next(RUNS / one for one in names if not (RUNS / one).exists())


def _run(request: EnsembleRequest, out: Path | None, *, as_json: bool, quiet: bool) -> None:
    from bodycheck.ensembles.ensemble_answer import ensemble_data, ensemble_document, write_ensemble_page
    from bodycheck.ensembles.ensemble_run import run_ensemble
    from bodycheck.reports.document import answer

    folder = out or _new_folder(f"ensemble-{Path(request.scenario).stem}-{request.seed}")
    result = run_ensemble(request, folder, progress_of(quiet=quiet))
    report = write_ensemble_page(result, folder)
    answer(ensemble_document(result, folder), ensemble_data(result, folder), as_json=as_json)
    if not as_json:
        print(report)


@ensemble_commands.command(
    short_help="Search for the initial state with the largest error.",
    **described(
        MEASURE,
        "bodycheck hunt intermediate-axis --engine mujoco:rk4 --dt 1e-2 --out worst",
        "bodycheck hunt intermediate-axis --engine mujoco:euler --against dart:semi-implicit",
        "bodycheck hunt intermediate-axis --engine reference:rk4 --spin-rad-s 1,1000 "
        "--measure rotational_energy_drift",
    ),
)
def hunt(
    scenario: _Template,
    engine: Annotated[
        str, typer.Option(help="The method, as NAME[==VERSION]:METHOD.", autocompletion=complete_engines)
    ],
    against: Annotated[
        str | None,
        typer.Option(
            help="Search the largest difference from this method, NAME[==VERSION]:METHOD, and not from the "
            "truth.",
            show_default="the truth",
            rich_help_panel=WHAT,
        ),
    ] = None,
    dt: Annotated[
        float | None,
        typer.Option(
            help="Step size in s.", show_default="a thousandth of the duration", rich_help_panel=WHAT
        ),
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="Error tolerance of an adaptive method.", rich_help_panel=WHAT)
    ] = None,
    measure: Annotated[
        str,
        typer.Option(
            help="orientation_error_rad, omega_error, rotational_energy_drift or angular_momentum_drift; a "
            "breakdown counts above all of them.",
            rich_help_panel=WHAT,
        ),
    ] = "orientation_error_rad",
    spin_rad_s: Annotated[
        str | None,
        typer.Option(
            metavar="LOW,HIGH",
            help="Range of |omega| to search.",
            show_default="fixed at that of the scenario",
            rich_help_panel=WHAT,
        ),
    ] = None,
    trace_kg_m2: _Trace = None,
    torque_n_m: _Torque = None,
    evaluations: Annotated[int, typer.Option(help="Number of starts to try.", rich_help_panel=HOW)] = 2000,
    seed: _Seed = 1,
    samples: _Samples = 5,
    out: OutFolder = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Search for the start at which a method is worst relative to its median error, and save it.

    The search begins with random starts from the same distribution as `ensemble`. With --against, it finds
    where two methods, engines or versions differ most. A breakdown of the method ranks above any error.
    """
    from bodycheck.ensembles.ensemble_answer import hunt_data, hunt_document
    from bodycheck.ensembles.ensemble_result import EnsembleRequest
    from bodycheck.ensembles.hunt_run import HuntRequest, write_hunt
    from bodycheck.ensembles.hunt_run import hunt as search
    from bodycheck.reports.document import answer
    from bodycheck.reports.run_files.writer import check_output

    admit_engines(engines, allow_code=allow_code)
    request = HuntRequest(
        ensemble=EnsembleRequest(
            scenario=scenario,
            engines=(engine,),
            n=1,
            seed=seed,
            dt_s=None if dt is None else [dt],
            tolerances=None if tolerance is None else [tolerance],
            samples=samples,
            trace_kg_m2=_range(trace_kg_m2, "--trace-kg-m2"),
            spin_rad_s=_range(spin_rad_s, "--spin-rad-s"),
            torque_n_m=_range(torque_n_m, "--torque-n-m"),
            jobs=jobs,
            timeout_s=timeout_s,
            allow_code=allow_code,
        ),
        against=against,
        measure=measure,
        evaluations=evaluations,
    )
    folder = out or _new_folder(f"hunt-{Path(scenario).stem}-{seed}")
    check_output(folder)
    result = search(request, progress_of(quiet=quiet))
    write_hunt(result, folder)
    answer(hunt_document(result, folder), hunt_data(result, folder), as_json=json)


def _merge(folders: Sequence[Path], out: Path, allow_code: bool) -> tuple[Document, dict[str, Any]]:
    from bodycheck.ensembles.ensemble_answer import ensemble_data, ensemble_document, write_ensemble_page
    from bodycheck.ensembles.ensemble_merge import merge_ensembles

    result = merge_ensembles(folders, out, allow_code=allow_code)
    write_ensemble_page(result, out)
    return ensemble_document(result, out), ensemble_data(result, out)


ROOM = Room(ensemble_commands, "ensembles", "quantiles.csv", _merge, takes_code=True)
