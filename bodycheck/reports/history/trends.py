"""The page of a history: every measure of every case over the nightly runs, with levels and regressions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, TypeAlias

from markupsafe import Markup

from bodycheck._util.formatting import number, setting
from bodycheck.reports.comparison.change import FAILING
from bodycheck.reports.comparison.compare import unversioned
from bodycheck.reports.comparison.headlines import label
from bodycheck.reports.history.archive import started_at
from bodycheck.reports.history.headline import headline
from bodycheck.reports.history.levels import Levels, settings_of
from bodycheck.reports.history.nightly_files import versions_of
from bodycheck.reports.history.open_regressions import open_lines
from bodycheck.reports.history.queries import recorded, recorded_cases
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION
from bodycheck.reports.render.styles import MARKERS, engine_colour
from bodycheck.reports.templating import asset, rendered

if TYPE_CHECKING:
    import pandas as pd

FILE = "trends.html"
"""The file in the folder of a history."""

_TIME = "relative_cpu"
_ORDER = "order"
_STABLE = "dt_stable_s"
_TITLES = {
    _TIME: "time / time of the reference",
    _ORDER: "order of convergence",
    _STABLE: "largest stable step in s",
}
_QUANTITIES = (*MEASURES, *_TITLES)
_STUDY = ("engine", "method", "scenario")
_CASE = (*_STUDY, "control", "dt_s", "tolerance")


def trends_page(judged: Judgement) -> str:
    """Return the page with the series of all measures, on the class of machines of a nightly run.

    judged: of the newest nightly run, which is stored.
    """
    runs = [*(run.folder for run in judged.baseline.runs[::-1]), judged.history / judged.newest.run_id]
    manifests = [*(run.manifest for run in judged.baseline.runs[::-1]), judged.newest.manifest]
    regressions = [
        (_hash(one.regressions[0].change), one.text, one.duration) for one in open_lines(judged.open)
    ]
    series = list(_series(judged, runs, manifests))
    engines = dict.fromkeys(one["m"].rpartition(":")[0] for one in series)
    data = {
        "start": regressions[0][0] if regressions else "",
        "runs": [run.name for run in runs],
        "dates": [started_at(run.name).isoformat() for run in runs],
        "releases": _releases([versions_of(manifest) for manifest in manifests]),
        "colours": {engine: engine_colour(engine) for engine in engines},
        "markers": list(MARKERS),
        "labels": {name: _title(name) for name in _QUANTITIES},
        "series": series,
    }
    return rendered(
        FILE,
        title="bodycheck: history of all measures",
        first=headline(judged),
        open=regressions,
        data=data,
        js=Markup("\n").join(asset(f"templates/{name}.js") for name in ("plot_style", "trends")),
        plotly=asset("vendor/plotly-basic.min.js"),
    )


def _title(quantity: str) -> str:
    if quantity in _TITLES:
        return _TITLES[quantity]
    unit = " in rad" if quantity.endswith("_rad") else ""
    return f"{label(quantity)}{' error' if 'error' in quantity else ''}{unit}"


def _hash(change: Any) -> str:
    """Return the part of an address that shows a changed value."""
    word = change.quantity.rpartition(" ")[2].removesuffix("_abs")
    known = word if word in _QUANTITIES else ORIENTATION
    quantity = {"order": _ORDER, "stability": _STABLE}.get(change.kind, known)
    return "|".join((f"{change.engine}:{change.method}", change.scenario or "", quantity))


def _releases(versions: Sequence[Mapping[str, str]]) -> dict[str, list[tuple[int, str]]]:
    """Return where the version of each engine changed: (place of the run, version)."""
    found: dict[str, list[tuple[int, str]]] = {}
    known: dict[str, str] = {}
    for place, own in enumerate(versions):
        for engine, version in own.items():
            if known.get(engine, version) != version:
                found.setdefault(engine, []).append((place, version))
            known[engine] = version
    return found


_Key: TypeAlias = tuple[Any, ...]
"""Engine, method, scenario, step or tolerance, and quantity."""
_Steps: TypeAlias = list[tuple[int, float]]
"""The runs from which on a level holds, and the level."""


def _series(
    judged: Judgement, runs: Sequence[Path], manifests: Sequence[Mapping[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Yield measures of cases, orders and stable steps: their values and levels, and when they were worse."""
    names = {run.name: unversioned(m["engines"]) for run, m in zip(runs, manifests, strict=True)}
    place = {run.name: index for index, run in enumerate(runs)}
    worse = _worse(_renamed(recorded(runs, "changes"), names), place)
    stored = _stored_levels(judged, names)
    levels = _level_steps(stored, place)
    restarts = _speed_levels(stored, place) if judged.speeds.judged else None

    def one(key: _Key, title: str, at: Sequence[int], values: Sequence[float]) -> dict[str, Any]:
        engine, method, scenario, _, quantity = key
        speed = engine, method, None, None, _TIME
        bad = worse.get(speed if quantity == _TIME else key, set())
        steps = levels.get(key, [])
        if quantity == _TIME and restarts is not None:
            steps = _medians(restarts.get(speed, [0]), at, values, bad)
        return {
            "m": f"{engine}:{method}",
            "s": scenario,
            "q": _ORDER if quantity.startswith(_ORDER) else quantity,
            "f": title,
            "v": _runs_of_equal(at, values),
            **({"l": [(run, _short(level)) for run, level in steps]} if steps else {}),
            **({"w": sorted(bad)} if bad else {}),
        }

    cases = _renamed(recorded_cases(runs, MEASURES), names)
    case: Any
    for case, rows in cases.groupby(list(_CASE), dropna=False, sort=False):
        engine, method, scenario, control, dt_s, tolerance = case
        fineness = next((value for value in (dt_s, tolerance) if value == value), None)
        at = rows["run"].map(place).tolist()
        for quantity in (*MEASURES, _TIME):
            values = rows[quantity].tolist()
            if any(value == value for value in values):
                key = engine, method, scenario, fineness, quantity
                yield one(key, setting(control, fineness), at, values)
    for table, column in (("methods", _ORDER), ("stability", _STABLE)):
        measured = _renamed(recorded(runs, table), names).dropna(subset=column)
        of_study: dict[tuple[_Key, str], list[tuple[int, float]]] = {}
        for row in measured.to_dict("records"):
            of = row.get("quantity")
            quantity, title = (f"{_ORDER} of {of}", label(of)) if of else (column, "step")
            key = row["engine"], row["method"], row["scenario"], None, quantity
            of_study.setdefault((key, title), []).append((place[row["run"]], row[column]))
        for (key, title), points in of_study.items():
            yield one(key, title, [run for run, _ in points], [value for _, value in points])


