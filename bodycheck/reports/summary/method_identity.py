"""What a method is and which laws it obeys: its known one-step map and its laws, as text and documents."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from bodycheck._util.formatting import count, names, number
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.run_files.method_words import NO_KNOWN_MAP, NOT_MEASURED, REPLAY, map_in_words
from bodycheck.reports.run_files.run_tables import MethodKey, key_of
from bodycheck.reports.table_layout import Column, Span

_UNKNOWN = (NO_KNOWN_MAP, NOT_MEASURED)

RowsByMethod: TypeAlias = Mapping[MethodKey, Sequence[Mapping[str, Any]]]


def rows_by_method(rows: Iterable[Mapping[str, Any]]) -> RowsByMethod:
    """Return the rows of fingerprints.csv or laws.csv by engine and method."""
    found: dict[MethodKey, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(key_of(row), []).append(row)
    return found


def known_map_text(rows: RowsByMethod, key: MethodKey) -> str:
    """Return the known map of a method with its agreement, or the order and leading error."""
    return "; ".join(map_text(row) for row in rows.get(key, ())) or "not compared"


def map_text(row: Mapping[str, Any]) -> str:
    """Return a row of fingerprints.csv as text."""
    if row["fingerprint"] in _UNKNOWN:
        return f"{row['fingerprint']}: {row.get('message', '')}"
    note = f"; {row['message']}" if row.get("message") else ""
    return f"{map_in_words(row['fingerprint'])}, to {number(row.get('digits'), 3)} digits{note}"


def laws_text(by_method: RowsByMethod, key: MethodKey) -> str:
    """Return which laws a method breaks, or that it breaks none."""
    rows = by_method.get(key, ())
    if not rows:
        return "not checked"
    broken = [f"{row['law']} ({number(row.get('size'), 2)})" for row in rows if row["verdict"] == "broken"]
    open_ones = [row["law"] for row in rows if row["verdict"] == "not-measured"]
    text = f"broken: {', '.join(broken)}" if broken else "none broken"
    text += "".join(f"; {_bits(row)}" for row in rows if row["law"] == REPLAY and row["verdict"] in _BITS)
    return text + (f"; not measured: {names(open_ones)}" if open_ones else "")


_BITS = {"holds": "a second run has the same bits", "property": "a second run has other bits"}


def _bits(row: Mapping[str, Any]) -> str:
    size = "" if row["verdict"] == "holds" else f" ({number(row.get('size'), 2)})"
    return _BITS[row["verdict"]] + size


_TINTS = {"holds": "good", "broken": "bad", "property": "none", "not-measured": "open"}


def fingerprint_document(rows: Sequence[Mapping[str, Any]]) -> Document:
    """Return which methods are known maps; per method the map, the differences of it and of the next."""
    heads = (
        Column("method", "fixed"),
        Column("one-step map"),
        Column("difference"),
        Column("next nearest map"),
    )
    cells = []
    for row in rows:
        known = row.get("agreement") is not None
        runner = f"{map_in_words(row['runner_up'])} {number(row['runner_up_distance'], 2)}" if known else ""
        tint = "open" if row["fingerprint"] in _UNKNOWN else "good"
        agreement = number(row["agreement"], 2) if known else ""
        cells.append((":".join(key_of(row)), Span(map_in_words(row["fingerprint"]), tint), agreement, runner))
    notes = [Sentence(f"{':'.join(key_of(row))}: {row['message']}") for row in rows if row.get("message")]
    formulas = dict.fromkeys(
        f"{map_in_words(row['fingerprint'])}: {row['description']}" for row in rows if row.get("description")
    )
    unknown = [":".join(key_of(row)) for row in rows if row["fingerprint"] in _UNKNOWN]
    if len(rows) == 1:
        verb = ":" if unknown else " steps by the known map"
        lead = f"{':'.join(key_of(rows[0]))}{verb} {map_in_words(rows[0]['fingerprint'])}"
    else:
        matched = len(rows) - len(unknown)
        lead = f"{matched} of {count(len(rows), 'method')} with a known map"
        lead += f"; without: {names(unknown)}" if unknown else ""
    first = Sentence(lead, "open" if unknown else "good", strong=True)
    table = Table(heads, tuple(cells))
    return Document("bodycheck fingerprint", (first, table, *notes, *(Sentence(one) for one in formulas)))


def laws_document(rows: Sequence[Mapping[str, Any]]) -> Document:
    """Return what is broken, and a row per method and law: the violation and the state that shows it most."""
    heads = (
        Column("method", "fixed"),
        Column("law", "fixed"),
        Column("verdict", "fixed"),
        Column("violation", "fixed"),
        Column("tolerance", "fixed"),
        Column("state or reason"),
    )
    cells = tuple(
        (
            ":".join(key_of(row)),
            row["law"],
            Span(row["verdict"], _TINTS[row["verdict"]]),
            number(row["size"], 2) if row.get("size") is not None else "",
            number(row["tolerance"], 2) if row.get("tolerance") is not None else "",
            row.get("message", ""),
        )
        for row in rows
    )
    methods = list(dict.fromkeys(":".join(key_of(row)) for row in rows))
    broken = [f"{row['law']} by {':'.join(key_of(row))}" for row in rows if row["verdict"] == "broken"]
    holding = sum(row["verdict"] == "holds" for row in rows)
    summary = f"{names(methods)}: no law is broken, {holding} hold"
    if broken:
        summary = f"{count(len(broken), 'law')} broken: {names(broken)}"
    parts = [Sentence(summary, "bad" if broken else "good", strong=True)]
    if any(row["verdict"] == "property" for row in rows):
        parts.append(Sentence("A property, such as steps that cannot be reversed, is no fault."))
    return Document("bodycheck laws", (*parts, Table(heads, cells)))
