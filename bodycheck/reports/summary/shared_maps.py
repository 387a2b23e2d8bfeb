"""The one-step maps that methods of several engines make of a tree: why they agree, and how wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bodycheck._util.formatting import count, names, number
from bodycheck.reports.measurement.tree_map_made import DISTANCE, MAP, NEXT
from bodycheck.reports.run_files.run_tables import Tables, cases_by_method, common_step, key_of

_FEWEST = 2  # methods, and engines, of which it says anything that they agree


def shared_maps(run: Tables) -> Iterator[str]:
    """Yield a sentence per scenario and map that methods of several engines make at the common step."""
    for scenario, methods in cases_by_method(run.cases).items():
        cases = [case for own in methods.values() for case in own]
        at_s = common_step(cases)
        groups: dict[str, list[Mapping[str, Any]]] = {}
        for case in cases:
            if case.ok and case.dt_s == at_s and MAP in case.columns:
                groups.setdefault(case.columns[MAP].partition(",")[0], []).append(case.columns)
        for name, rows in groups.items():
            if len({row["engine"] for row in rows}) >= _FEWEST <= len(rows):
                yield _sentence(scenario, name, rows, run.manifest["scenarios"][scenario])


def _sentence(scenario: str, name: str, rows: Sequence[Mapping[str, Any]], facts: Mapping[str, Any]) -> str:
    engines = dict.fromkeys(row["engine"] for row in rows)
    angle = "joint_error_rad" if all("joint_error_rad" in row for row in rows) else "orientation_error_rad"
    errors = [row[angle] for row in rows]
    apart = max(row[DISTANCE] for row in rows)
    farther = min(row[NEXT] / max(row[DISTANCE], 1e-16) for row in rows)
    where = f" in the joint of {rows[0]['worst_body']}" if angle == "joint_error_rad" else ""
    spread = "" if max(errors) <= 1.001 * min(errors) else f"{number(min(errors), 3)} to "
    text = (
        f"{scenario}: {count(len(rows), 'method')} of {count(len(engines), 'engine')} make the same map "
        f"{name} at {number(rows[0]['dt_s'], 3)} s, to {number(apart, 1)} per step (the next map is "
        f"{number(farther, 1)} times farther): they agree with each other and are "
        f"{spread}{number(max(errors), 3)} rad from the truth{where}"
    )
    is_free = "joint" not in facts["body"][0] and not facts.get("forcing")
    false = max(row.get("linear_momentum_drift_abs", 0.0) for row in rows)
    momentum = f", with a false momentum of {number(false, 2)} N s" if is_free and false else ""
    return f"{text}{momentum}: {names([':'.join(key_of(row)) for row in rows])}."
