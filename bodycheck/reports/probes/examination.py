"""What the answers of an engine show without a truth: probes, known map, laws and replays, as rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

from bodycheck.adapters.contract import Engine, Method
from bodycheck.reports.cache.answers import Asker
from bodycheck.reports.probes.fingerprint import fingerprint_of, fingerprint_row
from bodycheck.reports.probes.laws import REPLAY, check_laws, law_rows
from bodycheck.reports.probes.probe import probe_rows
from bodycheck.reports.probes.replay import OTHER_BITS, SAME_BITS, check_replays

Row: TypeAlias = Mapping[str, Any]


def examined(engine: Engine, method: Method, asker: Asker, *, laws: bool) -> dict[str, Any]:
    """Return the rows of probes.csv and, with laws, of fingerprints.csv and laws.csv, by table."""
    rows: dict[str, Any] = {"probes": probe_rows(engine, method, asker.ask), "fingerprints": [], "laws": []}
    if laws:
        found = fingerprint_of(engine, method, asker.ask)
        checked = check_laws(engine, method, asker.ask, asker.replay, reversible=found.reversible)
        rows["fingerprints"].append(fingerprint_row(engine, method, found))
        rows["laws"] += law_rows(engine, method, checked)
    return rows


_REPLAYS = {"holds": SAME_BITS, "property": OTHER_BITS, "not-measured": None}


def identified(
    method_rows: Iterable[Row], fingerprints: Iterable[Row], laws: Iterable[Row]
) -> Iterator[dict[str, Any]]:
    """Yield rows of methods.csv with the known map of each method, and whether it gives the same bits again.

    fingerprints, laws: the rows of these tables.
    """
    maps = {_of(row): row["fingerprint"] for row in fingerprints}
    replays = {_of(row): _REPLAYS[row["verdict"]] for row in laws if row["law"] == REPLAY}
    for row in method_rows:
        key = _of(row)
        yield {**row, "fingerprint": maps.get(key), "replay": replays.get(key)}


def _of(row: Row) -> tuple[str, str]:
    return row["engine"], row["method"]


def replayed(engine: Engine, methods: Sequence[Method], asker: Asker) -> dict[str, Any]:
    """Return the rows of the law `replay` by method; it restarts the engine."""
    found = check_replays(engine, methods, asker.ask, asker.again(engine))
    return {method.name: law_rows(engine, method, [found[method.name]]) for method in methods}
