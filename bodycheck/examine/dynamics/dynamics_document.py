"""What an engine reports of trees, as a document: the answer, causes, a row per reading, what is missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from bodycheck._util.formatting import count, names, number
from bodycheck.examine.dynamics.engine_dynamics import LABELS, EngineDynamics, ReadingResult
from bodycheck.reports.document import Document, Part, Sentence, Table
from bodycheck.reports.table_layout import Column, Span

_TINTS = {"right": "good", "wrong": "bad", "failed": "bad", "unsupported": "open"}
_AFTER = {
    "start": "old state",
    "one step before": "state before",
    "end": "new state",
    "unclear": "unclear",
    "": "",
}
_HEADS = ("M", "bias", "gravity", "u'", "wrench", "energy", "P, L", "poses")
_COLUMNS = (
    Column("reading", "fixed"),
    Column("verdict", "fixed"),
    Column("median", "number"),
    Column("worst", "number"),
    Column("worst tree", "name"),
    Column("right in", "number"),
    Column("after a step", "fixed"),
    Column("call, axes and order of the engine", only=("markdown", "page")),
)


def dynamics_document(found: Sequence[EngineDynamics]) -> Document:
    """Return the answer of `bodycheck dynamics`: of one engine in full, of several a table and sentences."""
    if len(found) == 1:
        return Document("bodycheck dynamics", tuple(_parts(found[0])))
    heads = (Column("engine", "fixed"), *(Column(head, "number") for head in _HEADS))
    table = Table(heads, tuple(map(_engine_row, found)), "Largest relative deviations from the exact values")
    sentences = (
        part if part.strong else replace(part, text=f"{one.engine}: {part.text}")
        for one in found
        for part in _parts(one)
        if isinstance(part, Sentence)
    )
    return Document("bodycheck dynamics", (*sentences, table))


def _engine_row(found: EngineDynamics) -> tuple[str | Span, ...]:
    cells = (
        Span(one.verdict if one.worst is None else number(one.worst, 1), _TINTS[one.verdict])
        for one in found.readings
    )
    return f"{found.engine} {found.version}", *cells


def _parts(found: EngineDynamics) -> Iterator[Part]:
    engine = f"{found.engine} {found.version}"
    measured = [one for one in found.readings if one.read]
    wrong = [LABELS[one.reading] for one in found.wrong]
    if not measured:
        yield Sentence(f"{engine} reports nothing of {count(len(found.trees), 'tree')}", "open", strong=True)
    elif wrong:
        yield Sentence(f"{engine}: {names(wrong)} wrong; {_right(measured)}", "bad", strong=True)
    else:
        yield Sentence(f"{engine}: {_right(measured)}", "good", strong=True)
    for cause in found.causes:
        readings = names([LABELS[name] for name in cause.readings])
        explained, examined = cause.trees
        where = "" if explained == examined == 1 else f" in {explained} of {examined} trees"
        yield Sentence(f"{readings}: {cause.text} ({cause.tree}{where})", "bad")
    for result in found.wrong:
        if result.at_rest is not None and result.worst is not None and result.at_rest < 1e-6 * result.worst:
            right = f"right at rest, to a relative {number(result.at_rest, 2)}"
            yield Sentence(f"{LABELS[result.reading]}: {right}, wrong in motion", "bad")
    for reading in found.unexplained:
        elsewhere = " of the other trees" if any(reading in cause.readings for cause in found.causes) else ""
        yield Sentence(f"{LABELS[reading]}: no known fault explains them{elsewhere}", "open")
    if late := [LABELS[one.reading] for one in found.late]:
        which = "all readings" if len(late) == sum(bool(one.stage) for one in measured) else names(late)
        yield Sentence(f"no fault: after a step, {which} describe the state at its start")
    if found.no_step:
        yield Sentence(f"after a step: {found.no_step}")
    yield Table(_COLUMNS, tuple(map(_row, found.readings)), "Relative deviations from the exact values")
    yield from _missing(found)


def _right(measured: list[ReadingResult]) -> str:
    right = [one for one in measured if one.verdict == "right"]
    if not right:
        return "nothing right"
    worst = number(max(one.worst or 0.0 for one in right), 2)
    largest = max(one.read for one in right)
    return f"{count(len(right), 'reading')} right to a relative {worst} in {count(largest, 'tree')}"


def _row(one: ReadingResult) -> tuple[str | Span, ...]:
    share = f"{one.right}/{one.read}" if one.read else ""
    values = ("" if value is None else number(value, 2) for value in (one.median, one.worst))
    verdict = Span(one.verdict, _TINTS[one.verdict])
    return LABELS[one.reading], verdict, *values, one.at, share, _AFTER[one.stage], one.native


def _missing(found: EngineDynamics) -> Iterator[Part]:
    reasons: dict[str, list[str]] = {}
    for one in found.readings:
        for reason in one.reasons:
            reasons.setdefault(reason, []).append(LABELS[one.reading])
    rows = [(names(readings), reason) for reason, readings in reasons.items()]
    trees: dict[str, list[str]] = {}
    for tree, reason in found.unread.items():
        trees.setdefault(reason, []).append(tree)
    rows += [(count(len(some), "tree") if len(some) > 2 else names(some), why) for why, some in trees.items()]
    yield Table((Column("not read"), Column("reason")), tuple(rows), "Not read")
