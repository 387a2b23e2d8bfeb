"""Summarise a comparison in one sentence per engine: the net change per method, the largest factor first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bodycheck._util.formatting import count, number, setting
from bodycheck.adapters.engine_names import pin_of
from bodycheck.reports.comparison.change import FAILING, Change, Status
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.measurement.measures import ORIENTATION

_MAX_METHODS = 6
_FARTHER_DECADES = 1.0  # a measure that changed by this much more than the orientation is named as well
_DIGITS_BELOW = 1e-3  # a smaller relative change is reported as a digit, a larger one in percent


@dataclass(frozen=True)
class MethodChanges:
    """All changes of one method, the largest first."""

    engine: str
    method: str
    changes: tuple[Change, ...]

    def of(self, status: Status) -> list[Change]:
        """Return the changes with one status."""
        return [change for change in self.changes if change.status == status]

    @property
    def failing(self) -> list[Change]:
        """The changes that fail a comparison."""
        return [change for change in self.changes if change.status in FAILING]

    @property
    def net(self) -> Status:
        """The dominant status: worse or improved by the larger factor, if there is either, else the others.

        A changed outcome, and a failing change without a factor, such as another verdict, outweigh any
        factor. A worse change wins a tie.
        """
        worse, improved = _weight(self.failing), _weight(self.of("improved"))
        if self.of("improved") and improved > worse:
            return "improved"
        present = {change.status for change in self.changes}
        return next(
            status for status in ("worse", "missing", "improved", "moved", "new") if status in present
        )

    @property
    def identity_change(self) -> str:
        """The changes of the one-step map and of laws, like ", one-step map M1 -> M2"; "" without one."""
        found = [change for change in self.changes if change.kind in ("fingerprint", "law")]
        return "".join(f", {change.quantity} {change.before} -> {change.after}" for change in found)

    @property
    def rank(self) -> tuple[bool, float]:
        """The sort key of methods: failing ones first, then by factor."""
        return not self.failing, -max(_weight(self.of("worse")), _weight(self.of("improved")))


def _weight(changes: Iterable[Change]) -> float:
    """Return the largest size in decades; -1 without a change."""
    return max((_decades(change) for change in changes), default=-1.0)


def _decades(change: Change) -> float:
    """Return the size: infinite for an outcome or a failure without a size, 0 for others without one."""
    counts = change.kind == "outcome" or change.status in FAILING
    return change.size if counts else abs(change.decades or 0.0)


def by_method(changes: Iterable[Change]) -> list[MethodChanges]:
    """Return the changes grouped by method; failing methods first, then by factor."""
    found: dict[tuple[str, str], list[Change]] = {}
    for change in changes:
        found.setdefault((change.engine, change.method), []).append(change)
    return sorted((MethodChanges(*key, tuple(of_it)) for key, of_it in found.items()), key=lambda m: m.rank)


def headlines(comparison: Comparison) -> list[str]:
    """Return one sentence for each engine with changes; the engine with the worst failure first."""
    found: dict[str, list[MethodChanges]] = {}
    for one in by_method(comparison.changes):
        found.setdefault(one.engine, []).append(one)
    several = len({change.scenario for change in comparison.changes} - {None}) > 1
    return [
        f"{_versions(comparison, engine)}: "
        f"{'; '.join(_clauses(methods, comparison.thresholds, several=several))}."
        for engine, methods in found.items()
    ]


def _versions(comparison: Comparison, engine: str) -> str:
    """Return "mujoco 3.17.0 -> 4.0.0", or "mujoco 4.0.0" if the version is the same."""
    runs = comparison.before, comparison.after
    both = [run.manifest["engines"].get(engine, {}).get("version") for run in runs]
    versions = [str(version) for version in dict.fromkeys(both) if version]
    name = engine if (pin := pin_of(engine)) is None else pin.engine
    return f"{name} {' -> '.join(versions)}" if versions else engine


def _clauses(methods: Sequence[MethodChanges], thresholds: Thresholds, *, several: bool) -> list[str]:
    """Return one clause per method; methods that only moved share a clause, and so do new ones."""
    described = [one for one in methods if one.net in ("worse", "missing", "improved")]
    clauses = [_clause(one, several=several) for one in described[:_MAX_METHODS]]
    rest = [one.net for one in described[_MAX_METHODS:]]
    clauses += [f"{count(rest.count(net), 'more method')} {net}" for net in dict.fromkeys(rest)]
    renamed = [one for one in methods if one.net in ("moved", "new") and one.identity_change]
    clauses += [f"{one.method} moved{one.identity_change}" for one in renamed]
    if moved := [one for one in methods if one.net == "moved" and one not in renamed]:
        size = moved_text((change for one in moved for change in one.of("moved")), thresholds)
        clauses.append(f"{count(len(moved), 'method')} moved{size}")
    if new := [one for one in methods if one.net == "new" and one not in renamed]:
        clauses.append(f"{', '.join(one.method for one in new)} new")
    return clauses


def _clause(one: MethodChanges, *, several: bool) -> str:
    """Return the clause of one method; changes against its net direction follow after "but"."""
    parts: dict[Status, str] = {
        "worse": _direction("worse", one.of("worse"), several=several),
        "missing": _missing(one.of("missing")),
        "improved": _direction("improved", one.of("improved"), several=several),
    }
    first = parts.pop(one.net)
    failing = one.net in FAILING
    rest = [
        f", {'and' if failing and status in FAILING else 'but'} {part}"
        for status, part in parts.items()
        if part
    ]
    return f"{one.method} {first}{one.identity_change}{''.join(rest)}"


def _missing(changes: Sequence[Change]) -> str:
    """Return what is no longer measured."""
    cases = sum(change.kind == "case" for change in changes)
    measures = dict.fromkeys(change.quantity for change in changes if change.kind != "case")
    parts = [count(cases, "case")] if cases else []
    return f"missing ({', '.join([*parts, *measures])})" if changes else ""


def _direction(status: Status, changes: Sequence[Change], *, several: bool) -> str:
    """Return "improved, order 2 -> 4, error at 1 ms 4.3e-7 -> 2.3e-13 rad (factor 1.9e6)"."""
    if not changes:
        return ""
    errors = [change for change in changes if change.kind == "accuracy"]
    of_orientation = [change for change in errors if change.quantity == ORIENTATION]
    parts = []
    largest = max(of_orientation or errors, key=lambda change: change.size, default=None)
    orders = [change for change in changes if change.kind == "order"]
    if order := _of_scenario(orders, largest):
        quantity = order.quantity.removeprefix("order of ")
        of_it = "" if quantity == ORIENTATION else f" of {quantity}"
        parts.append(f"order{of_it} {_pair(order)}")
    if largest is not None:
        worst = max(errors, key=lambda change: change.size)
        named = [largest, worst] if worst.size > largest.size + _FARTHER_DECADES else [largest]
        parts += [error_text(change) + _where(change, several=several) for change in named]
    others = [change for change in changes if change.kind not in ("accuracy", "order")]
    largest_of_kind = {change.kind: change for change in reversed(others)}
    parts += [_other(change, several=several) for change in reversed(largest_of_kind.values())]
    return f"{status}, {', '.join(parts)}"


def _of_scenario(orders: Sequence[Change], error: Change | None) -> Change | None:
    """Return the change of order that matches an error by quantity and, if possible, by scenario."""
    if error is not None:
        quantity_name = f"order of {error.quantity}"
        of_it = [one for one in orders if one.quantity == quantity_name]
        return next((one for one in of_it if one.scenario == error.scenario), next(iter(of_it), None))
    return next(iter(orders), None)


def error_text(change: Change) -> str:
    """Return "error at 1 ms 4.3e-7 -> 2.3e-13 rad (factor 1.9e6)", or "(2.1 %)", for a change of accuracy."""
    name, unit = ("error", " rad") if change.quantity == ORIENTATION else (change.quantity, "")
    at = "" if change.fineness is None else f" at {_step(change)}"
    size = size_text(change, 2)
    return f"{name}{at} {_pair(change)}{unit}" + f" ({size})" * bool(size)


def size_text(change: Change, digits: int) -> str:
    """Return "factor 1.9e6", or "2.1 %" if a change is below 100 %; "" without a size.

    digits: of the factor.
    """
    if change.decades is None or change.relative is None:
        return ""
    if change.relative >= 1.0:
        return f"factor {number(10.0**change.size, digits)}"
    return f"{number(100.0 * change.relative, 2)} %"


def _other(change: Change, *, several: bool) -> str:
    """Return a change of an outcome, a verdict, a stable step or a speed as text."""
    if change.kind == "speed":
        assert change.decades is not None
        direction = "slower" if change.decades > 0.0 else "faster"
        return f"{number(10.0**change.size, 3)} times {direction}{_where(change, several=several)}"
    at = "" if change.fineness is None else f" at {_step(change)}"
    return f"{change.quantity}{at} {_pair(change)}{_where(change, several=several)}"


def _where(change: Change, *, several: bool) -> str:
    return f" in {change.scenario}" if several and change.scenario is not None else ""


def _step(change: Change) -> str:
    """Return "1 ms", or "tolerance 1e-6"."""
    assert change.fineness is not None
    if change.control == "dt":
        return f"{number(1e3 * change.fineness, 4)} ms"
    return setting(change.control, change.fineness)


def _pair(change: Change) -> str:
    """Return both values with as many digits as distinguish them, at least two."""
    for digits in range(2, 18):
        texts = [value_text(value, digits) for value in (change.before, change.after)]
        if texts[0] != texts[1]:
            break
    return f"{texts[0]} -> {texts[1]}"


def value_text(value: float | str | None, digits: int) -> str:
    """Return a value with so many digits; "not measured" for None."""
    if value is None:
        return "not measured"
    return value if isinstance(value, str) else number(value, digits)


def moved_text(changes: Iterable[Change], thresholds: Thresholds) -> str:
    """Return the largest size of the moved changes: " by up to 1.2 %", " in the 12th digit"; "" without one.

    A moved change larger than the threshold is within round-off, or random.
    """
    sizes = [(one.relative, thresholds.of(one.quantity)) for one in changes if one.relative is not None]
    below = [size for size, threshold in sizes if size <= threshold]
    if not sizes:
        return ""
    return _size_text(max(below)) if below else " within round-off"


def _size_text(relative: float) -> str:
    if relative >= _DIGITS_BELOW:
        return f" by up to {number(100.0 * relative, 2)} %"
    digit = math.floor(-math.log10(relative)) + 1
    ending = {1: "st", 2: "nd", 3: "rd"}.get(digit % 10 if digit not in (11, 12, 13) else 0, "th")
    return f" in the {digit}{ending} digit"
