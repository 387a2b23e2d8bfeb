"""Run a case again whose motion a history has removed."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck.adapters.engine_names import admit
from bodycheck.adapters.execution import Case
from bodycheck.adapters.workers.engine_pool import EnginePool, announced
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem

_TIMEOUT_S = 600.0


def motion_again(
    path: Path, problem: Problem, case: CaseResult, cache: Cache | None, *, allow_code: bool
) -> Trajectory:
    """Return the motion of a case, from the cache or by running its engine in the same version.

    path: the file that was removed. allow_code: the case may name a program, which is started. Raises
    InputError if the engine is not available or gives no motion.
    """
    row = case.columns
    name, version = row["engine"], row.get("engine_version")
    admit((name,), allow_code=allow_code, file=path)
    engine = announced([name])[name]
    if isinstance(engine, str):
        raise InputError(f"{path}: was removed, and cannot be computed again: {engine}")
    if engine.version != version:
        fault = f"needs {name} {version}, but version {engine.version} is installed"
        raise InputError(f"{path}: was removed, and cannot be computed again: {fault}")
    answers = Answers(None, cache, _TIMEOUT_S, reuse="everything")
    with closing(EnginePool()) as engine_pool:
        answer = answers.ask(engine_pool, engine, Case(problem.scenario.scene, row["method"], case.setting))
    if answer.trajectory is None:
        raise InputError(f"{path}: was removed, and ended with {answer.outcome} now: {answer.message}")
    return answer.trajectory
