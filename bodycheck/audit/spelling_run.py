"""The law of spellings: all model files of one body give one motion in an engine, to round-off."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bodycheck._util.formatting import count, scientific
from bodycheck.adapters.importers import importer
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.audit.audit import Audit, Body
from bodycheck.audit.audit_imports import import_request
from bodycheck.audit.audit_run import (
    AuditOptions,
    base_engine,
    checked_engines,
    imported_audit,
)
from bodycheck.audit.audit_spins import error_of_numbers, orientation_error, spun, truth_of
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.table_layout import Column, Span
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.model_file import ModelFile

SPELLINGS = tuple(sorted(Path(__file__).with_name("spellings").iterdir()))
"""One body, its parts fixed to each other, as model files that state the same numbers up to their rounding.

`g_and_mm` states another body, 1e3 times as heavy and long, whose free rotation is the same.
"""


@dataclass(frozen=True)
class _Spun:
    rotations: Array | None
    message: str
    causes: tuple[str, ...]


def run_spellings(engines: Sequence[str] | None, timeout_s: float) -> list[SpellingResult]:
    """Return one result per spelling and importer; raises InputError for an unknown engine."""
    body = _body()
    truth = truth_of(body)
    found: list[SpellingResult] = []
    with closing(EnginePool()) as pool:
        for engine in checked_engines(engines):
            reads = importer(base_engine(engine))
            assert reads is not None
            control = error_of_numbers(pool, engine, body, truth, timeout_s)
            for kind, flags in ((kind, flags) for kind, known in reads.FLAGS.items() for flags in known):
                family = [read_model(path) for path in SPELLINGS]
                family = [one for one in family if one.format == kind]
                spins = [_spun(pool, engine, flags, one, timeout_s) for one in family]
                found += _results(f"{engine}:{flags}", family, spins, truth, control)
    return found


def _results(
    name: str, family: Sequence[ModelFile], spins: Sequence[_Spun], truth: Array, control: float | None
) -> Iterator[SpellingResult]:
    first = next((one.rotations for one in spins if one.rotations is not None), None)
    for model, one in zip(family, spins, strict=True):
        error = deviation = None
        if one.rotations is not None and first is not None:
            error, deviation = (
                orientation_error(one.rotations, truth),
                orientation_error(one.rotations, first),
            )
        yield SpellingResult(
            name, model.format, name_of(model.path), error, deviation, control, one.message, one.causes
        )


def name_of(path: Path) -> str:
    """Return the name of a spelling: that of its file without the number, which only puts them in order."""
    return path.stem.partition("_")[2].replace("_", " ")


def _body() -> Body:
    """Return the body of all spellings, as one of them states it."""
    (stated,) = (link.stated for link in read_model(SPELLINGS[0]).links)
    assert stated is not None
    return Body.of(stated.in_link)


def _spun(pool: EnginePool, engine: str, flags: str, model: ModelFile, timeout_s: float) -> _Spun:
    request = import_request(model.path, model.format, flags)
    rotations, why = spun(pool, engine, request, timeout_s)
    audited = imported_audit(pool, model, [engine], AuditOptions(spins=False, timeout_s=timeout_s))
    causes = _causes(audited, f"{engine}:{flags}")
    if rotations is not None and not np.isfinite(rotations).all():
        return _Spun(None, "the motion is not finite", causes)
    return _Spun(rotations, why, causes)


def _causes(audited: Audit, name: str) -> tuple[str, ...]:
    comparisons = (link.held[name] for link in audited.links if name in link.held)
    return tuple(
        dict.fromkeys(cause for one in comparisons if one.state == "differs" for cause in one.causes)
    )


APART_RAD = 1e-9
"""Round-off of a spin of 1000 steps; spellings that differ by more are other bodies to the engine."""


@dataclass(frozen=True)
class SpellingResult:
    """One spelling in one importer: error against the truth, distance to the importer's first spelling.

    Both in rad, the largest over a spin of one second; None where it could not be spun, with the reason.
    control_rad: the error of the engine with the body given by numbers.
    """

    importer: str
    format: str
    spelling: str
    error_rad: float | None
    apart_rad: float | None
    control_rad: float | None
    message: str = ""
    causes: tuple[str, ...] = ()

    @property
    def broken(self) -> bool:
        """Whether this spelling moves otherwise than the first, by more than the engine's own error."""
        own = 3.0 * (self.control_rad or 0.0)
        return self.apart_rad is not None and not self.apart_rad <= max(APART_RAD, own)


def _tint(one: SpellingResult) -> str:
    if one.broken or one.apart_rad is None:
        return "bad"
    return "good" if one.apart_rad <= APART_RAD else "open"


def spelling_document(results: Sequence[SpellingResult]) -> Document:
    """Return one row per spelling and importer."""
    broken = [one for one in results if one.broken or one.causes]
    not_spun = [one for one in results if one.apart_rad is None]
    text = f"{count(len(results), 'spelling')} of one body spun; {len(broken)} violate the law"
    text += f"; {len(not_spun)} could not be spun" if not_spun else ""
    columns = (
        Column("importer", "fixed"),
        Column("spelling"),
        Column("error", "number"),
        Column("apart", "number"),
        Column("cause"),
    )
    rows = tuple(
        (
            one.importer,
            f"{one.format}: {one.spelling}",
            "" if one.error_rad is None else scientific(one.error_rad),
            Span("" if one.apart_rad is None else scientific(one.apart_rad), _tint(one)),
            "; ".join(one.causes) or one.message,
        )
        for one in results
    )
    head = Sentence(f"{text}.", "bad" if broken else "good", strong=True)
    note = Sentence("error: from the truth; apart: from the importer's first spelling; rad within 1 s.")
    return Document("Spellings of one body", (head, note, Table(columns, rows, "Spellings")))
