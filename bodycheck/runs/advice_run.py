"""Advice from a run: choose or make the run, limit its time, and measure what was only predicted."""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util import formatting
from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck._util.formatting import number, suggestion, vector
from bodycheck.adapters.contract import Method
from bodycheck.adapters.engine_names import admit, is_named, with_method
from bodycheck.adapters.registry import requested_name
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import CaseResult, measured_by, scenario_spec
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.study import method_rows
from bodycheck.reports.run_files.run_reader import MANIFEST, read_manifest, read_run, read_tables
from bodycheck.reports.run_files.run_tables import (
    MethodKey,
    Run,
    Tables,
    cases_by_method,
    check_engines,
    key_of,
)
from bodycheck.reports.summary.advice import (
    Advice,
    Curves,
    Option,
    ScenarioAdvice,
    check_question,
    errors_at,
    settings_within,
    to_measure,
)
from bodycheck.reports.summary.error_curve import curves_of, largest_error
from bodycheck.runs.directory import RUNS, run_to_folder
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import ProgressFactory
from bodycheck.runs.runner import run_selection
from bodycheck.runs.selection import select
from bodycheck.scenarios.free_body import FreeBody, scenario_text
from bodycheck.scenarios.library import load_any
from bodycheck.scenarios.serialization import deserialized, serialized

_SAME = 1e-9  # relative difference of two times that count as equal


def until(run: Run, horizon_s: float) -> Run:
    """Return a run with the errors, orders and verdicts of its motions up to a time in s.

    Scales and speeds are those of the whole scenario. Raises InputError where a scenario has no sample up to
    the horizon besides the first.
    """
    problems = {problem.scenario.name: _cut(problem, horizon_s) for problem in run.problems}
    cases = tuple(_measured_until(case, problems[case.columns["scenario"]]) for case in run.cases)
    rows = [{"run_id": run.run_id, **row} for row in _rows(run, cases, problems)]
    return replace(run.with_rows(methods=rows), cases=cases, problems=tuple(problems.values()))


def check_horizon(horizon_s: float, scenario: str, interval_s: float) -> None:
    """Raise InputError where a horizon is shorter than the sampling interval of a scenario, both in s."""
    if interval_s > horizon_s * (1.0 + _SAME):
        raise InputError(f"--horizon-s {horizon_s!r}: the first sample of {scenario} is at {interval_s!r} s")


def _cut(problem: Problem, horizon_s: float) -> Problem:
    check_horizon(horizon_s, problem.scenario.name, float(problem.times[1]))
    until = int(np.count_nonzero(problem.times <= horizon_s * (1.0 + _SAME)))
    return replace(problem, compared=until)


def _measured_until(case: CaseResult, problem: Problem) -> CaseResult:
    if not case.ok or case.trajectory is None:
        return case
    motion = EnergyAndMomentum.of(problem.scenario.scene, case.trajectory)
    measured, moved = measured_by(problem, case.trajectory, motion)
    return CaseResult(case.columns | problem.columns | measured, moved)


def _rows(run: Run, cases: tuple[CaseResult, ...], problems: dict[str, Problem]) -> Iterator[dict[str, Any]]:
    for scenario, methods in cases_by_method(cases).items():
        for (engine, name), own in methods.items():
            facts = run.manifest["engines"][engine]["methods"][name]
            coarsest_first = sorted(own, key=lambda case: -(case.setting.fineness or 0.0))
            yield from method_rows(coarsest_first, problems[scenario], Method.of(facts))


