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

_MOST_ROUNDS = 12
_MOST_STEPS = 2e7  # of a case that a search measures


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


def advise(asked: AdviceRequest, watching: ProgressFactory) -> Advice:
    """Return the answers to a question; raises InputError if it is wrong."""
    check_question(asked.error, asked.dt_s, asked.quantity)
    if asked.horizon_s is not None and not 0.0 < asked.horizon_s < math.inf:
        raise InputError(f"--horizon-s {asked.horizon_s!r}: must be a positive number")
    if asked.search and asked.error is None:
        raise InputError("--search: searches the settings that meet --error; --dt names one step")
    scenarios: Sequence[str] = asked.scenarios
    if asked.body is not None:
        if scenarios or asked.run is not None:
            raise InputError("a body on the command line replaces scenarios and --run; give one of them")
        scenarios = [_written(asked.body, asked.horizon_s)]
    elif asked.horizon_s is not None and asked.run is None and scenarios:
        for _, scenario in load_scenarios(scenarios, allow_code=asked.allow_code):
            check_horizon(asked.horizon_s, scenario.name, scenario.scene.sample_interval_s)
    folder, run, names = chosen_run(asked.run, scenarios, allow_code=asked.allow_code, watching=watching)
    found: RunTables = run
    if asked.horizon_s is not None and asked.body is None:
        whole = read_run(folder, allow_code=asked.allow_code, cache=Cache.default())
        found = until(whole, asked.horizon_s)
    answers = _searched(found, asked, names, watching) if asked.search else _answers(found, asked, names)
    return Advice(asked.quantity, asked.error, asked.dt_s, str(folder), answers)


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
    run: RunTables, asked: AdviceRequest, scenarios: Sequence[str], more: Sequence[Run] = ()
) -> tuple[Answer, ...]:
    curves = curves_of(run, asked.quantity, tuple(case for other in more for case in other.cases))
    if asked.error is not None:
        return settings_within(curves, asked.error, scenarios)
    assert asked.dt_s is not None
    return errors_at(curves, asked.dt_s, scenarios)


def _searched(
    run: RunTables, asked: AdviceRequest, scenarios: Sequence[str], watching: ProgressFactory
) -> tuple[Answer, ...]:
    """Measure predicted settings until all answers are measured, or nothing more can be tried."""
    assert asked.error is not None
    more: list[Run] = []
    for _ in range(_MOST_ROUNDS):
        answers = _answers(run, asked, scenarios, more)
        curves = curves_of(run, asked.quantity, tuple(case for other in more for case in other.cases))
        steps = {
            place: dt_s
            for place, dt_s in to_measure(curves, answers, asked.error).items()
            if curves[place].duration_s / dt_s <= _MOST_STEPS
        }
        if not steps:
            return answers
        options = RunOptions(speed=run.manifest["speed"], laws=False)
        measured = measure_steps(run, steps, options, watching, allow_code=asked.allow_code)
        more.append(measured if asked.horizon_s is None else until(measured, asked.horizon_s))
    return _answers(run, asked, scenarios, more)


def measure_steps(
    run: RunTables,
    steps: Mapping[tuple[str, MethodKey], float],
    options: RunOptions,
    watching: ProgressFactory,
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
    with watching(selection.cases_listed()) as progress:
        return run_selection(
            selection, replace(options, stable_steps=False), Identity.new(), journal=None, progress=progress
        )
