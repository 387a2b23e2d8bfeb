"""The files of an ensemble: tables, sentinels, the worst bodies, a figure and a manifest."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.pinned_libraries import duckdb, duckdb_connection, matplotlib, read_parquet
from bodycheck.ensembles.ensemble_cases import ROTATION_MEASURES
from bodycheck.ensembles.ensemble_result import (
    FLOORS,
    EnsembleResult,
    Key,
    MethodStatistics,
    WorstBody,
    key_text,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.case import reproducing_command
from bodycheck.reports.render.figures import figure_bytes, rendering
from bodycheck.reports.render.styles import COLOURS, styles
from bodycheck.reports.run_files.sentinels import write_sentinels
from bodycheck.reports.run_files.tables import as_csv
from bodycheck.reports.summary.quantiles import SHARES, QuantileSketch
from bodycheck.runs.manifest import machine, software
from bodycheck.scenarios.ensemble import scenario_text

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

SCHEMA_VERSION = 1
"""The column `schema_version` of every table; it changes with the meaning or the name of a column."""

PART = "part-{}.parquet"
"""The name of a file of a table, by its number; files of equal number have the same rows in each table."""

_ROWS = 1 << 17  # per file


def cases_folder(key: Key) -> tuple[str, ...]:
    """Return the folder of the cases of a method at a step or tolerance: KEY=VALUE, percent-encoded."""
    engine, method, setting = key
    values = {
        "engine": engine.name,
        "method": method.name,
        "setting": "none" if setting.fineness is None else repr(setting.fineness),
    }
    return "cases", *(f"{name}={quote(value, safe='@.+-')}" for name, value in values.items())


class Dataset:
    """Collects columns of rows, and writes a file when there are enough.

    part: the folder of some rows of a table: its name, then KEY=VALUE for each partition.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._waiting: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
        self._files: dict[tuple[str, ...], int] = {}
        self._connection: DuckDBPyConnection | None = None

    def __enter__(self) -> Dataset:
        self._connection = duckdb_connection()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._connection is not None
        try:
            if kind is None:
                for part in list(self._waiting):
                    self._write(part)
        finally:
            self._connection.close()

    def add(self, part: tuple[str, ...], columns: Mapping[str, Any]) -> None:
        """Add rows given by their columns, (n,) each."""
        waiting = self._waiting.setdefault(part, [])
        waiting.append(columns)
        if sum(len(next(iter(one.values()))) for one in waiting) >= _ROWS:
            self._write(part)

    def _write(self, part: tuple[str, ...]) -> None:
        import pandas as pd

        waiting = self._waiting.pop(part, [])
        if not waiting:
            return
        table = pd.DataFrame({name: _joined([one[name] for one in waiting]) for name in waiting[0]})
        if "schema_version" not in table:
            table.insert(0, "schema_version", SCHEMA_VERSION)
        folder = self._folder.joinpath(*part)
        folder.mkdir(parents=True, exist_ok=True)
        number = self._files.get(part, 0)
        self._files[part] = number + 1
        assert self._connection is not None
        self._connection.from_df(table).write_parquet(str(folder / PART.format(number)))


def _joined(pieces: list[Any]) -> Any:
    """Return a column of all pieces; texts as categories, of which an ensemble has few."""
    import pandas as pd

    joined = np.concatenate([np.asarray(piece) for piece in pieces])
    return joined if joined.dtype.kind in "fiub" else pd.Categorical(joined.astype(str))


