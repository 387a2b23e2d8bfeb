"""Compare methods with known one-step maps, and check their laws, outside a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.probes.fingerprint import (
    CONSTANT_LOADS,
    CONTINUOUS_LOADS,
    Asking,
    fingerprint_of,
    fingerprint_row,
)
from bodycheck.reports.probes.laws import check_laws, law_rows
from bodycheck.runs.selection import select
from bodycheck.scenarios.library import PROBES


def fingerprints(
    engines: str, *, timeout_s: float, all_loads: bool = False, allow_code: bool = False
) -> list[dict[str, Any]]:
    """Return the rows of fingerprints.csv, without run_id, of NAME[==VERSION][:METHOD],...

    all_loads: also under loads that vary with time and motion, whose kernels may have to be compiled.
    """
    loads = {**CONSTANT_LOADS, **CONTINUOUS_LOADS} if all_loads else CONSTANT_LOADS
    with _methods(engines, timeout_s, allow_code=allow_code) as methods:
        return [
            fingerprint_row(engine, method, fingerprint_of(engine, method, ask, loads))
            for engine, method, ask, _ in methods
        ]


def laws(engines: str, *, timeout_s: float, allow_code: bool = False) -> list[dict[str, Any]]:
    """Return the rows of laws.csv, without run_id, of NAME[==VERSION][:METHOD],..."""
    rows: list[dict[str, Any]] = []
    with _methods(engines, timeout_s, allow_code=allow_code) as methods:
        for engine, method, ask, again in methods:
            reversible = fingerprint_of(engine, method, ask).reversible
            rows += law_rows(engine, method, check_laws(engine, method, ask, again, reversible=reversible))
    return rows


@contextmanager
def _methods(
    engines: str, timeout_s: float, *, allow_code: bool
) -> Iterator[list[tuple[Engine, Method, Asking, Asking]]]:
    """Yield the methods with functions that run and replay their cases."""
    selection = select(PROBES[:1], engines.split(","), allow_code=allow_code)
    if not selection.methods:
        raise InputError(f"{engines}: no method to compare")
    answers, pool = Answers(None, None, timeout_s), EnginePool()
    ask: Callable[..., Any] = partial(answers.ask, pool)
    again: Callable[..., Any] = partial(answers.replay, pool)
    try:
        yield [(engine, method, ask, again) for engine, method in selection.methods]
    finally:
        pool.close()
