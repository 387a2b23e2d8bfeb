"""Compare methods with known one-step maps, and check their laws, outside a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reports.cache.answers import Answers, EngineClient
from bodycheck.reports.probes.examination import examined, replayed
from bodycheck.reports.probes.fingerprint import (
    CONSTANT_LOADS,
    CONTINUOUS_LOADS,
    fingerprint_of,
    fingerprint_row,
)
from bodycheck.runs.selection import select
from bodycheck.scenarios.library import PROBES


def fingerprints(
    engines: str, *, timeout_s: float, all_loads: bool = False, allow_code: bool = False
) -> list[dict[str, Any]]:
    """Return the rows of fingerprints.csv, without run_id, of NAME[==VERSION][:METHOD],...

    all_loads: also under loads that vary with time and motion, whose kernels may have to be compiled.
    """
    loads = {**CONSTANT_LOADS, **CONTINUOUS_LOADS} if all_loads else CONSTANT_LOADS
    with _methods(engines, timeout_s, allow_code=allow_code) as (methods, client):
        return [
            fingerprint_row(engine, method, fingerprint_of(engine, method, client.ask, loads))
            for engine, method in methods
        ]


def laws(engines: str, *, timeout_s: float, allow_code: bool = False) -> list[dict[str, Any]]:
    """Return the rows of laws.csv, without run_id, of NAME[==VERSION][:METHOD],..."""
    rows: list[dict[str, Any]] = []
    with _methods(engines, timeout_s, allow_code=allow_code) as (methods, client):
        for engine, of_engine in groupby(methods, key=lambda pair: pair[0]):
            own = [method for _, method in of_engine]
            replays = replayed(engine, own, client)
            for method in own:
                rows += [*examined(engine, method, client, laws=True)["laws"], *replays[method.name]]
    return rows


@contextmanager
def _methods(
    engines: str, timeout_s: float, *, allow_code: bool
) -> Iterator[tuple[Sequence[tuple[Engine, Method]], EngineClient]]:
    """Yield the methods, and what answers their cases."""
    selection = select(PROBES[:1], engines.split(","), allow_code=allow_code)
    if not selection.methods:
        raise InputError(f"{engines}: no method to compare")
    pool = EnginePool()
    try:
        yield selection.methods, EngineClient(Answers(None, None, timeout_s), pool)
    finally:
        pool.close()
