"""The results of the law of spellings, as a document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bodycheck._util.formatting import count, scientific
from bodycheck.reports.document import Column, Document, Sentence, Span, Table

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
