"""Which cases of a run are diagnosed, the wrong ones or those of a pattern; the rows of diagnoses.csv."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import setting, suggestion
from bodycheck.examine.diagnosis.candidate_maps import BASES, Base
from bodycheck.examine.diagnosis.consistency import is_refuted
from bodycheck.examine.diagnosis.diagnosis import ALL, LIBRARY_STEPS, Diagnosis, diagnosed
from bodycheck.examine.diagnosis.fit import Fit
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measures import IDENTITY
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.verdicts import FAULTS, QuantityVerdict, most_severe
from bodycheck.reports.run_files.run_tables import (
    FAILED_CASES,
    MethodKey,
    Run,
    StudyKey,
    cases_by_method,
    key_of,
    study_key,
)
from bodycheck.scenarios.model import Scenario

_FINEST_STRIDE = 40
"""Steps between two samples of the finest case that is diagnosed: few enough for a quick answer."""
MAX_EXPLAINED = 6
"""Failures that are diagnosed unasked: a motion without a known cause takes up to a minute."""
_MAX_STRIDE = 400  # of the case of a finding
_SAME_STEP = 1e-9  # relative


@dataclass(frozen=True, eq=False)
class ExplainedCase:
    """A case with the verdicts that count against its method, and its diagnosis.

    reason: why there is no diagnosis of a recording.
    """

    problem: Problem
    key: tuple[str, ...]
    case: CaseResult
    wrong: tuple[QuantityVerdict, ...]
    diagnosis: Diagnosis | None
    reason: str = ""

    @property
    def title(self) -> str:
        """Scenario, method and step."""
        at = setting(self.case.columns["control"], self.case.setting.fineness)
        fineness = "" if self.case.setting.fineness is None else f", {at}"
        return f"{self.problem.scenario.name}, {':'.join(self.key)}{fineness}"

    @property
    def explains_all(self) -> bool:
        """Whether the faults that the diagnosis names leave no error."""
        found = self.diagnosis
        return found is not None and found.verdict == "explained" and found.share > ALL

    @property
    def names_a_fault(self) -> bool:
        """Whether the diagnosis names faults, or a map of a lower order."""
        found = self.diagnosis
        return found is not None and bool(found.faults or found.verdict == "lower-order")


def wrong_verdicts(
    rows: Iterable[Mapping[str, Any]],
) -> dict[tuple[str, MethodKey], tuple[QuantityVerdict, ...]]:
    """Return the verdicts that count against each method, by scenario and method; rows: of methods.csv."""
    by_pair: dict[tuple[str, MethodKey], list[QuantityVerdict]] = {}
    for row in rows:
        by_pair.setdefault((row["scenario"], key_of(row)), []).append(QuantityVerdict.of(row))
    found = {pair: tuple(most_severe(verdicts)) for pair, verdicts in by_pair.items()}
    return {pair: verdicts for pair, verdicts in found.items() if verdicts}


def diagnosed_cases(
    cases: Iterable[CaseResult], interval_s: float, wrong: Sequence[QuantityVerdict] = ()
) -> list[CaseResult]:
    """Return the cases of a method to diagnose, in order; none if none ended well.

    That of a finding at one step alone; otherwise the finest one with at most 40 steps between samples, and
    then that of the finding, in which a fault may act that this one does not show. interval_s: between two
    samples. wrong: the findings, the most severe first.
    """
    by_step = _by_step(cases)

    def within(stride: int) -> list[CaseResult]:
        steps = ((one, 0 if one.dt_s is None else steps_per_sample(interval_s, one.dt_s)) for one in by_step)
        return [one for one, count in steps if count <= stride]

    found = [c for one in wrong[:1] for c in within(_MAX_STRIDE) if c.setting.fineness == one.fineness]
    if found and wrong[0].ratio is not None:
        return found
    first = (within(_FINEST_STRIDE) or by_step[-1:])[:1]
    return [*first, *(case for case in found if case not in first)]


def _by_step(cases: Iterable[CaseResult]) -> list[CaseResult]:
    """Return the cases that ended well, the finest first."""
    ended = [case for case in cases if case.ok and case.trajectory is not None]
    return sorted(ended, key=lambda case: case.setting.fineness or 0.0)


def explained(
    problem: Problem,
    case: CaseResult,
    *,
    order: int | None,
    wrong: Sequence[QuantityVerdict],
    known_faults: Sequence[tuple[str, ...]] = (),
    known_map: str = "",
) -> ExplainedCase:
    """Return a case with its diagnosis, as far as its truth reaches.

    order: of the method. known_faults: names of faults that explained other motions of the method, tried
    first. known_map: its fingerprint.
    """
    assert case.trajectory is not None
    scene = problem.scenario.scene
    if isinstance(scene, TreeScene):
        from bodycheck.examine.dynamics.tree_motion_diagnosis import diagnosed_tree  # imports numba

        precision = case.columns["precision"]
        motion = case.trajectory
        of_tree = diagnosed_tree(scene, motion, problem.scales, case.dt_s, order=order, precision=precision)
        return ExplainedCase(problem, key_of(case.columns), case, tuple(wrong), of_tree)
    found = diagnosed(
        scene,
        case.trajectory,
        problem.scales,
        case.dt_s,
        order=order,
        known_faults=known_faults,
        known_map=known_map,
    )
    return ExplainedCase(problem, key_of(case.columns), case, tuple(wrong), found)


def explained_cases(
    problems: Sequence[Problem],
    cases: Iterable[CaseResult],
    method_rows: Iterable[Mapping[str, Any]],
    orders: Mapping[MethodKey, int | None],
) -> list[ExplainedCase]:
    """Return one case of each method on each scenario where verdicts count against it, with its diagnosis.

    orders: the theoretical orders of the methods.
    """
    rows = list(method_rows)
    of_bodies = [problem for problem in problems if isinstance(problem.scenario, Scenario)]
    wrong, maps = wrong_verdicts(rows), _fingerprints(rows)
    by_method = cases_by_method(cases)
    known: dict[MethodKey, list[tuple[str, ...]]] = {}
    found = []
    for problem in problems:
        scene = problem.scenario.scene
        for (scenario, key), verdicts in wrong.items():
            if scenario != problem.scenario.name:
                continue
            own = by_method.get(scenario, {}).get(key, ())
            names = known.setdefault(key, [])
            one = None
            for case in diagnosed_cases(own, scene.sample_interval_s, verdicts):
                again = _explained(
                    problem,
                    case,
                    own,
                    order=orders.get(key),
                    wrong=verdicts,
                    known_faults=names,
                    known_map=maps[key],
                )
                if one is None or again.names_a_fault:
                    one = again
                if again.diagnosis is None or again.diagnosis.verdict != "healthy":
                    break
            if one is None:
                continue
            found.append(_with_cause_elsewhere(one))
            if one.diagnosis is not None and one.diagnosis.verdict == "explained":
                name = tuple(fault.name for fault in one.diagnosis.faults)
                known[key] = [name, *(other for other in names if other != name)]
    certain: dict[tuple[str, ...], list[frozenset[str]]] = {}
    for one in found:
        if (
            one.diagnosis is not None
            and one.diagnosis.verdict == "explained"
            and len(one.diagnosis.fits) == 1
        ):
            certain.setdefault(one.key, []).append(one.diagnosis.fault_names)
    separated = [_separated(one, certain.get(one.key, ())) for one in found]
    diagnoses = {(one.problem.scenario.name, one.key): one.diagnosis for one in separated}
    return [_tested(one, of_bodies, by_method, diagnoses) for one in separated]


def _explained(
    problem: Problem, case: CaseResult, cases: Iterable[CaseResult], **facts: Any
) -> ExplainedCase:
    """Return a case with its diagnosis, or that of another step if all of the error is explained there only.

    The finest one with few steps between two samples, as all maps of the library are tried for them.
    """
    one, scene = explained(problem, case, **facts), problem.scenario.scene
    found = one.diagnosis
    leaves_error = found is not None and found.verdict in ("explained", "nearest", "unexplained")
    if not leaves_error or one.explains_all or isinstance(scene, TreeScene):
        return one
    stepped = ((other, other.dt_s) for other in _by_step(cases) if other.dt_s is not None)
    few = (c for c, dt_s in stepped if steps_per_sample(scene.sample_interval_s, dt_s) <= LIBRARY_STEPS)
    coarser = next(few, case)
    again = one if coarser is case else explained(problem, coarser, **facts)
    return again if again.explains_all else one


def _fingerprints(method_rows: Iterable[Mapping[str, Any]]) -> dict[MethodKey, str]:
    """Return the known map of each method, "" where there is none."""
    return {key_of(row): str(row.get("fingerprint") or "") for row in method_rows}


def _with_cause_elsewhere(one: ExplainedCase) -> ExplainedCase:
    """Return a case with a finding without the statement that there is no fault, float32 excepted."""
    found = one.diagnosis
    if found is None or found.verdict != "healthy" or found.within or one.wrong[0].state == "lower-order":
        return one
    return replace(one, diagnosis=replace(found, verdict="elsewhere"))


def _tested(
    one: ExplainedCase,
    problems: Sequence[Problem],
    by_method: Mapping[str, Mapping[MethodKey, Sequence[CaseResult]]],
    diagnoses: Mapping[tuple[str, tuple[str, ...]], Diagnosis | None],
) -> ExplainedCase:
    """Return the case with those of its equally good fits that no other scene of the run refutes.

    If all are refuted, it is marked, or unexplained where they were the nearest faults only.
    """
    found = one.diagnosis
    if found is None or not found.fits:
        return one
    refuted_by = [
        next(_refuting(fit, BASES[found.base], one, problems, by_method, diagnoses), "") for fit in found.fits
    ]
    if left := [fit for fit, scene in zip(found.fits, refuted_by, strict=True) if not scene]:
        return replace(one, diagnosis=found.with_fits(left))
    if found.verdict == "nearest":
        return replace(one, diagnosis=found.without_faults)
    return replace(one, diagnosis=replace(found, verdict="this-scene-only", refuted_by=refuted_by[0]))


def _refuting(
    fit: Fit,
    base: Base,
    one: ExplainedCase,
    problems: Sequence[Problem],
    by_method: Mapping[str, Mapping[MethodKey, Sequence[CaseResult]]],
    diagnoses: Mapping[tuple[str, tuple[str, ...]], Diagnosis | None],
) -> Iterator[str]:
    """Yield the other scenes of the run that refute a fit to a case."""
    for problem in problems:
        scenario = problem.scenario.name
        own = by_method.get(scenario, {}).get(key_of(one.case.columns), ())
        case = None if scenario == one.problem.scenario.name else _comparable(own, one, problem)
        if case is None or case.trajectory is None:
            continue
        there = diagnoses.get((scenario, one.key))
        if is_refuted(fit, base, problem, case.trajectory, case.dt_s, there):
            yield scenario


def _comparable(cases: Sequence[CaseResult], one: ExplainedCase, problem: Problem) -> CaseResult | None:
    """Return the case of another scene in which the same fault would act.

    A fault at one step alone acts at that step; any other is looked for where it would be diagnosed.
    """
    if one.wrong and one.wrong[0].ratio is not None:
        at_s = one.case.dt_s or 0.0
        same = (c for c in cases if c.ok and abs((c.dt_s or 0.0) - at_s) <= _SAME_STEP * at_s)
        return next(same, None)
    return next(iter(diagnosed_cases(cases, problem.scenario.scene.sample_interval_s)), None)


def _separated(one: ExplainedCase, certain: Collection[frozenset[str]]) -> ExplainedCase:
    """Return the case with that of its equally good diagnoses which another scenario of its method has alone.

    certain: the names of the faults that explain another scenario, without an equally good diagnosis.
    """
    found = one.diagnosis
    if found is None or len(found.fits) < 2:
        return one
    confirmed = {fit.names: fit for fit in reversed(found.fits) if fit.names in certain}
    if len(confirmed) != 1:  # none, or scenarios that contradict one another
        return one
    return replace(one, diagnosis=found.with_fits([*confirmed.values()]))


def diagnosis_row(one: ExplainedCase) -> dict[str, Any]:
    """Return the row of diagnoses.csv of a diagnosed case; the parameter is that of the first fault."""
    columns, found = one.case.columns, one.diagnosis
    row: dict[str, Any] = {name: columns[name] for name in IDENTITY}
    row |= {name: columns[name] for name in ("dt_s", "tolerance") if columns.get(name) is not None}
    row |= {"quantity": one.wrong[0].quantity if one.wrong else "", "reproduce": columns["reproduce"]}
    if found is None:
        return {**row, "verdict": "not examined", "diagnosis": "not examined"}
    row |= {"verdict": found.verdict, "diagnosis": found.sentence}
    row |= {"map": found.base} if found.verdict != "unexplained" else {}
    row |= {"before": found.before, "after": found.after, "round_off": found.round_off}
    if found.faults:
        row |= {
            "faults": " + ".join(fault.name for fault in found.faults),
            "share": found.share,
            "alike": "; ".join(found.alike),
        }
        if parameters := found.faults[0].parameters:
            first = parameters[0]
            row |= {"parameter": first.name, "unit": first.unit, "value": first.value}
            row |= {"value_low": first.low, "value_high": first.high}
    return {name: value for name, value in row.items() if not _is_missing(value)}


def _is_missing(value: Any) -> bool:
    return isinstance(value, float) and not np.isfinite(value)


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
    """Return the diagnoses of a run: of failed checks and every wrong method, or of the cases of a pattern.

    Methods all of whose cases broke down are listed without a diagnosis; where no case ended well, so are
    those that do not support a scenario. case: SCENARIO[,ENGINE[:METHOD][,STEP]]. Raises InputError where the
    run cannot be read, or has no such case.
    """
    from bodycheck.reports.run_files.run_reader import read_run  # runs diagnose without it

    pattern = None if case is None else _CasePattern.of(case)
    run = read_run(folder, allow_code=allow_code, cache=Cache.default())
    if pattern is None:
        found = explained_cases(run.problems, run.cases, run.rows("methods"), _orders(run))
        named = {study_key(one.case.columns) for one in found}
        failed = run.manifest.get(FAILED_CASES, ())
        return [*_of_patterns(run, failed, named), *found, *_without_motion(run)]
    every = run.cases
    run = replace(run, cases=tuple(one for one in run.cases if pattern.fits(one)))
    if not run.cases:
        known = dict.fromkeys(f"{one.columns['scenario']},{':'.join(key_of(one.columns))}" for one in every)
        raise InputError(f"--case {case}: no such case{suggestion(str(case), known)}")
    return [*_named(run), *_without_motion(run)]


def with_causes(run: Run, cases: Sequence[str]) -> Run:
    """Return a run with the faults that explain these cases, named as `explain --case` names them.

    The run itself diagnoses only what verdicts count against: the order of a user's function is not known.
    """
    known = run.rows("diagnoses")
    found = _of_patterns(run, cases, {study_key(row) for row in known})
    rows = [{"run_id": run.run_id, **diagnosis_row(one)} for one in found if one.names_a_fault]
    return run.with_rows(diagnoses=[*known, *rows])


def _of_patterns(run: Run, texts: Iterable[str], done: Collection[StudyKey]) -> list[ExplainedCase]:
    """Return the diagnoses of the cases of some patterns, without those of `done`."""
    patterns = [_CasePattern.of(text) for text in texts]
    others = (case for case in run.cases if study_key(case.columns) not in done)
    return list(_named(replace(run, cases=tuple(c for c in others if any(one.fits(c) for one in patterns)))))


def _without_motion(run: Run) -> Iterator[ExplainedCase]:
    """Yield the last case of each method all of whose cases failed or were unstable, without a diagnosis.

    Where no case of the run ended well, also yield that of each method that is unsupported.
    """
    listed = FAULTS if any(case.ok for case in run.cases) else (*FAULTS, "unsupported")
    by_method = cases_by_method(run.cases)
    for problem in run.problems:
        for key, cases in by_method.get(problem.scenario.name, {}).items():
            last = cases[-1]
            if last.columns["outcome"] in listed and not any(case.ok for case in cases):
                yield ExplainedCase(problem, key, last, (), None)


def _orders(run: Run) -> dict[MethodKey, int | None]:
    """Return the theoretical orders of the methods, as the manifest has them."""
    return {
        (engine, method): facts.get("order")
        for engine, entry in run.manifest["engines"].items()
        for method, facts in entry.get("methods", {}).items()
    }


def _named(run: Run) -> Iterator[ExplainedCase]:
    """Yield the diagnosis of one case of each method, whatever its verdicts."""
    rows = run.rows("methods")
    wrong, orders, maps = wrong_verdicts(rows), _orders(run), _fingerprints(rows)
    by_method = cases_by_method(run.cases)
    for problem in run.problems:
        name = problem.scenario.name
        for key, cases in by_method.get(name, {}).items():
            for chosen in diagnosed_cases(cases, problem.scenario.scene.sample_interval_s)[:1]:
                verdicts = wrong.get((name, key), ())
                known = maps.get(key, "")
                order = orders.get(key)
                yield _explained(problem, chosen, cases, order=order, wrong=verdicts, known_map=known)
