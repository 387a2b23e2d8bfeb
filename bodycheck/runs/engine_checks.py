"""Check engines outside a run: adapters against the contract, methods against known maps and laws."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.engine_names import is_program
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.examine.dynamics.engine_dynamics import LABELS
from bodycheck.examine.probes.adapter_checks import CHECKS, Check, CheckBench
from bodycheck.examine.probes.examination import map_and_laws, replayed
from bodycheck.examine.probes.finding import Finding
from bodycheck.examine.probes.fingerprint import (
    CONSTANT_LOADS,
    continuous_loads,
    fingerprint_of,
    fingerprint_row,
)
from bodycheck.examine.probes.laws import law_rows
from bodycheck.examine.probes.tree_laws import check_tree_laws
from bodycheck.reports.cache.answers import Answers, EngineClient
from bodycheck.reports.document import Command, Document, Sentence, Table
from bodycheck.reports.table_layout import Column, Span
from bodycheck.runs.dynamics_run import DynamicsOptions, dynamics
from bodycheck.runs.selection import select
from bodycheck.scenarios.library import PROBES

_OF_TREES = "what the engine reports of trees is right"
_TREES = 4
"""Random trees of which an adapter is checked."""


@dataclass(frozen=True)
class CheckResult:
    """One finding of one check of one method; after: checks whose failure can make this one fail too."""

    method: str
    check: str
    requirement: str
    finding: str
    verdict: str
    message: str
    after: tuple[str, ...] = ()

    @property
    def failed(self) -> bool:
        """Whether the adapter breaks the contract here."""
        return self.verdict == "inconsistent"


@dataclass(frozen=True)
class Conformance:
    """The results of all checks of an adapter."""

    engine: str
    version: str
    results: tuple[CheckResult, ...]

    @property
    def failures(self) -> tuple[CheckResult, ...]:
        """The results of failed checks."""
        return tuple(result for result in self.results if result.failed)


def check_adapter(name: str, *, timeout_s: float, allow_code: bool = False) -> Conformance:
    """Run every check on one engine, NAME[:METHOD], cmd:COMMAND[::METHOD] or MODULE:FUNCTION.

    Raises InputError for an unknown or unavailable engine.
    """
    with _methods([name], timeout_s, allow_code=allow_code) as (methods, client):
        results = [
            result
            for engine, method in methods
            for check in CHECKS
            for result in _results(CheckBench(engine, method, client.ask, client.replay), check)
        ]
    engine = methods[0][0]
    results += _of_trees(engine.name, timeout_s)
    return Conformance(engine.name, engine.version, tuple(results))


def _of_trees(engine: str, timeout_s: float) -> Iterator[CheckResult]:
    """Yield a result per reading of an adapter that builds trees."""
    if is_program(engine):
        return
    found = dynamics(engine, (), DynamicsOptions(random=_TREES, timeout_s=timeout_s))
    for one in found.readings:
        if all(other.verdict == "unsupported" for other in found.readings):
            return
        causes = [cause.text for cause in found.causes if one.reading in cause.readings]
        text = "; ".join(causes) or f"off by {one.worst or 0.0:.2g} of its size in {one.at}"
        verdict = {"right": "consistent", "unsupported": "not-measured"}.get(one.verdict, "inconsistent")
        message = text if verdict == "inconsistent" else "; ".join(one.reasons)
        if verdict == "inconsistent" and one.known_fault:
            verdict, message = "not-measured", one.known_fault
        label = LABELS[one.reading]
        yield CheckResult(
            "(trees)", label, "what the engine reports of trees is right", label, verdict, message
        )


def _results(bench: CheckBench, check: Check) -> Iterator[CheckResult]:
    found = list(check.findings(bench)) or [Finding("", message="it fails in the checks above")]
    for one in found:
        name, requirement = check.name, check.requirement
        yield CheckResult(
            bench.method.name, name, requirement, one.check, one.verdict, one.message, check.after
        )


_VERDICT_TEXTS = {
    "inconsistent": Span("fails", "bad"),
    "consistent": Span("passes", "good"),
    "not-measured": Span("not checked", "open"),
}
_HEADS = (
    Column("method", "fixed"),
    Column("check", "fixed"),
    Column("result", "fixed"),
    Column("requirement or fault"),
)


def conformance_document(found: Conformance) -> Document:
    """Return one row per method and check: what holds, or each failure in words."""
    rows: list[tuple[str | Span, ...]] = []
    messages: set[str] = set()
    failed: dict[str, list[str]] = {}
    following = 0
    for (method, check), group in groupby(found.results, key=lambda result: (result.method, result.check)):
        results, before = list(group), failed.setdefault(method, [])
        causes = [name for name in before if name in results[0].after]
        if any(result.failed for result in results):
            before.append(check)
            if causes:
                following += 1
                number = sum(result.failed for result in results)
                text = f"{count(number, 'finding')} that may follow from {causes[0]}"
                rows.append((method, check, _VERDICT_TEXTS["inconsistent"], text))
                continue
        rows += _rows(method, check, results, messages)
    failures = sum(map(len, failed.values()))
    total = len({(result.method, result.check) for result in found.results})
    summary = f"{found.engine} {found.version}: " + (
        f"{failures} of {total} checks fail" if failures else f"all {total} checks pass or do not apply"
    )
    if following:
        first = ", ".join(dict.fromkeys(names[0] for names in failed.values() if names))
        summary += f", of which {following} may follow from others; correct first: {first}"
    table = Table(_HEADS, tuple(rows))
    tint = "bad" if failures else "good"
    conclusion = Sentence(summary, tint, strong=True)
    next_step = Command(f"bodycheck run smoke --engine {shlex.quote(found.engine)}", "errors and orders")
    return Document(
        "bodycheck check-adapter", (conclusion, table) if failures else (conclusion, table, next_step)
    )


def _rows(
    method: str, check: str, results: list[CheckResult], messages: set[str]
) -> Iterator[tuple[str | Span, ...]]:
    """Yield a row per failure; without one, a row with the requirement, or why nothing was checked.

    messages: the messages so far; a failure that repeats one is only counted.
    """
    failures = [result for result in results if result.failed]
    repeated = 0
    for result in failures:
        if result.message in messages:
            repeated += 1
            continue
        messages.add(result.message)
        yield method, check, _VERDICT_TEXTS["inconsistent"], f"{result.finding}: {result.message}"
    if repeated:
        yield (
            method,
            check,
            _VERDICT_TEXTS["inconsistent"],
            f"{count(repeated, 'finding')} with a message above",
        )
    if failures:
        return
    skipped = dict.fromkeys(result.message for result in results if result.verdict == "not-measured")
    if all(result.verdict == "not-measured" for result in results):
        yield method, check, _VERDICT_TEXTS["not-measured"], "; ".join(skipped)
        return
    remark = f" ({'; '.join(skipped)})" if skipped else ""
    yield method, check, _VERDICT_TEXTS["consistent"], f"{results[0].requirement}{remark}"


def fingerprints(
    engines: str, *, timeout_s: float, all_loads: bool = False, allow_code: bool = False
) -> list[dict[str, Any]]:
    """Return the rows of fingerprints.csv, without run_id, of NAME[==VERSION][:METHOD],...

    all_loads: also under loads that vary with time and motion, whose kernels may have to be compiled.
    """
    loads = {**CONSTANT_LOADS, **continuous_loads()} if all_loads else CONSTANT_LOADS
    with _methods(engines.split(","), timeout_s, allow_code=allow_code) as (methods, client):
        return [
            fingerprint_row(engine, method, fingerprint_of(engine, method, client.ask, loads))
            for engine, method in methods
        ]


def laws(engines: str, *, timeout_s: float, allow_code: bool = False) -> list[dict[str, Any]]:
    """Return the rows of laws.csv, without run_id, of NAME[==VERSION][:METHOD],..."""
    rows: list[dict[str, Any]] = []
    with _methods(engines.split(","), timeout_s, allow_code=allow_code) as (methods, client):
        for engine, of_engine in groupby(methods, key=lambda pair: pair[0]):
            own = [method for _, method in of_engine]
            replays = replayed(engine, own, client)
            for method in own:
                rows += [*map_and_laws(engine, method, client)["laws"], *replays[method.name]]
                of_trees = check_tree_laws(engine, method, client.ask, client.replay)
                rows += law_rows(engine, method, of_trees)
    return rows


@contextmanager
def _methods(
    engines: Sequence[str], timeout_s: float, *, allow_code: bool
) -> Iterator[tuple[Sequence[tuple[Engine, Method]], EngineClient]]:
    """Yield the methods, and what answers their cases."""
    selection = select(PROBES[:1], engines, allow_code=allow_code)
    if not selection.methods:
        raise InputError(f"{','.join(engines)}: no method to check")
    pool = EnginePool()
    try:
        yield selection.methods, EngineClient(Answers(None, None, timeout_s), pool)
    finally:
        pool.close()
