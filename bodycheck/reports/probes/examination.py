"""What the answers of an engine show without a truth: probes, known map, laws and replays, as rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bodycheck.adapters.contract import Engine, Method
from bodycheck.reports.cache.answers import Asker
from bodycheck.reports.probes.fingerprint import fingerprint_of, fingerprint_row
from bodycheck.reports.probes.laws import check_laws, law_rows
from bodycheck.reports.probes.probe import probe_rows
from bodycheck.reports.probes.replay import check_replays


def examined(engine: Engine, method: Method, asker: Asker, *, laws: bool) -> dict[str, Any]:
    """Return the rows of probes.csv and, with laws, of fingerprints.csv and laws.csv, by table."""
    rows: dict[str, Any] = {"probes": probe_rows(engine, method, asker.ask), "fingerprints": [], "laws": []}
    if laws:
        found = fingerprint_of(engine, method, asker.ask)
        checked = check_laws(engine, method, asker.ask, asker.replay, reversible=found.reversible)
        rows["fingerprints"].append(fingerprint_row(engine, method, found))
        rows["laws"] += law_rows(engine, method, checked)
    return rows


def replayed(engine: Engine, methods: Sequence[Method], asker: Asker) -> dict[str, Any]:
    """Return the rows of the law `replay` by method; it restarts the engine."""
    found = check_replays(engine, methods, asker.ask, asker.again(engine))
    return {method.name: law_rows(engine, method, [found[method.name]]) for method in methods}