def _stored_levels(judged: Judgement, names: Mapping[str, Mapping[str, str]]) -> list[tuple[str, Levels]]:
    """Return the oldest and the newest levels, and those of each run that set any: the run and its levels."""
    found: list[tuple[str, Levels]] = []
    known: bytes | None = None
    for run in judged.baseline.runs[::-1]:
        settings = settings_of(run.folder)
        if settings != known or not found:
            found.append((run.name, run.levels))
        known = settings
    found.append((judged.newest.run_id, judged.levels))
    return [(run, levels.renamed(names[run])) for run, levels in found]


def _level_steps(stored: Sequence[tuple[str, Levels]], place: Mapping[str, int]) -> dict[_Key, _Steps]:
    """Return the levels of errors, orders and stable steps, each from the run on that set it."""
    found: dict[_Key, _Steps] = {}
    for run, levels in stored:
        for key, first_run, value in _values(levels):
            steps = found.setdefault(key, [])
            if not steps or steps[-1][1] != value:
                first = place.get(first_run, 0)  # of a first value; later ones are set by `run`
                steps.append((place[run] if steps and first <= steps[-1][0] else first, value))
    return found


def _values(levels: Levels) -> Iterator[tuple[_Key, str, float]]:
    """Yield each level that is a number: its key, the run that first measured the row, and the value."""
    for (scenario, engine, method, _, fineness), row in levels.rows("results").items():
        for quantity in MEASURES:
            if quantity in row:
                yield (engine, method, scenario, fineness, quantity), row["run_id"], row[quantity]
    for (scenario, engine, method, quantity), row in levels.rows("methods").items():
        if _ORDER in row:
            key = engine, method, scenario, None, f"{_ORDER} of {quantity}"
            yield key, row["run_id"], row[_ORDER]
    for (scenario, engine, method), row in levels.rows("stability").items():
        if _STABLE in row:
            yield (engine, method, scenario, None, _STABLE), row["run_id"], row[_STABLE]


def _speed_levels(stored: Sequence[tuple[str, Levels]], place: Mapping[str, int]) -> dict[_Key, list[int]]:
    """Return the runs from which on the times of each method are its level; without its first one, 0."""
    found: dict[_Key, list[int]] = {}
    for _, levels in stored:
        for key, one in levels.settings.items():
            if key.kind == "speed" and one.run_id in place:
                found.setdefault((key.engine, key.method, None, None, _TIME), [0]).append(place[one.run_id])
    return {key: sorted(set(starts)) for key, starts in found.items()}


def _medians(starts: Sequence[int], at: Sequence[int], values: Sequence[float], bad: Iterable[int]) -> _Steps:
    """Return the median time of a case on each level of its method, without the runs that were worse."""
    steps, left_out = [], set(bad)
    for start, end in pairwise([*starts, math.inf]):
        own = [
            value
            for run, value in zip(at, values, strict=True)
            if start <= run < end and value == value and (run not in left_out or run == start)
        ]
        if own:
            steps.append((int(start), median(own)))
    return steps


def _renamed(table: pd.DataFrame, names: Mapping[str, Mapping[str, str]]) -> pd.DataFrame:
    """Return a table of runs with each engine that a run has in one version named without it."""
    pairs = zip(table["run"], table["engine"], strict=True)
    return table.assign(engine=[names[run].get(engine, engine) for run, engine in pairs])


def _worse(changes: pd.DataFrame, place: Mapping[str, int]) -> dict[_Key, set[int]]:
    """Return the runs in which each error, order, stable step and speed was worse than its level."""
    found: dict[_Key, set[int]] = {}
    for row in changes.to_dict("records"):
        if row["status"] not in FAILING:
            continue
        quantity = {
            "accuracy": row["quantity"].removesuffix("_abs"),
            "verdict": row["quantity"].replace("verdict", _ORDER),
            "order": row["quantity"],
            "stability": _STABLE,
            "speed": _TIME,
        }.get(row["kind"])
        if quantity is not None:
            where = (row[name] if row[name] == row[name] else None for name in ("scenario", "fineness"))
            key = row["engine"], row["method"], *where, quantity
            found.setdefault(key, set()).add(place[row["run"]])
    return found


def _runs_of_equal(at: Iterable[int], values: Iterable[float]) -> list[list[Any]]:
    """Return [place of the first run, number of runs, value] for runs that follow one another."""
    found: list[list[Any]] = []
    for place, value in sorted(zip(at, values, strict=True)):
        if value != value:
            continue
        short = _short(value)
        if found and found[-1][2] == short and found[-1][0] + found[-1][1] == place:
            found[-1][1] += 1
        else:
            found.append([place, 1, short])
    return found


def _short(value: float) -> float:
    return float(number(value, 5))
