"""Run scenarios on engines: compile, solve the truths, record the motions, measure the speeds."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reference_impl.precompile import compile_kernels
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.journal import Journal
from bodycheck.reports.cache.reuse import reuse_of
from bodycheck.reports.cache.truths import is_known, known_truth
from bodycheck.reports.judge import judge_file
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.scheduler import Task, run_tasks
from bodycheck.reports.measurement.speed import measure_speeds
from bodycheck.reports.measurement.study import Study, study
from bodycheck.reports.probes.probe import probe_rows
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.run_files.tables import (
    METHOD_COLUMNS,
    PROBE_COLUMNS,
    RESULT_COLUMNS,
    STABILITY_COLUMNS,
    as_table,
)
from bodycheck.runs.manifest import Identity, manifest_of
from bodycheck.runs.run_options import NULL_PROGRESS, TIMEOUT_S, Progress, RunOptions
from bodycheck.runs.selection import Selection, select
from bodycheck.scenarios.library import PROBES, load_scenario
from bodycheck.scenarios.model import Scenario


def run(
    scenarios: Sequence[str | Path] = ("standard",),
    *,
    engines: Sequence[str] | None = None,
    dt_s: Iterable[float] | None = None,
    tolerances: Iterable[float] | None = None,
    speed: bool = True,
    jobs: int | None = None,
    timeout_s: float = TIMEOUT_S,
    fresh: bool | None = None,
    allow_code: bool = False,
) -> Run:
    """Measure scenarios x methods x steps and return the tables with the motions behind them.

    scenarios: built-in names, suites, paths of TOML files. engines: NAME[==VERSION][:METHOD] [default: every
    engine that can be imported]. dt_s: step sizes in s, a list or an array [default: each scenario's, and
    more where an order needs them]. tolerances: error tolerances of the adaptive methods [default: each
    method's]. speed: whether to measure CPU time. jobs: number of cases to run in parallel [default: one per
    core]. timeout_s: time limit of one case in s. fresh: True runs every case again; False reuses results of
    earlier runs by the same build of an engine; None reuses those of installed engines only, not of plug-ins
    and editable installs. allow_code: whether scenarios may name functions, whose code runs. Raises
    InputError for wrong input.
    """
    if not scenarios:
        raise InputError("scenarios: name at least one")
    options = RunOptions(speed=speed, jobs=jobs, timeout_s=timeout_s, reuse=reuse_of(fresh, "installed"))
    selection = select(scenarios, engines, dt_s, tolerances, allow_code=allow_code)
    return run_selection(selection, options, Identity.new(), journal=None, progress=NULL_PROGRESS)


def run_selection(
    selection: Selection,
    options: RunOptions,
    identity: Identity,
    *,
    journal: Journal | None,
    progress: Progress,
) -> Run:
    """Run a selection: first the motions in parallel, then the speeds, one case at a time.

    journal: stores the results of this run and supplies those of its interrupted part; None to store none.
    """
    begin = time.perf_counter()
    progress.phase("compiling the reference's kernels, once per machine")
    cache = Cache.default()
    cache.prune()
    cache = cache.write_only() if options.reuse == "nothing" else cache
    _compile(selection, cache)
    compiled = time.perf_counter()
    answers = Answers(journal, cache, options.timeout_s, reuse=options.reuse, run_id=identity.run_id)
    progress.phase("solving the truths")
    problems = [
        _solved(scenario, scenario_spec, cache, progress) for scenario_spec, scenario in selection.scenarios
    ]
    progress.phase("motions")
    solved = time.perf_counter()
    studies, probed = _studies_and_probes(selection, problems, answers, options, progress)
    recorded = time.perf_counter()
    cases = tuple(case for studied in studies for case in studied.cases)
    quietness = None
    if options.speed:
        progress.phase("speeds, one case at a time")
        cases, quietness = measure_speeds(
            problems,
            cases,
            {engine.name: engine for engine, _ in selection.methods},
            answers,
            timeout_s=options.timeout_s,
            passes=options.speed_passes,
            case_done=progress.speed_measured,
        )
    ended = time.perf_counter()
    run_id = identity.run_id
    seconds = {
        "compile_s": compiled - begin,
        "truths_s": solved - compiled,
        "motions_s": recorded - solved,
        "speeds_s": ended - recorded,
        "run_s": ended - compiled,
    }
    method_rows = (row for studied in studies for row in studied.method_rows)
    stability_rows = (studied.stability_row for studied in studies if studied.stability_row is not None)
    return Run(
        run_id=run_id,
        results=as_table(({"run_id": run_id, **case.columns} for case in cases), RESULT_COLUMNS),
        methods=as_table(({"run_id": run_id, **row} for row in method_rows), METHOD_COLUMNS),
        stability=as_table(({"run_id": run_id, **row} for row in stability_rows), STABILITY_COLUMNS),
        manifest=manifest_of(identity, selection, options, cases, seconds, quietness),
        problems=tuple(problems),
        cases=cases,
        probes=as_table(({"run_id": run_id, **row} for row in probed), PROBE_COLUMNS),
    )


def _solved(scenario: Scenario, scenario_spec: str, cache: Cache, progress: Progress) -> Problem:
    """Return a scenario with its truth; report first if the truth is not cached and may take long."""
    scene = scenario.scene
    if not is_known(scene, scene.sample_times, cache):
        progress.truth_begun(scenario.name)
    return Problem.of(scenario, scenario_spec, cache)


def _compile(selection: Selection, cache: Cache) -> None:
    """Compile what the reference's methods and the truths that are not cached will call."""
    scenes = [scenario.scene for _, scenario in selection.scenarios]
    # a user's function is first called when its truth is solved, which reports its errors
    scenes = [scene for scene in scenes if not scene.has_callback_load]
    if any((engine.name, method.name) == ("reference", "exact") for engine, method in selection.methods):
        scenes += [load_scenario(name).scene for name in PROBES]
    integrators = [
        method.name
        for engine, method in selection.methods
        if engine.name == "reference" and method.control == "dt"
    ]
    compile_kernels(scenes, integrators, lambda scene: is_known(scene, scene.sample_times, cache))


