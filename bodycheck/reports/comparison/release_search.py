"""The command that finds the release in which a measure changed, where two runs have different releases."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator

from bodycheck.adapters.pins import is_version, pin_of
from bodycheck.adapters.registry import distribution_of
from bodycheck.reports.case import asked_as
from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.headlines import ORIENTATION, by_method
from bodycheck.reports.stored import Tables

_PREFIXES = {"order": "order.", "verdict": "verdict."}
_STATUSES = ("worse", "improved", "moved")


def release_searches(comparison: Comparison) -> Iterator[str]:
    """Yield `bodycheck versions ...` for each engine whose release changed, and a measure with it.

    It looks for the change of the largest factor among the worse ones, else the improved, else the moved.
    """
    for engine in dict.fromkeys(one.engine for one in by_method(comparison.changes)):
        versions = [_version(run, engine) for run in (comparison.before, comparison.after)]
        since, until = versions
        if since is None or until is None or since == until or _distribution(engine) is None:
            continue
        if (
            change := _telling(change for change in comparison.changes if change.engine == engine)
        ) is not None:
            yield _command(comparison.after, change, *sorted((since, until), key=_numbers))


def _version(run: Tables, engine: str) -> str | None:
    version = run.manifest["engines"].get(engine, {}).get("version")
    return version if isinstance(version, str) and is_version(version) else None


def _distribution(engine: str) -> str | None:
    pin = pin_of(engine)
    return distribution_of(engine) if pin is None else None


def _numbers(version: str) -> list[int]:
    return [int(number) for number in version.split(".") if number.isdecimal()]


def _telling(changes: Iterable[Change]) -> Change | None:
    """Return the change that a search should look for: of a measure, else of an order or a verdict."""
    kinds = ("accuracy", "order", "verdict")
    found = [one for one in changes if one.kind in kinds and one.status in _STATUSES]

    def rank(one: Change) -> tuple[int, int, bool, float]:
        size = one.size if one.kind == "accuracy" else 0.0
        return _STATUSES.index(one.status), kinds.index(one.kind), one.what != ORIENTATION, -size

    return min(found, key=rank, default=None)


def _command(run: Tables, change: Change, since: str, until: str) -> str:
    who = change.scenario, change.engine, change.method
    rows = (case.columns for case in run.cases)
    mine = next(row for row in rows if (row["scenario"], row["engine"], row["method"]) == who)
    measure = _PREFIXES.get(change.kind, "") + change.what.rpartition(" ")[2]
    words = ["bodycheck", "versions", change.engine, "--since", since, "--until", until]
    words += ["--scenario", asked_as(mine["reproduce"]) or str(change.scenario)]
    words += ["--method", change.method, "--measure", measure]
    if change.control == "dt" and change.fineness is not None:
        words += ["--dt", repr(change.fineness)]
    if change.status == "moved":
        words += ["--threshold", "0"]
    return shlex.join(words)
