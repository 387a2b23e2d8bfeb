"""The one-step maps that methods of several engines make of a tree: why they agree, and how wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bodycheck._util.formatting import count, names, number
from bodycheck.reports.measurement.tree_map_made import DISTANCE, MAP, NEXT
from bodycheck.reports.run_files.method_words import map_in_words
from bodycheck.reports.run_files.run_tables import Tables, cases_by_method, coarsest_shared_step, key_of

_ERRORS = {
    "joint_error_rad": "joint angles are",
    "joint_error_m": "joint positions are",
    "orientation_error_rad": "attitudes are",
}
_LOST = 1.0  # rad or m: an error beyond which nothing of the truth is left
_OF_ONE_BODY = ("M1", "M2")  # maps of which trees have their own
_FEWEST = 2  # methods, and engines, of which it says anything that they agree


def shared_maps(run: Tables) -> tuple[list[str], list[str]]:
    """Return what is said of maps that methods of several engines make of trees, and its details.

    The most telling comes first: the scenario with the largest error in which the map still follows the
    truth, to a radian, and first one in which a momentum is false that nothing outside the tree can change;
    the others are counted.
    """
    found = sorted(_shared(run), key=lambda one: (one.error > _LOST, not one.is_free, -one.error))
    if not found:
        return list(_of_trees_alone(run)), []
    others = [name for name in dict.fromkeys(one.scenario for one in found) if name != found[0].scenario]
    rest = [f"The same holds for the maps of engines in {names(others)}."] if others else []
    return [found[0].sentence, *rest, *_of_trees_alone(run)], [found[0].details]


def _of_trees_alone(run: Tables) -> Iterator[str]:
    """Yield which methods make another map of trees than of one body, where both are known."""
    from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS

    known = {key_of(row): row["fingerprint"] for row in run.rows("fingerprints")}
    other: dict[str, list[str]] = {}
    for case in run.cases:
        made = str(case.columns.get(MAP, "")).partition(",")[0]
        lone = known.get(key_of(case.columns))
        if made and lone in _OF_ONE_BODY and lone != TREE_MAPS[made].one_body:
            methods = other.setdefault(f"{lone} of one body and {made} of trees", [])
            methods.extend(name for name in [":".join(key_of(case.columns))] if name not in methods)
    if other:
        texts = (f"{names(methods)} ({maps})" for maps, methods in other.items())
        yield f"Another map of trees than of one body: {'; '.join(texts)}."


@dataclass(frozen=True)
class _Shared:
    """A sentence about one scenario, its details, the largest error, in rad or m, and if its tree is free."""

    scenario: str
    error: float
    is_free: bool
    sentence: str
    details: str


def _shared(run: Tables) -> Iterator[_Shared]:
    for scenario, methods in cases_by_method(run.cases).items():
        cases = [case for own in methods.values() for case in own]
        at_s = coarsest_shared_step(cases)
        groups: dict[str, list[Mapping[str, Any]]] = {}
        for case in cases:
            if case.ok and case.dt_s == at_s and MAP in case.columns:
                groups.setdefault(case.columns[MAP].partition(",")[0], []).append(case.columns)
        for name, rows in groups.items():
            if len({row["engine"] for row in rows}) >= _FEWEST <= len(rows):
                yield _stated(scenario, name, rows, run.manifest["scenarios"][scenario])


def _stated(scenario: str, name: str, rows: Sequence[Mapping[str, Any]], facts: Mapping[str, Any]) -> _Shared:
    engines = dict.fromkeys(row["engine"] for row in rows)
    measured = next(one for one in _ERRORS if all(one in row for row in rows))
    errors, unit = [row[measured] for row in rows], measured.rpartition("_")[2]
    apart = max(row[DISTANCE] for row in rows)
    farther = min(row[NEXT] / max(row[DISTANCE], 1e-16) for row in rows)
    where = f" in the joint of {rows[0]['worst_body']}" if "worst_body" in rows[0] else ""
    spread = "" if max(errors) <= 1.001 * min(errors) else f"{number(min(errors), 3)} to "
    text = (
        f"{scenario}: {count(len(rows), 'method')} of {count(len(engines), 'engine')} are "
        f"{map_in_words(name)}: {_ERRORS[measured]} {spread}{number(max(errors), 3)} {unit} from the truth"
    )
    details = (
        f"They agree to a relative {number(apart, 1)} per step of {number(rows[0]['dt_s'], 3)} s, and the "
        f"next map is {number(farther, 1)} times farther: {names([':'.join(key_of(row)) for row in rows])}"
        f"{f'; the error is{where}' if where else ''}."
    )
    is_free = "joint" not in facts["body"][0] and not facts.get("forcing")
    false = max(row.get("linear_momentum_drift_abs", 0.0) for row in rows)
    momentum = f", false momentum {number(false, 2)} N s" if is_free and false else ""
    return _Shared(scenario, max(errors), bool(momentum), f"{text}{momentum}.", details)
