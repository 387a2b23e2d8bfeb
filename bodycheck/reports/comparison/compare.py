"""What changed between two runs, as a pure function of their tables: symmetric in the two."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from bodycheck.reports.comparison.accuracy import Floors, accuracy_changes
from bodycheck.reports.comparison.change import Change, by_rank
from bodycheck.reports.comparison.circumstances import circumstances, redefined, same_machine
from bodycheck.reports.comparison.speeds import Ratio, ratio, speed_changes
from bodycheck.reports.comparison.stable_steps import stability_change
from bodycheck.reports.stored import Tables

if TYPE_CHECKING:
    import pandas as pd

_RANKS = {"converges": 2, "at-floor": 2, "does-not-converge": 0, "unstable": 0}
"""How good a verdict is; those that leave it open are in between."""
_OPEN = 1
_LEAST_ORDER_CHANGE = 0.05

_Row: TypeAlias = Mapping[str, Any]
_Key: TypeAlias = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """What changed from one run to another.

    circumstances: what of machine, versions and settings differs. redefined: scenarios whose name means
    something else in either run; their cases are not compared. paired: how many cases both runs have and
    were compared; timed: how many of them by their speed too. changes: the largest first.
    """

    before: Tables
    after: Tables
    circumstances: tuple[str, ...]
    redefined: tuple[str, ...]
    paired: int
    timed: int
    changes: tuple[Change, ...]


def compare(before: Tables, after: Tables) -> Comparison:
    """Return what changed: cases, outcomes, verdicts, orders, stable steps, accuracy, speed.

    Accuracy is deterministic, so that a change counts where it exceeds what round-off can do; speed is
    judged by the quartiles of the laps and the noise of both machines.
    """
    apart = redefined(before.manifest, after.manifest)
    old, new = (_cases(tables, apart) for tables in (before, after))
    both = [(old[key], new[key]) for key in new if key in old]
    ratios = _ratios(both, same=same_machine(before.manifest, after.manifest))
    noises = (before.manifest.get("speed_noise") or 0.0, after.manifest.get("speed_noise") or 0.0)
    changes = [
        *_came_and_went(old, new),
        *_outcomes(both),
        *_verdicts(before, after, apart),
        *_stable_steps(before, after, apart),
        *_accuracies(both, _floors(before), _floors(after)),
        *speed_changes(ratios, noises),
    ]
    return Comparison(
        before=before,
        after=after,
        circumstances=circumstances(before.manifest, after.manifest),
        redefined=apart,
        paired=len(both),
        timed=len(ratios),
        changes=tuple(sorted(changes, key=lambda change: -change.size)),
    )


def ended_well_anew(before: Tables, after: Tables) -> Tables:
    """Return the tables after with those cases alone that end well there and not, or not at all, before."""
    well = {_case_key(case.columns) for case in before.cases if case.ok}
    anew = (case for case in after.cases if case.ok and _case_key(case.columns) not in well)
    return replace(after, cases=tuple(anew))


def _cases(tables: Tables, apart: tuple[str, ...]) -> dict[_Key, _Row]:
    rows = (case.columns for case in tables.cases if case.columns["scenario"] not in apart)
    return {_case_key(row): row for row in rows}


def _case_key(row: _Row) -> _Key:
    return (
        *(row[name] for name in ("scenario", "engine", "method", "control")),
        row.get("dt_s"),
        row.get("tolerance"),
    )


def _came_and_went(old: Mapping[_Key, _Row], new: Mapping[_Key, _Row]) -> Iterator[Change]:
    for key in dict.fromkeys((*old, *new)):
        if (key in old) != (key in new):
            outcomes = [rows[key]["outcome"] if key in rows else None for rows in (old, new)]
            yield _of_case("case", key, "case", *outcomes)


def _of_case(kind: Any, key: _Key, what: str, before: Any, after: Any, direction: Any = "other") -> Change:
    scenario, engine, method, control, dt_s, tolerance = key
    fineness = tolerance if dt_s is None else dt_s
    return Change(kind, scenario, engine, method, what, before, after, direction, control, fineness)


def _outcomes(both: Iterable[tuple[_Row, _Row]]) -> Iterator[Change]:
    for old, new in both:
        before, after = old["outcome"], new["outcome"]
        if before != after:
            direction = by_rank(before == "ok", after == "ok")
            yield _of_case("outcome", _case_key(new), "outcome", before, after, direction)


def _accuracies(
    both: Iterable[tuple[_Row, _Row]], old_floors: Mapping[_Key, Floors], new_floors: Mapping[_Key, Floors]
) -> Iterator[Change]:
    for old, new in both:
        if old["outcome"] == new["outcome"] == "ok":
            method = _case_key(new)[:3]
            yield from accuracy_changes(old, new, (old_floors.get(method, {}), new_floors.get(method, {})))


def _ratios(both: Iterable[tuple[_Row, _Row]], *, same: bool) -> list[Ratio]:
    ratios = (ratio(old, new, same_machine=same) for old, new in both)
    return [found for found in ratios if found is not None]


def _judged(tables: Tables) -> dict[_Key, dict[str, Any]]:
    """Return the rows of methods.csv by scenario, engine, method and quantity, without what is empty."""
    return _rows(tables.methods, ("scenario", "engine", "method", "quantity"))


def _rows(table: pd.DataFrame, names: tuple[str, ...]) -> dict[_Key, dict[str, Any]]:
    rows: list[dict[Any, Any]] = table.astype(object).where(table.notna(), None).to_dict("records")
    return {
        tuple(row[name] for name in names): {name: cell for name, cell in row.items() if cell is not None}
        for row in rows
    }


def _floors(tables: Tables) -> dict[_Key, dict[str, float]]:
    floors: dict[_Key, dict[str, float]] = {}
    for (*method, quantity), row in _judged(tables).items():
        if "floor" in row:
            floors.setdefault(tuple(method), {})[quantity] = row["floor"]
    return floors


def _stable_steps(before: Tables, after: Tables, apart: tuple[str, ...]) -> Iterator[Change]:
    old, new = (_rows(tables.stability, ("scenario", "engine", "method")) for tables in (before, after))
    for key in new:
        if key in old and key[0] not in apart:
            change = stability_change(old[key], new[key])
            if change is not None:
                yield change


def _verdicts(before: Tables, after: Tables, apart: tuple[str, ...]) -> Iterator[Change]:
    old, new = _judged(before), _judged(after)
    for key in new:
        scenario, engine, method, quantity = key
        if key not in old or scenario in apart:
            continue
        a, b = old[key], new[key]
        about = (scenario, engine, method)
        if a["verdict"] != b["verdict"]:
            direction = by_rank(_RANKS.get(a["verdict"], _OPEN), _RANKS.get(b["verdict"], _OPEN))
            what = f"verdict of {quantity}"
            yield Change("verdict", *about, what, a["verdict"], b["verdict"], direction)
        if "order" in a and "order" in b:
            up, down = b["order_low"] > a["order_high"], b["order_high"] < a["order_low"]
            if (up or down) and abs(b["order"] - a["order"]) > _LEAST_ORDER_CHANGE:
                direction = "better" if up else "worse"
                yield Change("order", *about, f"order of {quantity}", a["order"], b["order"], direction)