def _studies_and_probes(
    selection: Selection,
    problems: Sequence[Problem],
    answers: Answers,
    options: RunOptions,
    progress: Progress,
) -> tuple[list[Study], list[dict[str, Any]]]:
    """Return the studies of every scenario by every method, and every method's probes, run in parallel."""
    pairs = [
        (problem, engine, method)
        for problem in problems
        for engine, method in selection.methods
        if selection.runs_on(problem.scenario, engine, method)
    ]
    done: dict[int, Study] = {}
    probed: dict[int, list[dict[str, Any]]] = {}

    def task(place: int, problem: Problem, engine: Engine, method: Method) -> Task:
        settings = selection.settings(problem.scenario, method)

        def do(engine_pool: EnginePool) -> None:
            done[place] = study(
                problem,
                engine,
                method,
                settings,
                adaptive=selection.dt_s is None,
                ask=partial(answers.ask, engine_pool),
                search=partial(answers.search, engine_pool) if options.stable_steps else None,
                case_done=progress.case_done,
            )

        steps = sum(problem.scenario.duration_s / s.dt_s for s in settings if s.dt_s is not None)
        return Task(engine.name, steps * (method.evaluations or 1) * _WEIGHTS.get(engine.name, 1.0), do)

    def probe(place: int, engine: Engine, method: Method) -> Task:
        def do(engine_pool: EnginePool) -> None:
            probed[place] = probe_rows(engine, method, partial(answers.ask, engine_pool))

        return Task(engine.name, 0.0, do)  # probes are cheap, so they run last

    tasks = [task(place, *pair) for place, pair in enumerate(pairs)]
    probes = [probe(place, *method) for place, method in enumerate(selection.methods)]
    run_tasks([*tasks, *probes], options.workers)
    rows = [row for place in range(len(probes)) for row in probed[place]]
    return [done[place] for place in range(len(pairs))], rows


_WEIGHTS = {"reference": 0.02}
"""Cost of a right-hand side relative to a typical engine's; used only to order the tasks."""


def truth(scenario: str | Path, at: Sequence[float], *, allow_code: bool = False) -> Truth:
    """Return the true motion at the given times, with its error bounds.

    scenario: a built-in name or the path of a TOML file. at: n times in s, t >= 0, in any order; the arrays
    of the truth are (n,), (n, 3) and (n, 4) in the same order. The motion starts from the numbers of the
    file, whereas engines receive them rounded to doubles. allow_code: whether the file may name functions.
    Raises InputError if the scenario is wrong, a time is negative or not finite, or the truth ends before it.
    """
    scene = load_scenario(scenario, allow_code=allow_code).scene_as_written
    try:
        times = np.array(at, dtype=np.float64)
        if times.ndim != 1:
            raise ValueError(f"at must be a list of times in s, like [0.0, 1.0], not {at!r}")
        solved = known_truth(scene, times, Cache.default())
    except ValueError as error:
        raise InputError(str(error)) from None
    known = np.isfinite(solved.bounds).all(axis=0)
    if not known.all():
        first = float(times[~known].min())
        raise InputError(f"{scenario}: the truth ends before t = {first!r} s: {solved.end_reason}")
    return solved


def judge(trajectory: str | Path, scenario: str | Path, *, allow_code: bool = False) -> dict[str, Any]:
    """Return the measures of a trajectory from any program (.csv or .npz), by column name.

    trajectory: t_s (n,) in s, and any of position_m (n, 3), velocity_m_s (n, 3), quaternion (n, 4) scalar
    first or rotation (n, 3, 3), omega_body_rad_s or omega_world_rad_s (n, 3); docs/questions.md lists the
    columns of a CSV. Measures of quantities that the file lacks are left out. allow_code: as for `truth`.
    Raises InputError if a file is wrong.
    """
    loaded = load_scenario(scenario, allow_code=allow_code)
    return judge_file(Path(trajectory), loaded, str(scenario), Cache.default())
