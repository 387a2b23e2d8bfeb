"""The page of a history: every measure of every case over the nightly runs, with levels and regressions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bodycheck._util.formatting import number, setting
from bodycheck.reports.comparison.change import FAILING
from bodycheck.reports.comparison.compare import unversioned
from bodycheck.reports.comparison.headlines import label
from bodycheck.reports.history.archive import started_at
from bodycheck.reports.history.headline import headline
from bodycheck.reports.history.nightly_files import versions_of
from bodycheck.reports.history.open_regressions import open_lines
from bodycheck.reports.history.queries import recorded_cases, recorded_changes
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION
from bodycheck.reports.templating import asset, environment

if TYPE_CHECKING:
    import pandas as pd

FILE = "trends.html"
"""The file in the folder of a history."""

_TIME = "relative_cpu"
_QUANTITIES = (*MEASURES, _TIME)
_CASE = ("engine", "method", "scenario", "control", "dt_s", "tolerance")


def trends_page(judged: Judgement) -> str:
    """Return the page with the series of all measures, on the class of machines of a nightly run.

    judged: of the newest nightly run, which is stored.
    """
    runs = [*(run.folder for run in judged.baseline.runs[::-1]), judged.history / judged.newest.run_id]
    manifests = [*(run.manifest for run in judged.baseline.runs[::-1]), judged.newest.manifest]
    data = {
        "runs": [run.name for run in runs],
        "dates": [started_at(run.name).isoformat() for run in runs],
        "releases": _releases([versions_of(manifest) for manifest in manifests]),
        "labels": {name: _title(name) for name in _QUANTITIES},
        "series": list(_series(judged, runs, manifests)),
    }
    return (
        environment()
        .get_template(FILE)
        .render(
            title="bodycheck: history of all measures",
            first=headline(judged),
            open=[
                (_hash(one.regressions[0].change), one.text, one.duration) for one in open_lines(judged.open)
            ],
            data=data,
            css=asset("templates/report.css"),
            js=asset("templates/trends.js"),
            plotly=asset("vendor/plotly-basic.min.js"),
        )
    )


def _title(quantity: str) -> str:
    if quantity == _TIME:
        return "time / time of the reference"
    unit = " in rad" if quantity.endswith("_rad") else ""
    return f"{label(quantity)}{' error' if 'error' in quantity else ''}{unit}"


def _hash(change: Any) -> str:
    """Return the part of an address that shows a changed value."""
    word = change.quantity.rpartition(" ")[2].removesuffix("_abs")
    quantity = word if word in _QUANTITIES else ORIENTATION
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


def _series(
    judged: Judgement, runs: Sequence[Path], manifests: Sequence[Mapping[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Yield each measure of each case: its values, its level and from which run on, and when it was worse."""
    names = {run.name: unversioned(m["engines"]) for run, m in zip(runs, manifests, strict=True)}
    place = {run.name: index for index, run in enumerate(runs)}
    cases = _renamed(recorded_cases(runs, MEASURES), names)
    worse = _worse(_renamed(recorded_changes(runs), names), place)
    levels = judged.levels.renamed(names[runs[-1].name])
    settings = {
        (key.engine, key.method, key.scenario, key.fineness, key.quantity): place.get(one.run_id, 0)
        for key, one in levels.settings.items()
    }
    level_of = {(*key[1:3], key[0], key[4]): row for key, row in levels.results.items()}
    case: Any
    for case, rows in cases.groupby(list(_CASE), dropna=False, sort=False):
        engine, method, scenario, control, dt_s, tolerance = case
        fineness = next((value for value in (dt_s, tolerance) if value == value), None)
        at = rows["run"].map(place)
        level_row = level_of.get((engine, method, scenario, fineness), {})
        for quantity in _QUANTITIES:
            values = rows[quantity].to_numpy()
            if not (values == values).any():
                continue
            key = engine, method, scenario, fineness, quantity
            level = level_row.get(quantity) if quantity != _TIME else None
            yield {
                "m": f"{engine}:{method}",
                "s": scenario,
                "q": quantity,
                "f": setting(control, fineness),
                "v": _runs_of_equal(at.tolist(), values.tolist()),
                **({} if level is None else {"l": [settings.get(key, 0), _short(level)]}),
                **({"w": sorted(worse[key])} if key in worse else {}),
            }


def _renamed(table: pd.DataFrame, names: Mapping[str, Mapping[str, str]]) -> pd.DataFrame:
    """Return a table of runs with each engine that a run has in one version named without it."""
    pairs = zip(table["run"], table["engine"], strict=True)
    return table.assign(engine=[names[run].get(engine, engine) for run, engine in pairs])


def _worse(changes: pd.DataFrame, place: Mapping[str, int]) -> dict[tuple[Any, ...], set[int]]:
    """Return the runs in which each error was worse than its level."""
    found: dict[tuple[Any, ...], set[int]] = {}
    for row in changes.to_dict("records"):
        if row["status"] in FAILING and row["kind"] == "accuracy":
            quantity = row["quantity"].removesuffix("_abs")
            fineness = row["fineness"] if row["fineness"] == row["fineness"] else None
            key = row["engine"], row["method"], row["scenario"], fineness, quantity
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