def chosen_run(
    folder: Path | None,
    requested: Sequence[str],
    engines: Sequence[str] = (),
    *,
    allow_code: bool,
    make_progress: ProgressFactory,
) -> tuple[Path, Tables, list[str]]:
    """Return a run's folder, its tables, and the names of the requested scenarios [default: all of the run].

    Without a folder, take the newest run under bodycheck-runs/ that has exactly these scenarios and all of
    these engines, or an older one that has all its methods and more; if there is none, run them. allow_code:
    scenarios may name functions, whose code runs. Raises InputError if the folder is not that of a run or
    lacks a scenario.
    """
    if folder is not None:
        return _named(folder, requested, allow_code=allow_code)
    loaded = load_any(requested, allow_code=allow_code)
    scenarios_written = {scenario.name: serialized(scenario) for _, scenario in loaded}
    # a user's function may have changed under the same name, so no stored run is known to match
    own_code = any(scenario.scene.has_callback_load for _, scenario in loaded)
    stored = [] if own_code else _newest_first()
    complete = [
        (path, manifest)
        for path, manifest in stored
        if scenarios_written.items() <= manifest["scenarios"].items() and _has_engines(manifest, engines)
    ]
    for path, manifest in _most_complete_first(complete):
        try:
            return path, read_tables(path), list(scenarios_written or manifest["scenarios"])
        except InputError as error:
            _warn_left_out(error)
    scenarios = list(requested) or ["standard"]
    what = "scenarios and engines" if engines else "scenarios"
    print(f"no stored run in {RUNS}/ has these {what}; running {' '.join(scenarios)}", file=sys.stderr)
    new = Request(scenarios=scenarios, engines=list(engines) or None, allow_code=allow_code)
    _, report = run_to_folder(new, None, make_progress)
    return _named(report.parent, requested, allow_code=allow_code)


def _has_engines(manifest: Mapping[str, Any], engines: Sequence[str]) -> bool:
    """Whether a run has a method of each engine, as --engine names them."""
    methods = [
        (engine, method)
        for engine, entry in manifest["engines"].items()
        for method in entry.get("methods", ())
    ]
    return all(any(is_named([name], *key) for key in methods) for name in engines)


def _named(folder: Path, requested: Sequence[str], *, allow_code: bool) -> tuple[Path, Tables, list[str]]:
    tables = read_tables(folder)
    known = list(tables.manifest["scenarios"])
    names: list[str] = []
    for name in requested:
        loaded = [] if name in known else load_any([name], allow_code=allow_code)
        names += [scenario.name for _, scenario in loaded] or [name]
    if missing := [name for name in names if name not in known]:
        raise InputError(f"{folder}: has no scenario {', '.join(missing)}{suggestion(missing[0], known)}")
    return folder, tables, list(dict.fromkeys(names)) or known


