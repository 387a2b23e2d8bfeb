"""Advice from a run: choose or make the run, limit its time, and measure what was only predicted."""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck._util.formatting import vector
from bodycheck.adapters.programs import with_method
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import scenario_spec
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import MethodKey, Run, RunTables
from bodycheck.reports.summary.advice import (
    Advice,
    Answer,
    check_question,
    errors_at,
    settings_within,
    to_measure,
)
from bodycheck.reports.summary.error_curve import curves_of
from bodycheck.reports.summary.horizon import check_horizon, until
from bodycheck.runs.choose import chosen_run
from bodycheck.runs.directory import RUNS
from bodycheck.runs.manifest import Identity
from bodycheck.runs.run_options import ProgressFactory, RunOptions
from bodycheck.runs.runner import run_selection
from bodycheck.runs.selection import select
from bodycheck.scenarios.free_body import FreeBody, scenario_text
from bodycheck.scenarios.library import load_scenarios
from bodycheck.scenarios.serialization import deserialized

_MAX_ROUNDS = 12
_MAX_STEPS = 2e7  # of a case that a search measures


@dataclass(frozen=True)
class AdviceRequest:
    """A question: which settings meet `error`, or which error the step `dt_s` has; one of the two is given.

    horizon_s: time in s over which the error counts [default: the whole scenario]. search: whether to measure
    predicted settings. scenarios: names, suites, paths [default: all of the run]. body: a free body instead
    of scenarios. run: folder of a run [default: the newest one with these scenarios, else a new run].
    allow_code: scenarios may name functions, whose code runs.
    """

    error: float | None = None
    dt_s: float | None = None
    quantity: str = "orientation_error_rad"
    horizon_s: float | None = None
    search: bool = False
    scenarios: tuple[str, ...] = ()
    body: FreeBody | None = None
    run: Path | None = None
    allow_code: bool = False


def advise(request: AdviceRequest, make_progress: ProgressFactory) -> Advice:
    """Return the answers to a question; raises InputError if it is wrong."""
    check_question(request.error, request.dt_s, request.quantity)
    if request.horizon_s is not None and not 0.0 < request.horizon_s < math.inf:
        raise InputError(f"--horizon-s {request.horizon_s!r}: must be a positive number")
    if request.search and request.error is None:
        raise InputError("--search: searches the settings that meet --error; --dt names one step")
    scenarios: Sequence[str] = request.scenarios
    if request.body is not None:
        if scenarios or request.run is not None:
            raise InputError("a body on the command line replaces scenarios and --run; give one of them")
        scenarios = [_written(request.body, request.horizon_s)]
    elif request.horizon_s is not None and request.run is None and scenarios:
        for _, scenario in load_scenarios(scenarios, allow_code=request.allow_code):
            check_horizon(request.horizon_s, scenario.name, scenario.scene.sample_interval_s)
    folder, run, names = chosen_run(
        request.run, scenarios, allow_code=request.allow_code, make_progress=make_progress
    )
    found: RunTables = run
    if request.horizon_s is not None and request.body is None:
        full_run = read_run(folder, allow_code=request.allow_code, cache=Cache.default())
        found = until(full_run, request.horizon_s)
    answers = (
        _searched(found, request, names, make_progress) if request.search else _answers(found, request, names)
    )
    return Advice(request.quantity, request.error, request.dt_s, str(folder), answers)


def _written(body: FreeBody, horizon_s: float | None) -> str:
    """Write the scenario of a free body into the folder of runs, and return its path."""
    text = scenario_text(body, horizon_s, "free-body")
    name = f"body-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    path = RUNS / "bodies" / f"{name}.toml"
    text = scenario_text(body, horizon_s, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, text.encode())
    print(
        f"{path}: omega_body = {vector(body.omega_body)} rad/s, {body.duration_s(horizon_s):g} s",
        file=sys.stderr,
    )
    if body.spins_steadily:
        print(
            "note: this omega is constant, which any method computes well; errors are larger for other spins",
            file=sys.stderr,
        )
    return str(path)


def _answers(
    run: RunTables, request: AdviceRequest, scenarios: Sequence[str], more: Sequence[Run] = ()
) -> tuple[Answer, ...]:
    curves = curves_of(run, request.quantity, tuple(case for other in more for case in other.cases))
    if request.error is not None:
        return settings_within(curves, request.error, scenarios)
    assert request.dt_s is not None
    return errors_at(curves, request.dt_s, scenarios)


def _searched(
    run: RunTables, request: AdviceRequest, scenarios: Sequence[str], make_progress: ProgressFactory
) -> tuple[Answer, ...]:
    """Measure predicted settings until all answers are measured, or nothing more can be tried."""
    assert request.error is not None
    more: list[Run] = []
    for _ in range(_MAX_ROUNDS):
        answers = _answers(run, request, scenarios, more)
        curves = curves_of(run, request.quantity, tuple(case for other in more for case in other.cases))
        steps = {
            key: dt_s
            for key, dt_s in to_measure(curves, answers, request.error).items()
            if curves[key].duration_s / dt_s <= _MAX_STEPS
        }
        if not steps:
            return answers
        options = RunOptions(speed=run.manifest["speed"], laws=False)
        measured = measure_steps(run, steps, options, make_progress, allow_code=request.allow_code)
        more.append(measured if request.horizon_s is None else until(measured, request.horizon_s))
    return _answers(run, request, scenarios, more)


def measure_steps(
    run: RunTables,
    steps: Mapping[tuple[str, MethodKey], float],
    options: RunOptions,
    make_progress: ProgressFactory,
    *,
    allow_code: bool = False,
) -> Run:
    """Run scenarios and methods of a run, as the run stores them, at one further step in s each.

    allow_code: the scenarios may name functions, whose code runs. Raises InputError where the run's engines
    are not available any more.
    """
    commands = {case.columns["scenario"]: case.columns["reproduce"] for case in run.cases}
    selection = select((), [with_method(*key) for key in dict.fromkeys(key for _, key in steps)])
    for engine, _ in selection.methods:
        before = run.manifest["engines"][engine.name]["version"]
        if engine.version != before:
            raise InputError(f"{engine.name}: the run is of {before}, not of {engine.version}; run it again")
    stored = run.manifest["scenarios"]
    selection = replace(
        selection,
        scenarios=tuple(
            (scenario_spec(commands[name]) or name, deserialized(stored[name], name, allow_code=allow_code))
            for name in dict.fromkeys(name for name, _ in steps)
        ),
        single_steps={(name, *key): dt_s for (name, key), dt_s in steps.items()},
    )
    with make_progress(selection.cases_listed()) as progress:
        return run_selection(
            selection, replace(options, stable_steps=False), Identity.new(), journal=None, progress=progress
        )
