"""Explain the wrong motions of a stored run, or the cases that a pattern selects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.diagnosis.explain import (
    ExplainedCase,
    diagnosed_case,
    explained,
    explained_cases,
    wrong_verdicts,
)
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import MethodKey, Run, cases_by_method, key_of


@dataclass(frozen=True)
class _CasePattern:
    """SCENARIO[,ENGINE[:METHOD][,STEP]]."""

    scenario: str
    engine: str = "*"
    method: str = "*"
    step: float | None = None

    @classmethod
    def of(cls, text: str) -> _CasePattern:
        """Parse the option; raises InputError where it has another form."""
        scenario, *others = (part.strip() for part in text.split(","))
        try:
            step = float(others[1]) if len(others) > 1 else None
        except ValueError:
            raise InputError(f"--case {text}: {others[1]!r} is not a step in s") from None
        if not scenario or len(others) > 2:
            raise InputError(f"--case {text}: must be SCENARIO[,ENGINE[:METHOD][,STEP]]")
        engine, _, method = (others[0] if others else "*").partition(":")
        return cls(scenario, engine or "*", method or "*", step)

    def fits(self, case: CaseResult) -> bool:
        """Whether a case is one of those named."""
        columns = case.columns
        named = ((self.scenario, "scenario"), (self.engine, "engine"), (self.method, "method"))
        same = all(fnmatchcase(columns[column], pattern) for pattern, column in named)
        return same and self.step in (None, case.setting.fineness)


def explain_run(folder: Path, case: str | None, *, allow_code: bool = False) -> list[ExplainedCase]:
    """Return the diagnoses of a run: of every wrong method, or of the cases of a pattern.

    case: SCENARIO[,ENGINE[:METHOD][,STEP]]. Raises InputError where the run cannot be read, or has no such
    case.
    """
    pattern = None if case is None else _CasePattern.of(case)
    run = read_run(folder, allow_code=allow_code, cache=Cache.default())
    if pattern is None:
        rows: list[Any] = run.methods.to_dict("records")
        return explained_cases(run.problems, run.cases, rows, _orders(run))
    found = list(_named(run, pattern))
    if not found:
        known = dict.fromkeys(
            f"{one.columns['scenario']},{':'.join(key_of(one.columns))}" for one in run.cases if one.ok
        )
        raise InputError(f"--case {case}: no such case with outcome ok{suggestion(str(case), known)}")
    return found


def _orders(run: Run) -> dict[MethodKey, int | None]:
    """Return the theoretical orders of the methods, as the manifest has them."""
    return {
        (engine, method): facts.get("order")
        for engine, entry in run.manifest["engines"].items()
        for method, facts in entry.get("methods", {}).items()
    }


def _named(run: Run, pattern: _CasePattern) -> Iterator[ExplainedCase]:
    """Yield the diagnoses of the cases of a pattern: one of each method, unless the step is named."""
    rows: list[Any] = run.methods.to_dict("records")
    wrong, orders = wrong_verdicts(rows), _orders(run)
    by_method = cases_by_method(case for case in run.cases if pattern.fits(case))
    for problem in run.problems:
        name = problem.scenario.name
        for key, cases in by_method.get(name, {}).items():
            chosen = diagnosed_case(cases, problem.scenario.scene.sample_interval_s)
            if chosen is not None:
                verdicts = wrong.get((name, key), ())
                yield explained(problem, chosen, order=orders.get(key), wrong=verdicts)
