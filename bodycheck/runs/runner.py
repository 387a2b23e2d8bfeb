"""Run scenarios on engines: compile, solve the truths, record the motions, measure the speeds."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.shard import Shard
from bodycheck._util.source_commit import source_commit
from bodycheck.adapters.engine_names import admit, admit_file
from bodycheck.examine.explanation.explain import (
    ExplainedCase,
    diagnosis_row,
    explained_cases,
    wrong_verdicts,
)
from bodycheck.recordings.column_map import ColumnMap, MapSpec, read_map, scenario_of
from bodycheck.recordings.judge import Ranking, explained_motion, judge_files, of_given_body, read_files
from bodycheck.recordings.judged_motion import Start
from bodycheck.recordings.judged_tree import JudgedTree, judged_tree
from bodycheck.reference_impl.precompile import (
    TREE_STEPS,
    TREE_TRUTHS,
    compile_kernels,
    interprets_closed_forms,
)
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.journal import Journal
from bodycheck.reports.cache.truths import is_known, known_truth
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.run_files.tables import TABLES, MeasuredTables, Row
from bodycheck.runs.manifest import Identity, manifest_of
from bodycheck.runs.motions import run_motions
from bodycheck.runs.request import Request, with_options_of
from bodycheck.runs.run_progress import NULL_PROGRESS, Progress
from bodycheck.runs.selection import Selection, select
from bodycheck.runs.speed import Clock, last_core, measure_speeds
from bodycheck.scenarios.given_motion import GivenMotion
from bodycheck.scenarios.library import PROBES, load_one, load_scenario
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import AnyScenario
from bodycheck.scenarios.tree_model import TreeScenario


@with_options_of(Request)
def run(request: Request) -> Run:
    """Measure scenarios x methods x steps and return the tables with the motions behind them.

    Lists may be arrays. An engine that was named and is not available is left out with a warning. Raises
    InputError for wrong input, and if no engine is available.
    """
    for name in ("scenarios", "engines", "dt_s", "tolerances"):
        values: Any = getattr(request, name)
        if values is not None and np.size(values) == 0:
            raise InputError(f"{name}: name at least one")
    source_commit(request.commit)  # checks it
    engines = request.engines
    if request.engines_file is not None:
        admit_file(Path(request.engines_file), allow_code=request.allow_code)
    admit((name for name in engines or () if isinstance(name, str)), allow_code=True)
    selection = select(
        *(request.scenarios, engines, request.dt_s, request.tolerances),
        allow_code=request.allow_code,
        partial=True,
    )
    if engines is not None:
        for why in selection.unavailable.values():
            warnings.warn(f"not measured: {why}", stacklevel=3)
    if request.shard is not None:
        selection = selection.of_shard(Shard.parse(request.shard))
    with connected_to_cluster(request) as request:
        return run_selection(selection, request, Identity.new(), journal=None, progress=NULL_PROGRESS)


@contextmanager
def connected_to_cluster(request: Request) -> Iterator[Request]:
    """Return the request with the cluster's executors, if there is one, for a with block.

    Raises InputError if an option is wrong or the cluster cannot be used.
    """
    files = [request.tls_ca_file, request.tls_cert, request.tls_key]
    given = [file for file in files if file is not None]
    if given and (len(given) < len(files) or request.cluster is None):
        raise InputError("--tls-ca-file, --tls-cert, --tls-key: give all three, with --cluster")
    if request.cluster is None:
        yield request
        return
    from bodycheck.runs.cluster import TlsFiles, connected

    tls = TlsFiles(*given) if given else None
    with connected(request.cluster, tls, speed=request.speed, insecure=request.insecure) as cluster:
        yield replace(request, executor=cluster.executor, timing=cluster.timing)


def run_selection(
    selection: Selection,
    options: Request,
    identity: Identity,
    *,
    journal: Journal | None,
    progress: Progress,
) -> Run:
    """Run a selection: first the motions in parallel, then the speeds, one case at a time.

    journal: stores the results of this run and supplies those of its interrupted part; None to store none.
    """
    start = time.perf_counter()
    cache = Cache.default()
    cache.prune()
    cache = cache.write_only() if options.reuse == "nothing" else cache
    # without a compilation, what was checked and loaded counts as part of the truths
    compiled = time.perf_counter() if _compile(selection, cache, progress) else start
    answers = Answers(journal, cache, options.timeout_s, reuse=options.reuse, run_id=identity.run_id)
    with closing(_clock(selection, options)) as clock:
        progress.phase("solving the truths")
        problems = [
            _solved(scenario, scenario_spec, cache, progress)
            for scenario_spec, scenario in selection.scenarios
        ]
        progress.motions_started()
        solved = time.perf_counter()
        found = run_motions(selection, problems, answers, options, progress)
        recorded = time.perf_counter()
        cases = tuple(case for studied in found.studies for case in studied.cases)
        rows = TABLES["methods"].rows(identity.run_id, MeasuredTables(cases, found.studies, found.rows))
        diagnoses = _diagnoses(selection, problems, cases, rows, progress)
        noise = None
        if options.speed:
            progress.speeds_started()
            cases, noise = measure_speeds(
                problems,
                cases,
                {engine.name: engine for engine, _ in selection.methods},
                answers,
                clock,
                timeout_s=options.timeout_s,
                passes=options.speed_passes,
                executor=options.timing_executor,
                case_done=progress.speed_measured,
            )
    ended = time.perf_counter()
    seconds = {
        "compile_s": compiled - start,
        "truths_s": solved - compiled,
        "motions_s": recorded - solved,
        "speeds_s": ended - recorded,
        "run_s": ended - compiled,
    }
    measured = MeasuredTables(cases, found.studies, {**found.rows, "diagnoses": diagnoses})
    others = [kind for kind in TABLES.values() if kind.name != "results"]
    return Run(
        run_id=identity.run_id,
        manifest=manifest_of(identity, selection, options, cases, seconds, noise),
        problems=tuple(problems),
        cases=cases,
        tables={kind.name: kind.rows(identity.run_id, measured) for kind in others},
        sentinels=tuple(found.sentinels),
    )


def _clock(selection: Selection, options: Request) -> Clock:
    """Return the clock of the speeds, which gets ready while truths are solved and motions recorded."""
    if options.timing_executor is not None:
        return Clock(None)
    clock = Clock(last_core())
    # a user's function is first called when its truth is solved, which reports its errors
    scenarios = [scenario for _, scenario in selection.scenarios if not scenario.scene.has_callback_load]
    if options.speed and scenarios:
        clock.warm_up(scenarios[0])
    return clock


def _diagnoses(
    selection: Selection,
    problems: Sequence[Problem],
    cases: Sequence[CaseResult],
    rows: Sequence[Row],
    progress: Progress,
) -> list[dict[str, Any]]:
    """Return the rows of diagnoses.csv without run_id: of the methods that verdicts count against."""
    if not wrong_verdicts(rows):
        return []
    progress.phase("diagnosing wrong motions")
    orders = {(engine.name, method.name): method.order for engine, method in selection.methods}
    return [diagnosis_row(one) for one in explained_cases(problems, cases, rows, orders)]


def _solved(scenario: AnyScenario, scenario_spec: str, cache: Cache, progress: Progress) -> Problem:
    """Return a scenario with its truth; report first if the truth is not cached and may take long."""
    scene = scenario.scene
    if not is_known(scene, scene.sample_times, cache):
        progress.truth_started(scenario.name)
    return Problem.of(scenario, scenario_spec, cache)


def _compile(selection: Selection, cache: Cache, progress: Progress) -> bool:
    """Compile what the reference's methods and the truths that are not cached will call.

    Returns whether anything had to be compiled.
    """
    compilations: list[int] = []

    def compiled(done: int, total: int) -> None:
        compilations.append(done)
        progress.compiling(done, total)

    scenes = [scenario.scene for _, scenario in selection.scenarios if isinstance(scenario, Scenario)]
    trees = [scenario.scene for _, scenario in selection.scenarios if isinstance(scenario, TreeScenario)]
    # a user's function is first called when its truth is solved, which reports its errors
    scenes = [scene for scene in scenes if not scene.has_callback_load]
    unsolved = [scene for scene in scenes if not is_known(scene, scene.sample_times, cache)]
    free = [scene.samples for scene in unsolved if scene.is_free_rotation]
    solves_truths = any(
        (engine.name, method.name) == ("reference", "exact") for engine, method in selection.methods
    )
    if not solves_truths and interprets_closed_forms(free):
        scenes, unsolved = ([one for one in some if not one.is_free_rotation] for some in (scenes, unsolved))
    probes = {f"probe-{name}": load_scenario(name).scene for name in PROBES if solves_truths}
    methods = [
        method.name
        for engine, method in selection.methods
        if engine.name == "reference" and method.control != "none"
    ]
    of_trees = [TREE_STEPS] if trees and methods else []
    if any(not is_known(scene, scene.sample_times, cache) for scene in trees):
        of_trees.insert(0, TREE_TRUTHS)
    compile_kernels(scenes, [*of_trees, *methods], unsolved, never_cached=probes, compiled=compiled)
    return bool(compilations)


def truth(scenario: str | Path, at: Sequence[float], *, allow_code: bool = False) -> Truth:
    """Return the true motion at the given times, with its error bounds.

    scenario: a built-in name or the path of a TOML file. at: n times in s, t >= 0, in any order; the arrays
    of the truth are (n,), (n, 3) and (n, 4) in the same order; of a tree (n, bodies, 3) and so on, with q and
    u, and bounds that are the largest of any body or joint. The motion starts from the numbers of the file,
    whereas engines receive them rounded to doubles; of a tree, axes and quaternions are rounded once.
    allow_code: whether the file may name functions.
    Raises InputError if the scenario is wrong, a time is negative or not finite, or the truth ends before it.
    """
    found = load_one(scenario, allow_code=allow_code)
    scene = found.scene_as_written if isinstance(found, Scenario) else found.scene
    try:
        times = np.array(at, dtype=np.float64)
        if times.ndim != 1:
            raise ValueError(f"at must be a list of times in s, like [0.0, 1.0], not {at!r}")
        solved = known_truth(scene, times, Cache.default())
    except (TypeError, ValueError) as error:
        raise InputError(str(error)) from None
    known = np.isfinite(solved.bounds).all(axis=0)
    if not known.all():
        first = float(times[~known].min())
        raise InputError(f"{scenario}: the truth ends before t = {first!r} s: {solved.end_reason}")
    return solved


def judge(
    trajectory: str | Path,
    scenario: str | Path | None = None,
    *,
    column_map: MapSpec | Sequence[MapSpec] = (),
    like: str | None = None,
    inertia_kg_m2: Sequence[float] | None = None,
    mass_kg: float = 1.0,
    torque_body_n_m: Sequence[float] | None = None,
    gravity_m_s2: Sequence[float] | None = None,
    allow_code: bool = False,
) -> dict[str, Any]:
    """Return the measures of a trajectory from any program, by column name.

    trajectory: a table of text, or an .npz, .parquet, .jsonl, .mcap or .aem file with t_s (n,) in s, and any
    of position_m (n, 3), velocity_m_s (n, 3), quaternion (n, 4) scalar first or rotation (n, 3, 3),
    omega_body_rad_s or omega_world_rad_s (n, 3); docs/recordings.md lists the columns of a table, and the
    keys of a column map: pairs as text, the path of a TOML file, its content, or several of these. like: the
    source of a file whose map, and perhaps scenario, is built in. inertia_kg_m2: instead of a scenario,
    principal moments (3,) or a tensor (9,) of a body that starts at the first row, with mass_kg, a constant
    torque (3,) in body axes and gravity (3,) in world axes. Measures of quantities that the file lacks are
    left out. allow_code: as for `truth`. Raises InputError if a file or a map is wrong.
    """
    body = None
    if inertia_kg_m2 is not None:
        body = GivenMotion(np.ravel(inertia_kg_m2).tolist(), mass_kg, torque_body_n_m, gravity_m_s2)
    ranking = rank([trajectory], scenario, column_map=column_map, like=like, body=body, allow_code=allow_code)
    return {name: value for name, value in ranking.rows[0].items() if name != "file"}


def is_tree(scenario: str | Path) -> bool:
    """Return whether a scenario is a tree of bodies; False where it cannot be read."""
    try:
        return isinstance(load_one(scenario), TreeScenario)
    except InputError:
        return False


def judge_tree(
    trajectory: str | Path, scenario: str | Path, steps_s: Sequence[float] | None = None
) -> JudgedTree:
    """Return how far a recording of a tree is from the truth; steps_s: the step of the program, if known.

    Raises InputError if the file is wrong.
    """
    tree = load_one(scenario)
    assert isinstance(tree, TreeScenario)
    if steps_s is not None and (len(steps_s) != 1 or not 0.0 < steps_s[0] < math.inf):
        raise InputError("--dt: one positive number is needed for one file")
    dt_s = None if steps_s is None else steps_s[0]
    if dt_s is not None:
        try:
            plan_steps(tree.scene, dt_s)
        except ValueError as error:
            raise InputError(f"--dt {dt_s}: {error}") from None
    return judged_tree(Path(trajectory), tree, str(scenario), dt_s, Cache.default())


def rank(
    trajectories: Sequence[str | Path],
    scenario: str | Path | None = None,
    steps_s: Sequence[float] | None = None,
    *,
    column_map: MapSpec | Sequence[MapSpec] = (),
    like: str | None = None,
    start: Start = "scenario",
    body: GivenMotion | None = None,
    allow_code: bool = False,
) -> Ranking:
    """Judge several trajectories of one scenario, best first, and fit their orders.

    steps_s: the step of each file. start: where the truth starts, at the start of the scenario or at the
    first sample of each file, whose resolution then enters the bound of the truth. body: instead of a
    scenario, a body and its loads; the truth then starts at the first sample. The others: as for `judge`.
    Raises InputError if a file or a map is wrong.
    """
    if unnamed := [one for one in trajectories if not isinstance(one, str | Path)]:
        raise InputError(f"a trajectory must be the path of a file, not {unnamed[0]!r}")
    paths = [Path(trajectory) for trajectory in trajectories]
    if steps_s is not None and (
        len(steps_s) != len(paths) or not all(0.0 < dt_s < math.inf for dt_s in steps_s)
    ):
        given = ", ".join(map(repr, steps_s))
        raise InputError(f"--dt {given}: one positive number per file is needed ({len(paths)} files)")
    found = _column_map(column_map, like)
    if body is None:
        spec = _scenario_spec(scenario, like, paths[0])
        loaded = load_scenario(spec, allow_code=allow_code)
        recordings = read_files(paths, found, steps_s)
    elif scenario is not None:
        raise InputError(f"{scenario}: a scenario and the inertia of a body cannot be combined")
    else:
        recordings = read_files(paths, replace(found, time_origin="first-sample"), steps_s)
        recordings, loaded = of_given_body(paths, recordings, body)
        spec, start = loaded.name, "first-sample"
    return judge_files(paths, recordings, loaded, spec, Cache.default(), steps_s, start)


def explain(
    trajectory: str | Path,
    scenario: str | Path | None = None,
    *,
    dt_s: float | None = None,
    column_map: MapSpec | Sequence[MapSpec] = (),
    like: str | None = None,
    resolution: str | None = None,
    allow_code: bool = False,
) -> ExplainedCase:
    """Return the diagnosis of a trajectory from any program.

    dt_s: the step of the program in s; without it, the motion is compared with the exact flow, and with maps
    that make one step per sample. resolution: of the quantities of the file, such as
    "omega=1e-3, attitude=1e-5", in SI units; without it, that of their digits. Other parameters and errors as
    for `judge`.
    """
    steps_s = None if dt_s is None else [dt_s]
    ranking = rank([trajectory], scenario, steps_s, column_map=column_map, like=like, allow_code=allow_code)
    return explained_motion(ranking.motions[0], dt_s, resolution)


def _column_map(column_map: MapSpec | Sequence[MapSpec], like: str | None) -> ColumnMap:
    several = isinstance(column_map, Sequence) and not isinstance(column_map, str)
    return read_map(column_map if several else (column_map,), like)  # type: ignore[arg-type]


def _scenario_spec(scenario: str | Path | None, like: str | None, path: Path) -> str:
    """Return the scenario of a trajectory; raise InputError where neither it nor its source names one."""
    known = scenario if scenario is not None else scenario_of(like, path)
    if known is None:
        raise InputError(
            "a scenario or a body is needed: --scenario NAME, --inertia-kg-m2 for a body that starts at the "
            "first row, or --like with a file of a known name"
        )
    return str(known)
