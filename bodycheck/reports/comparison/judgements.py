"""Compare the verdicts and orders of methods."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

from bodycheck.reports.comparison.change import Change, Status, by_rank
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.measurement.verdicts import UNDECIDED, severity

_LEAST_ORDER_CHANGE = 0.05

_Row: TypeAlias = Mapping[str, Any]


def verdict_change(before: _Row, after: _Row, errors: Sequence[Change]) -> Change | None:
    """Return the change of the verdict of one quantity; None if it did not change.

    A more severe verdict is worse. A change between sound and undecided counts only if an error of the
    quantity changed in the same direction, because with smaller errors or other steps an order may no longer
    be observable. before, after: rows of methods.csv without empty cells. errors: the changes of accuracy of
    the method on the scenario.
    """
    old, new = before["verdict"], after["verdict"]
    if old == new:
        return None
    status = by_rank(-severity(old), -severity(new))
    if max(severity(old), severity(new)) <= UNDECIDED:
        quantity = after["quantity"]
        of_it = {one.status for one in errors if one.quantity == quantity or quantity not in MEASURES}
        status = status if status in of_it else "moved"
    return _change("verdict", after, old, new, status)


def order_change(before: _Row, after: _Row, theory: float | None, thresholds: Thresholds) -> Change | None:
    """Return the change of the order of one quantity; None if the intervals overlap or it is negligible.

    An order is worse if its whole interval fell below theory by more than the threshold; an order that fell
    towards theory, or rose above it, moved. theory: the higher theoretical order of the two runs; if None,
    the higher of the two observed orders.
    """
    if "order" not in before or "order" not in after:
        return None
    up = after["order_low"] > before["order_high"]
    down = after["order_high"] < before["order_low"]
    old, new = before["order"], after["order"]
    if not (up or down) or abs(new - old) <= _LEAST_ORDER_CHANGE:
        return None
    lower = before if up else after
    least = max(old, new) if theory is None else min(theory, max(old, new))
    below = lower["order_high"] < least - thresholds.of_order(after["quantity"])
    status: Status = "moved" if not below else "improved" if up else "worse"
    return _change("order", after, old, new, status)


def changed_judgements(
    before: Mapping[tuple[Any, ...], _Row],
    after: Mapping[tuple[Any, ...], _Row],
    theories: Mapping[tuple[str, str], float | None],
    errors: Sequence[Change],
    thresholds: Thresholds,
) -> Iterator[Change]:
    """Yield the changes of all verdicts and orders that both runs have.

    before, after: rows of methods.csv by scenario, engine, method and quantity. theories: the theoretical
    order by engine and method.
    """
    by_method: dict[tuple[Any, ...], list[Change]] = {}
    for one in errors:
        by_method.setdefault((one.scenario, one.engine, one.method), []).append(one)
    for key in after:
        if key not in before:
            continue
        scenario, engine, method, _ = key
        a, b = before[key], after[key]
        found = (
            verdict_change(a, b, by_method.get((scenario, engine, method), ())),
            order_change(a, b, theories.get((engine, method)), thresholds),
        )
        yield from (change for change in found if change is not None)


def _change(kind: Any, row: _Row, old: float | str, new: float | str, status: Status) -> Change:
    who = row["scenario"], row["engine"], row["method"]
    return Change(kind, *who, f"{kind} of {row['quantity']}", old, new, status)
