"""The output of `bodycheck ensemble` and `bodycheck hunt`, as documents and as data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bodycheck._util.formatting import count, scientific
from bodycheck.reports.document import Column, Command, Document, Sentence, Table
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.probes.examination import OTHER_BITS, SAME_BITS
from bodycheck.reports.summary.quantiles import Quantile
from bodycheck.runs.ensemble_files import method_rows, quantile_rows
from bodycheck.runs.ensemble_result import SENTINELS, EnsembleResult, key_text
from bodycheck.runs.hunt_run import HuntResult, command_of

_QUANTILES = (0.5, 0.95, 0.99)


def ensemble_document(result: EnsembleResult, folder: Path) -> Document:
    """Return the distribution of each method's orientation error, the replays, findings and the folder."""
    heads = ("method", "median", "95 %", "99 %", "worst", "unstable", "not measured")
    columns = (Column(heads[0]), *(Column(head, "number") for head in heads[1:]))
    rows = []
    for key, statistics in result.statistics:
        measured = statistics.bodies
        cells = [
            _quantile_text(statistics.quantile(ORIENTATION, share)) if measured else ""
            for share in _QUANTILES
        ]
        worst = _error(statistics.worst[0].error_rad) if statistics.worst else ""
        unstable = statistics.endings["unstable"]
        rows.append((key_text(key), *cells, worst, str(unstable), str(len(result.request.rows) - measured)))
    bodies = count(len(result.request.rows), "body").replace("bodys", "bodies")
    shard = f" of {result.request.n}, shard {result.request.shard}" if result.request.shard else ""
    title = f"orientation error in rad of {bodies}{shard}"
    parts: tuple[Sentence | Table, ...] = (
        Table(columns, tuple(rows), title=title),
        Sentence("The range after +- is half of the 95 % error bar of a quantile."),
        *(Sentence(sentence) for sentence in _replay_sentences(result)),
        *(Sentence(finding) for finding in result.findings),
        Sentence(str(folder)),
    )
    return Document("bodycheck ensemble", parts)


def _replay_sentences(result: EnsembleResult) -> Iterator[str]:
    """Yield which methods give bodies the same bits in any batch, and which do not."""
    for word in (SAME_BITS, OTHER_BITS):
        found = [key_text(key) for key, statistics in result.statistics if statistics.replay == word]
        if found:
            order = f"alone, together and in reverse order ({SENTINELS} bodies)"
            yield f"{word.capitalize()} {order}: {'; '.join(found)}"


def _error(value: float) -> str:
    return scientific(value) if math.isfinite(value) else "unstable"


def _quantile_text(quantile: Quantile) -> str:
    if not math.isfinite(quantile.value):
        return "unstable"
    half = 0.5 * (quantile.high - quantile.low)
    return f"{scientific(quantile.value)} +- {scientific(half)}"


def ensemble_data(result: EnsembleResult, folder: Path) -> dict[str, Any]:
    """Return quantiles, endings and the worst bodies as data."""
    worst = [
        {"method": key_text(key), "row": body.row, "outcome": body.outcome, **body.measures}
        for key, statistics in result.statistics
        for body in statistics.worst
    ]
    return {
        "folder": folder,
        "quantiles": quantile_rows(result),
        "methods": method_rows(result),
        "worst": worst,
        **({"shards": result.shards, "findings": result.findings} if result.shards else {}),
    }


def hunt_document(result: HuntResult, folder: Path) -> Document:
    """Return the worst start next to the typical one, and the command that repeats it."""
    names, measure = " against ".join(key_text(key) for key in result.keys), result.request.measure
    outcome = str(result.path.outcomes[result.worst])
    found = scientific(result.value) if math.isfinite(result.value) else outcome
    found += "" if result.ratio is None else f", {result.ratio:.3g} times the median"
    of = count(result.typical_of, "start")
    median = f"{scientific(result.typical)} ({of})" if result.typical_of else "none of them has a value"
    body, moments = result.bodies, result.bodies.moments[0]
    rows = (
        (f"{measure} of {names}", found),
        ("median of the uniform starts", median),
        ("found by evaluation", f"{result.worst + 1} of {len(result.path.scores)}"),
        ("principal moments (kg m^2)", ", ".join(f"{moment:.4g}" for moment in moments)),
        ("|2 E I2 / L^2 - 1|, 0 on the separatrix", f"{body.separatrix_distance[0]:.3g}"),
        ("omega in body axes (rad/s)", ", ".join(f"{rate:.4g}" for rate in body.omega_body[0])),
    )
    columns = (Column("", "fixed"), Column(""))
    return Document(
        "bodycheck hunt",
        (Table(columns, rows), Command(command_of(result, folder / "worst.toml")), Sentence(str(folder))),
    )


def hunt_data(result: HuntResult, folder: Path) -> dict[str, Any]:
    """Return the worst start and the improvements that led to it as data."""
    body = result.bodies
    return {
        "folder": folder,
        "measure": result.request.measure,
        "value": result.value,
        "typical": result.typical,
        "outcome": str(result.path.outcomes[result.worst]),
        "evaluation": result.worst + 1,
        "evaluations": len(result.path.scores),
        "moments_kg_m2": body.moments[0],
        "quaternion": body.quaternion[0],
        "omega_body_rad_s": body.omega_body[0],
        "separatrix_distance": float(body.separatrix_distance[0]),
        "path": [
            {"evaluation": index + 1, "value": float(result.path.values[index])}
            for index in result.improvements
        ],
        "reproduce": command_of(result, folder / "worst.toml"),
    }
