"""Methods whose lines lie on top of one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bodycheck.reports.case import CaseResult
from bodycheck.reports.findings import MethodKey, key_of
from bodycheck.reports.styles import Style


def coinciding(cases: Sequence[CaseResult]) -> list[list[MethodKey]]:
    """Return the groups of methods whose orientation errors are equal to 3 digits at every step.

    Their lines lie on top of one another. Methods with fewer than two errors are left out.
    """
    errors: dict[MethodKey, list[tuple[float, str]]] = {}
    for case in cases:
        if case.ok and case.dt_s is not None:
            error = f"{case.columns['orientation_error_rad']:.2e}"
            errors.setdefault(key_of(case.columns), []).append((case.dt_s, error))
    groups: dict[tuple[tuple[float, str], ...], list[MethodKey]] = {}
    for key, line in errors.items():
        if len(line) > 1:
            groups.setdefault(tuple(line), []).append(key)
    return [group for group in groups.values() if len(group) > 1]


def ranks(cases: Sequence[CaseResult], drawn: Mapping[MethodKey, Style]) -> dict[int, int]:
    """Return how many engines lie on top of a line: it is drawn so much wider, to show beneath them."""
    found = {}
    for group in coinciding(cases):
        engines = list(dict.fromkeys(engine for engine, _ in group))
        for key in group:
            found[drawn[key].number] = len(engines) - 1 - engines.index(key[0])
    return found