def _most_complete_first(
    runs: Sequence[tuple[Path, dict[str, Any]]],
) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield runs, newest first, but each after the newest older one that has all its methods and more.

    A run of one case, to confirm an answer, must not replace the run that the answer came from.
    """
    for index, (path, manifest) in enumerate(runs):
        more_complete = (run for run in runs[index + 1 :] if _methods(run[1]) > _methods(manifest))
        yield from islice(more_complete, 1)
        yield path, manifest


def _methods(manifest: dict[str, Any]) -> set[tuple[str, str | None, str]]:
    return {
        (engine, entry.get("version"), method)
        for engine, entry in manifest["engines"].items()
        for method in entry.get("methods", ())
    }


def _newest_first(*, quiet: bool = False) -> list[tuple[Path, dict[str, Any]]]:
    """Return the folders and manifests of complete runs in bodycheck-runs/.

    Unless quiet, warn about damaged ones.
    """
    found = []
    for path in RUNS.glob("*/manifest.json"):
        try:
            found.append((path.parent, read_manifest(path.parent)))
        except InputError as error:
            if not quiet:
                _warn_left_out(error)
    return sorted(found, key=lambda run: (run[1]["created"], run[0]), reverse=True)


def _warn_left_out(error: InputError) -> None:
    print(f"warning: a damaged run is ignored: {error}", file=sys.stderr)


_MAX_ROUNDS = 12
_MAX_STEPS = 2e7  # of a case that a search measures


@dataclass(frozen=True)
class AdviceRequest:
    """A question: which settings meet `error`, or which error the step `dt_s` has; one of the two is given.

    horizon_s: time in s over which the error counts [default: the whole scenario]. search: whether to measure
    predicted settings. scenarios: names, suites, paths [default: all of the run]. body: a free body instead
    of scenarios. engines: as --engine names them [default: all of the run]. run: folder of a run [default:
    the newest one with these scenarios and engines, else a new run]. allow_code: scenarios may name
    functions, whose code runs.
    """

    error: float | None = None
    dt_s: float | None = None
    measure: str = "orientation_error_rad"
    horizon_s: float | None = None
    search: bool = False
    scenarios: tuple[str, ...] = ()
    body: FreeBody | None = None
    every: bool = False
    engines: tuple[str, ...] = ()
    run: Path | None = None
    allow_code: bool = False


def advise(request: AdviceRequest, make_progress: ProgressFactory) -> Advice:
    """Return the answers to a question; raises InputError if it is wrong."""
    check_question(request.error, request.dt_s, request.measure)
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
        for _, scenario in load_any(scenarios, allow_code=request.allow_code):
            check_horizon(request.horizon_s, scenario.name, scenario.scene.sample_interval_s)
    folder, run, names = chosen_run(
        *(request.run, scenarios, request.engines),
        allow_code=request.allow_code,
        make_progress=make_progress,
    )
    if not run.cases:
        raise InputError(f"{folder}: has no cases")
    check_engines(run, request.engines)
    found: Tables = run
    if request.horizon_s is not None and request.body is None:
        full_run = read_run(folder, allow_code=request.allow_code, cache=Cache.default())
        found = until(full_run, request.horizon_s)
        _note_shorter(found, names, request.horizon_s)
    answers = (
        _searched(folder, found, request, names, make_progress)
        if request.search
        else _confirmed(folder, found, request, names)
    )
    return Advice(request.measure, request.error, request.dt_s, str(folder), answers)


def _note_shorter(run: Run, scenarios: Sequence[str], horizon_s: float) -> None:
    """Note on standard error which of the scenarios end before the horizon, in s."""
    ends = {problem.scenario.name: problem.scenario.duration_s for problem in run.problems}
    shorter = [
        f"{name} ({number(ends[name])} s)" for name in scenarios if ends[name] < horizon_s * (1.0 - _SAME)
    ]
    if shorter:
        listed = formatting.names(shorter)
        print(f"note: shorter than --horizon-s {horizon_s!r}, counted whole: {listed}", file=sys.stderr)


def _written(body: FreeBody, horizon_s: float | None) -> str:
    """Write the scenario of a free body into the folder of runs, and return its path."""
    text = scenario_text(body, horizon_s, "free-body")
    name = f"body-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    path = RUNS / "bodies" / f"{name}.toml"
    text = scenario_text(body, horizon_s, name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
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
    run: Tables, request: AdviceRequest, scenarios: Sequence[str], more: Sequence[Tables] = ()
) -> tuple[ScenarioAdvice, ...]:
    curves = _curves(run, request, more)
    if request.error is not None:
        return settings_within(curves, request.error, scenarios, every=request.every)
    assert request.dt_s is not None
    return errors_at(curves, request.dt_s, scenarios)


def _confirmed(
    folder: Path, run: Tables, request: AdviceRequest, scenarios: Sequence[str]
) -> tuple[ScenarioAdvice, ...]:
    """Return the answers, with the errors that other stored runs measured at a predicted setting.

    If one of these errors exceeds the tolerance, the answers are those of all measurements together.
    """
    answers = _answers(run, request, scenarios)
    steps = {one.setting for answer in answers for one in answer.options if one.basis != "measured"}
    if request.error is None or (request.horizon_s is not None and request.body is None):
        return answers
    more = tuple(_measured_elsewhere(folder, run, steps)) if steps else ()
    errors = {
        (case.columns["scenario"], *key_of(case.columns), case.dt_s): (
            largest_error(case, request.measure),
            str(path),
        )
        for path, case in more
    }
    if any(error > request.error for error, _ in errors.values()):
        return _answers(run, request, scenarios, [replace(run, cases=tuple(case for _, case in more))])

    def confirmed(option: Option, names: Sequence[str]) -> Option:
        key = option.engine, option.method, option.setting
        error, path = max(errors.get((name, *key), (math.inf, "")) for name in names)
        if error == math.inf:
            return option
        return replace(option, error=error, basis="measured", why="", measured_in=path)

    return tuple(
        replace(
            answer,
            options=tuple(
                confirmed(one, [answer.scenario] if answer.scenario else scenarios) for one in answer.options
            ),
        )
        for answer in answers
    )


def _measured_elsewhere(
    folder: Path, run: Tables, steps: Collection[float | None]
) -> Iterator[tuple[Path, CaseResult]]:
    """Yield the cases at these steps of other stored runs, of the same scenarios, engines and builds."""
    builds = {(*key_of(case.columns), case.columns.get("build")) for case in run.cases if case.ok}
    for path, manifest in _newest_first(quiet=True):
        named = {
            name
            for name, stored in manifest["scenarios"].items()
            if run.manifest["scenarios"].get(name) == stored
        }
        if path.resolve() == folder.resolve() or not named or not {*steps} & {*(manifest.get("dt_s") or ())}:
            continue
        with suppress(InputError):  # a damaged run confirms nothing
            yield from (
                (path, case)
                for case in read_tables(path).cases
                if case.columns["scenario"] in named
                and (*key_of(case.columns), case.columns.get("build")) in builds
                and case.dt_s in steps
            )


def _curves(run: Tables, request: AdviceRequest, more: Sequence[Tables]) -> Curves:
    """Return the curves of the requested engines."""
    found = curves_of(run, request.measure, tuple(case for other in more for case in other.cases))
    return {place: curve for place, curve in found.items() if is_named(request.engines, *place[1])}


def _searched(
    folder: Path,
    run: Tables,
    request: AdviceRequest,
    scenarios: Sequence[str],
    make_progress: ProgressFactory,
) -> tuple[ScenarioAdvice, ...]:
    """Measure predicted settings until all answers are measured, or nothing more can be tried."""
    assert request.error is not None
    more: list[Run] = []
    for _ in range(_MAX_ROUNDS):
        answers = _answers(run, request, scenarios, more)
        curves = _curves(run, request, more)
        steps = {
            key: dt_s
            for key, dt_s in to_measure(curves, answers, request.error).items()
            if curves[key].duration_s / dt_s <= _MAX_STEPS
        }
        if not steps:
            return answers
        options = Request(speed=run.manifest["speed"], laws=False)
        measured = measure_steps(
            run, steps, options, make_progress, file=folder / MANIFEST, allow_code=request.allow_code
        )
        more.append(measured if request.horizon_s is None else until(measured, request.horizon_s))
    return _answers(run, request, scenarios, more)


def measure_steps(
    run: Tables,
    steps: Mapping[tuple[str, MethodKey], float],
    options: Request,
    make_progress: ProgressFactory,
    *,
    file: Path | None = None,
    allow_code: bool = False,
) -> Run:
    """Run scenarios and methods of a run, as the run stores them, at one further step in s each.

    file: the manifest of a stored run. allow_code: it may name functions and programs, whose code
    runs. Raises InputError where the run's engines are not available any more.
    """
    commands = {case.columns["scenario"]: case.columns["reproduce"] for case in run.cases}
    known = run.manifest["engines"]
    keys = dict.fromkeys(key for _, key in steps)
    engines = [with_method(requested_name(engine), method) for engine, method in keys]
    admit(engines, allow_code=allow_code, file=file)
    selection = select((), engines)
    # an earlier version of bodycheck stored the command of a program as its name
    methods = tuple(
        (engine if engine.name in known else replace(engine, name=requested_name(engine.name)), method)
        for engine, method in selection.methods
    )
    for engine, _ in methods:
        before = known[engine.name]["version"]
        if engine.version != before:
            raise InputError(f"{engine.name}: the run is of {before}, not of {engine.version}; run it again")
    stored = run.manifest["scenarios"]
    selection = replace(
        selection,
        methods=methods,
        scenarios=tuple(
            (
                scenario_spec(commands[name]) or name,
                deserialized(stored[name], name, allow_code=allow_code, file=file),
            )
            for name in dict.fromkeys(name for name, _ in steps)
        ),
        single_steps={(name, *key): dt_s for (name, key), dt_s in steps.items()},
    )
    with make_progress(selection.cases_listed()) as progress:
        return run_selection(
            selection, replace(options, stable_steps=False), Identity.new(), journal=None, progress=progress
        )