def add_stored_rows(result: EnsembleResult, folder: Path, rows: range) -> None:
    """Add these rows of the tables `bodies` and `cases` of a folder to the statistics of an ensemble.

    Raises InputError where a file cannot be read, or the tables do not have exactly these rows in order.
    """
    bodies = folder / "bodies" / f"seed={result.request.seed}"
    with duckdb_connection() as database:
        for number in range(len(list(bodies.glob(PART.format("*"))))):
            file = PART.format(number)
            truths = _columns(database, bodies / file, ("row", *FLOORS.values()))
            expected, rows = rows[: len(truths["row"])], rows[len(truths["row"]) :]
            for floor, sketch in result.floors.items():
                sketch.add(truths[FLOORS[floor]])
            floor_rad = np.sum([truths[column] for column in FLOORS.values()], axis=0)
            for key, statistics in result.statistics:
                path = folder.joinpath(*cases_folder(key), file)
                cases = _columns(database, path, ("row", *ROTATION_MEASURES, "outcome"))
                if not cases["row"].tolist() == truths["row"].tolist() == list(expected):
                    raise InputError(f"{path}: must have the rows {expected.start} to {expected.stop - 1}")
                statistics.add(cases, floor_rad, result.request.worst)
    if rows:
        raise InputError(f"{bodies}: lacks the rows {rows.start} to {rows.stop - 1}")


