"""The output of `bodycheck ensemble` and `bodycheck hunt`, as documents and as data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from markupsafe import Markup

from bodycheck._util.files import write_file
from bodycheck._util.formatting import count, scientific
from bodycheck.ensembles.ensemble_cases import ROTATION_MEASURES
from bodycheck.ensembles.ensemble_files import (
    DISTRIBUTIONS,
    distributions_svg,
    method_rows,
    quantile_rows,
    replays,
)
from bodycheck.ensembles.ensemble_result import SENTINELS, EnsembleResult, key_text
from bodycheck.ensembles.hunt_run import HuntResult, command_of
from bodycheck.reports.document import Command, Document, Drawing, Sentence, Table, page
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.render.figures import panel
from bodycheck.reports.render.styles import heading
from bodycheck.reports.run_files.method_words import OTHER_BITS, SAME_BITS
from bodycheck.reports.summary.quantiles import Quantile
from bodycheck.reports.table_layout import Column

_QUANTILES = (0.5, 0.95, 0.99)


def ensemble_document(result: EnsembleResult, folder: Path) -> Document:
    """Return the distribution of each method's orientation error, the replays, findings and worst bodies."""
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
    amount = len(result.request.rows)
    bodies = f"{amount} {'body' if amount == 1 else 'bodies'}"
    shard = f" of {result.request.n}, shard {result.request.shard}" if result.request.shard else ""
    title = f"Orientation error in rad of {bodies}{shard}"
    parts: tuple[Sentence | Table, ...] = (
        *(Sentence(text, strong=True) for text in _conclusion(result)),
        Table(columns, tuple(rows), title=title),
        Sentence(
            "In brackets: the ends of the 95 % error bar of a quantile; >= is its lower end, where too few "
            "bodies were measured to bound the quantile from above."
        ),
        *(Sentence(sentence) for sentence in _replay_sentences(result)),
        *(Sentence(finding) for finding in result.findings),
        _worst_table(result, folder),
    )
    return Document(f"bodycheck ensemble: {bodies}{shard}", parts)


def _conclusion(result: EnsembleResult) -> Iterator[str]:
    """Yield the method with the smallest error of nearly all bodies, and those with unstable bodies."""
    for share in reversed(_QUANTILES):
        found = [(one.quantile(ORIENTATION, share), key) for key, one in result.statistics if one.bodies]
        bounded = [pair for pair in found if math.isfinite(pair[0].high)]
        if bounded:
            quantile, key = min(bounded, key=lambda pair: pair[0].high)
            below = f"{100 * share:g} % are below {_quantile_text(quantile)} rad"
            yield f"{key_text(key)} has the smallest errors: {below}"
            break
    if unstable := [key_text(key) for key, one in result.statistics if one.endings["unstable"]]:
        yield f"Unstable on some bodies: {'; '.join(unstable)}"


def _worst_table(result: EnsembleResult, folder: Path) -> Table:
    """Return the worst bodies of each method, with the commands that replay them."""
    rows = tuple(
        (key_text(key), str(body.row), _error(body.error_rad), command)
        for key, statistics in result.statistics
        for body, command in replays(result, key, statistics, folder)
    )
    heads = (Column("method"), Column("body", "number"), Column("error, rad", "number"))
    columns = (*heads, Column("replay", "command"))
    return Table(columns, rows, title="Worst bodies", only=("markdown", "page"))


def write_ensemble_page(result: EnsembleResult, folder: Path) -> Path:
    """Write report.html: the distributions and the worst bodies, with the figure if it was drawn."""
    measures = ROTATION_MEASURES if (folder / DISTRIBUTIONS).exists() else ()
    drawn = (distributions_svg(result.statistics, [measure], transparent=True) for measure in measures)
    figure = Drawing(
        title="Distributions of the errors",
        note="The share of bodies whose error is larger than the abscissa; a line farther to the left is "
        "better. Both axes are logarithmic.",
        drawing=Markup().join(map(panel, drawn)),
    )
    document = ensemble_document(result, folder)
    path = folder / "report.html"
    write_file(path, page(replace(document, parts=(figure, *document.parts))).encode())
    return path


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
    """Return "1.00e-4 [4.70e-5, 5.09e-4]", the ends of the error bar in brackets."""
    if not math.isfinite(quantile.value):
        return "unstable"
    if not math.isfinite(quantile.high):
        return f">= {scientific(quantile.low)}"
    return f"{scientific(quantile.value)} [{scientific(quantile.low)}, {scientific(quantile.high)}]"


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
    """Return the largest error and the start that has it, and the command that repeats it."""
    names = " against ".join(key_text(key) for key in result.keys)
    measure, _, unit = heading(result.request.measure).partition(", ")
    outcome = str(result.path.outcomes[result.worst])
    found = f"{scientific(result.value)} {unit}".rstrip() if math.isfinite(result.value) else outcome
    found += "" if result.ratio is None else f", {result.ratio:.3g} times the median"
    of = count(result.typical_of, "start")
    typical = f"{scientific(result.typical)} {unit}".rstrip()
    median = f"{typical} ({of})" if result.typical_of else "none of them has a value"
    body, moments = result.bodies, result.bodies.moments[0]
    rows = (
        (f"median {measure} of random starts", median),
        ("found by evaluation", f"{result.worst + 1} of {len(result.path.scores)}"),
        ("principal moments, kg m^2", ", ".join(f"{moment:.4g}" for moment in moments)),
        ("|2 E I2 / L^2 - 1|, 0 on the separatrix", f"{body.separatrix_distance[0]:.3g}"),
        ("omega in body axes, rad/s", ", ".join(f"{rate:.4g}" for rate in body.omega_body[0])),
    )
    columns = (Column("", "fixed"), Column(""))
    return Document(
        "bodycheck hunt",
        (
            Sentence(f"{names}: largest {measure} {found}", strong=True),
            Table(columns, rows),
            Command(command_of(result, folder / "worst.toml")),
            Sentence(str(folder)),
        ),
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
