"""Two versions of an engine, each alone in its run, compared under the engine's own name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from bodycheck.adapters.pins import pin_of
from bodycheck.reports.case import CaseResult
from bodycheck.reports.stored import Tables


def paired_versions(before: Tables, after: Tables) -> tuple[Tables, Tables]:
    """Return both runs with `mujoco==3.17.0` of one and `mujoco==4.0.0` of the other as `mujoco`.

    An engine of which either run has several versions keeps its names: there each version is an engine.
    """
    old, new = _names(before), _names(after)
    alone = [
        base
        for base in old.keys() & new.keys()
        if len(old[base]) == len(new[base]) == 1 and old[base] != new[base]
    ]
    return _renamed(before, {name: base for base in alone for name in old[base]}), _renamed(
        after, {name: base for base in alone for name in new[base]}
    )


def _names(tables: Tables) -> dict[str, set[str]]:
    """Return the names under which each engine stands in a run: with and without versions."""
    found: dict[str, set[str]] = {}
    for name in _engines(tables):
        pin = pin_of(name)
        found.setdefault(name if pin is None else pin.engine, set()).add(name)
    return found


def _engines(tables: Tables) -> Iterable[str]:
    return dict.fromkeys((*tables.manifest["engines"], *(case.columns["engine"] for case in tables.cases)))


def _renamed(tables: Tables, names: Mapping[str, str]) -> Tables:
    if not any(name != base for name, base in names.items()):
        return tables

    def case(one: CaseResult) -> CaseResult:
        engine = one.columns["engine"]
        return replace(one, columns={**one.columns, "engine": names.get(engine, engine)})

    engines: dict[str, Any] = {
        names.get(name, name): about for name, about in tables.manifest["engines"].items()
    }
    return replace(
        tables,
        results=tables.results.replace({"engine": names}),
        methods=tables.methods.replace({"engine": names}),
        stability=tables.stability.replace({"engine": names}),
        manifest={**tables.manifest, "engines": engines},
        cases=tuple(map(case, tables.cases)),
    )