def _columns(database: DuckDBPyConnection, path: Path, names: Sequence[str]) -> dict[str, Any]:
    try:
        table = read_parquet(database, path).select(*names).df()
    except (duckdb().Error, OSError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    return {name: table[name].to_numpy() for name in names}


_COMMON = {"schema_version": SCHEMA_VERSION}
DISTRIBUTIONS = "distributions.svg"
"""The figure of an ensemble, drawn where matplotlib is installed."""

TRUTH = "truth"
"""The name in the column `engine` of the truth's own error."""

_ENDINGS = ("ok", "unstable", "failed", "timeout", "invalid", "unsupported", "chaotic")


def write_summaries(result: EnsembleResult, folder: Path, out: Path) -> None:
    """Write the summaries, sentinels, worst bodies, figure and manifest of an ensemble to a folder.

    out: the folder's later name, for commands.
    """
    import pandas as pd

    tables = {
        "quantiles": quantile_rows(result),
        "methods": method_rows(result),
        "worst": list(_worst_rows(result, folder, out)),
    }
    for name, rows in tables.items():
        (folder / f"{name}.csv").write_bytes(as_csv(pd.DataFrame(rows)))
    write_sentinels(result.sentinels, folder)
    manifest = {
        "schema_version": SCHEMA_VERSION,
        **software(),
        **machine(),
        "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "request": asdict(result.request),
        "distribution": asdict(result.ensemble.distribution),
        "methods": [
            {
                "engine": engine.name,
                "version": engine.version,
                "method": asdict(method),
                **asdict(setting),
                "replay": statistics.replay,
            }
            for (engine, method, setting), statistics in result.statistics
        ],
        **({"merged": {"shards": result.shards, "findings": result.findings}} if result.shards else {}),
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    _draw(result, folder / DISTRIBUTIONS)


def quantile_rows(result: EnsembleResult) -> list[dict[str, Any]]:
    """Return the rows of quantiles.csv; the engine `truth` stands for the truth's own bound and round-off."""
    return [
        {**identity, "measure": name, **asdict(sketch.quantile(share)), "bodies": sketch.total}
        for identity, name, sketch in _sketches(result)
        if sketch.total
        for share in SHARES
    ]


def method_rows(result: EnsembleResult) -> list[dict[str, Any]]:
    """Return the rows of methods.csv: how many bodies ended how, and at the floor of double precision."""
    return [
        {
            **_identity(key),
            "bodies": sum(statistics.endings.values()),
            **{ending: statistics.endings[ending] for ending in _ENDINGS},
            "at_floor": statistics.at_floor,
            "replay": statistics.replay,
        }
        for key, statistics in result.statistics
    ]


def _worst_rows(result: EnsembleResult, folder: Path, out: Path) -> Iterator[dict[str, Any]]:
    """Write the worst bodies of each method as scenario files, each row once, and yield their rows."""
    for key, statistics in result.statistics:
        for rank, (body, command) in enumerate(replays(result, key, statistics, out), 1):
            path = folder / _worst_file(body)
            path.parent.mkdir(exist_ok=True)
            path.write_text(scenario_text(result.ensemble.row_scenario(body.row)), encoding="utf-8")
            cells = {"rank": rank, "row": body.row, "outcome": body.outcome}
            yield {**_identity(key), **cells, **body.measures, "reproduce": command}


def replays(
    result: EnsembleResult, key: Key, statistics: MethodStatistics, out: Path
) -> Iterator[tuple[WorstBody, str]]:
    """Yield the worst bodies of a method, each with the command that repeats it from its file in `out`."""
    for body in statistics.worst:
        file = str(out / _worst_file(body))
        yield body, reproducing_command(file, *key, code=result.request.allow_code)


def _worst_file(body: WorstBody) -> Path:
    return Path("worst") / f"row-{body.row}.toml"


def _sketches(result: EnsembleResult) -> Iterator[tuple[dict[str, Any], str, QuantileSketch]]:
    """Yield each sketch with its identifying columns; the engine `truth` stands for the truth's own error."""
    for key, statistics in result.statistics:
        for name, sketch in statistics.sketches.items():
            yield _identity(key), name, sketch
    for name, sketch in result.floors.items():
        yield {**_COMMON, "engine": TRUTH, "engine_version": version("bodycheck")}, name, sketch


def _draw(result: EnsembleResult, path: Path) -> None:
    """Draw the distributions where matplotlib is installed; docs/ensembles.md says so."""
    try:
        matplotlib()  # an extra
    except ImportError:
        return
    path.write_bytes(distributions_svg(result.statistics))


def _identity(key: Key) -> dict[str, Any]:
    engine, method, setting = key
    return {
        **_COMMON,
        "engine": engine.name,
        "engine_version": engine.version,
        "method": method.name,
        "dt_s": setting.dt_s,
        "tolerance": setting.tolerance,
    }


_LABELS = {
    "orientation_error_rad": "orientation error (rad)",
    "omega_error": "relative error of omega",
    "rotational_energy_drift": "relative drift of the energy",
    "angular_momentum_drift": "relative drift of the angular momentum",
}
_PANEL_IN = (3.5, 2.8)
_SMALLEST = 1e-17  # an error of 0 is drawn here


def distributions_svg(
    statistics: Sequence[tuple[Key, MethodStatistics]],
    measures: Sequence[str] = ROTATION_MEASURES,
    *,
    transparent: bool = False,
) -> bytes:
    """Return one panel per measure, at most two in a row, with one colour per engine."""
    looks = styles((key[0].name, key_text(key)) for key, _ in statistics).values()
    columns = min(2, len(measures))
    rows = -(-len(measures) // columns)
    with rendering():
        from matplotlib.figure import Figure

        page = Figure(figsize=(columns * _PANEL_IN[0], rows * _PANEL_IN[1]), layout="constrained")
        panels = page.subplots(rows, columns, squeeze=False)
        for axes, measure in zip(panels.flat, measures, strict=True):
            for (key, one), look in zip(statistics, looks, strict=True):
                if one.sketches[measure].total:
                    axes.step(
                        *_share_above(one.sketches[measure]),
                        where="post",
                        label=key_text(key),
                        color=COLOURS[look.colour],
                        linestyle=look.linestyle,
                    )
            axes.set(xscale="log", yscale="log", xlabel=_LABELS[measure], ylabel="share of bodies above")
        panels.flat[0].legend(loc="lower left", fontsize=6, handlelength=4.0)  # shows the dashes
        return figure_bytes(page, ".svg", transparent=transparent)


def _share_above(sketch: QuantileSketch) -> tuple[Array, Array]:
    """Return finite errors (k,), ascending, and the share of all bodies with at least that error (k,)."""
    low, _ = sketch.edges
    above = 1.0 - (np.cumsum(sketch.counts) - sketch.counts) / sketch.total
    finite = np.isfinite(low)
    return np.maximum(low[finite], _SMALLEST), above[finite]
