"""The explanation of a case as a document: cause, evidence, parameters, experiment, similar issues."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

import numpy as np
from markupsafe import Markup

from bodycheck._util.formatting import count, names, number, vector
from bodycheck.examine.diagnosis.candidate_maps import BASES
from bodycheck.examine.diagnosis.diagnosis import Diagnosis, FittedParameter
from bodycheck.examine.diagnosis.fit import planted
from bodycheck.examine.diagnosis.transitions import QUANTITIES
from bodycheck.examine.explanation.explain import ExplainedCase
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.document import Command, Document, Drawing, Part, Sentence, Table, page
from bodycheck.reports.measurement.verdicts import FAULTS
from bodycheck.reports.table_layout import Cell, Column, Span

_HOLDS = 30.0  # multiples of the round-off
_MIN_SHOWN = 1e-18  # below round-off: exact agreement on a logarithmic axis
_PANEL_IN = 2.2


@dataclass(frozen=True)
class Issue:
    """An issue of another project, of the same kind as some faults."""

    faults: tuple[str, ...]
    url: str
    what: str


@cache
def upstream_issues() -> tuple[Issue, ...]:
    """Return the issues of upstream_issues.toml."""
    text = files("bodycheck.examine.explanation").joinpath("upstream_issues.toml").read_text(encoding="utf-8")
    return tuple(
        Issue(tuple(entry["faults"]), entry["url"], entry["what"]) for entry in tomllib.loads(text)["issue"]
    )


def similar_issues(names: Sequence[str]) -> list[Issue]:
    """Return the upstream issues of the same kind as faults with these names."""
    return [
        issue
        for issue in upstream_issues()
        if any(fnmatchcase(name, pattern) for name in names for pattern in issue.faults)
    ]


@dataclass(frozen=True)
class Evidence:
    """The change of a quantity over one sample interval: its largest difference from the map, over its scale.

    Of the intervals that were fitted, which are spread evenly over a long motion.

    after: with the faults in the map. round_off: the difference that round-off makes.
    """

    quantity: str
    before: float
    after: float | None
    round_off: float

    @property
    def holds(self) -> bool:
        """Whether the quantity is that of the map without faults."""
        return self.before <= _HOLDS * self.round_off

    @property
    def is_round_off(self) -> bool:
        """Whether the map, with the faults in it, leaves nothing but round-off."""
        return (self.before if self.after is None else self.after) <= _HOLDS * self.round_off


def errors_over_time(found: Diagnosis) -> tuple[Array, Array, Array | None] | None:
    """Return times (n,), and the largest difference of any quantity from the map there, before and after."""
    parts = _differences(found)
    if parts is None:
        return None
    assert found.circumstances is not None
    rows = found.circumstances.transitions.rows
    times, *both = parts
    before, after = (None if one is None else np.max(np.abs(one[rows]), axis=0) for one in both)
    assert before is not None
    return times, before, after


def _differences(found: Diagnosis) -> tuple[Array, Array, Array | None] | None:
    """Return times (s,) and the differences (12, s) from the map without and with the faults."""
    at = found.circumstances
    if at is None:
        return None
    transitions, base = at.transitions, BASES[found.base]
    healthy = transitions.grid.model(transitions.scene)
    models = [healthy, *(planted(at, healthy, fit.faults, fit.values) for fit in found.fits[:1])]
    with np.errstate(all="ignore"):
        gaps = transitions.gaps(models, base)
    times = transitions.trajectory.t_s[transitions.indices + 1]
    return times, gaps[0], gaps[1] if len(gaps) > 1 else None


def evidence_of(found: Diagnosis) -> list[Evidence]:
    """Return what holds and what does not, by quantity."""
    parts = _differences(found)
    if parts is None or found.circumstances is None:
        return []
    _, before, after = parts
    transitions = found.circumstances.transitions
    evidence = []
    for name, span in QUANTITIES.items():
        if name in transitions.known:
            largest = float(np.max(np.abs(before[span])))
            rest = None if after is None else float(np.max(np.abs(after[span])))
            evidence.append(Evidence(name, largest, rest, float(transitions.noise[span.start])))
    return evidence


def explanation_document(cases: Sequence[ExplainedCase]) -> Document:
    """Return the explanations of cases in turn; the conclusion is the title and the first line."""
    if not cases:
        nothing = "Nothing to explain: no verdict counts against a method; --case examines one."
        return Document(_title(cases), (Sentence(nothing, "good"),))
    title = _title(cases)
    first = Sentence(title, _conclusion(cases[0]).tint, strong=True, only=("console",))
    return Document(title, (first, *explanation_parts(cases, concluded=len(cases) == 1)))


def explanation_parts(cases: Sequence[ExplainedCase], *, concluded: bool = False) -> list[Part]:
    """Return what explanations rest on; concluded: whether the conclusion of the only case stands above."""
    alone = len(cases) == 1
    return [part for one in cases for part in _parts(one, alone=alone, concluded=concluded)]


def _title(cases: Sequence[ExplainedCase]) -> str:
    if not cases:
        return "bodycheck explain: nothing is wrong"
    known = [one for one in cases if one.diagnosis is None or one.diagnosis.verdict != "unexplained"]
    causes = dict.fromkeys(_conclusion(one).text for one in known or cases)
    unexplained = len(cases) - len(known) if known else 0
    rest = f"; {count(unexplained, 'case')} unexplained" if unexplained else ""
    first = next(iter(causes))
    if len(causes) == 1:
        amount = count(len(known or cases), "case")
        return f"{first[0].upper()}{first[1:]}" + (f" ({amount}{rest})" if len(cases) > 1 else "")
    return f"{len(causes)} causes in {len(known)} cases, the first: {first}{rest}"


def _conclusion(one: ExplainedCase) -> Span:
    """Return the diagnosis of a case, or why there is none, in one clause."""
    found = one.diagnosis
    if found is None:
        reason = one.reason or _NOT_EXAMINED.get(
            one.case.columns["outcome"], "no case of the method ended well"
        )
        return Span(f"not examined: {reason}", "open")
    tint = {"explained": "bad", "lower-order": "bad", "healthy": "good"}.get(found.verdict, "open")
    return Span(found.sentence, tint)


def _parts(one: ExplainedCase, *, alone: bool, concluded: bool) -> Iterator[Part]:
    found = one.diagnosis
    of = "" if alone else f": {one.title}"
    facts = [*_facts(one)] if concluded else [("diagnosis", _conclusion(one)), *_facts(one)]
    yield Table((Column("", "fixed"), Column("")), tuple(facts), title=one.title)
    if found is not None:
        yield _parameter_table(found, of)
        yield _evidence_table(evidence_of(found), of)
        yield _issue_table([fault.name for fault in found.faults], of)
    if reproduce := one.case.columns.get("reproduce"):
        command = Command(str(reproduce), "reproduce")
        yield command if alone else replace(command, only=("console", "markdown"))


_NOT_EXAMINED = {
    "ok": "a single sample, no attitude or omega, a callback load, or too many steps per sample",
    "unsupported": "nothing was measured",
}
"""Outcome of a case without a diagnosis -> the reason."""


def _facts(one: ExplainedCase) -> Iterator[tuple[Cell, Cell]]:
    """Yield what is wrong, the map, and what would confirm the diagnosis."""
    found = one.diagnosis
    if found is not None and found.start is not None:
        yield "start", Span(found.start.sentence, "open")
    yield from _what_is_wrong(one)
    if found is None:
        return
    if found.verdict == "unexplained" and found.nearly:
        yield "nearest fault", "; and ".join(fault.sentence for fault in found.nearly)
    words = found.base_words
    if words not in found.sentence:
        is_map = found.verdict not in ("unexplained", "nearest") and all(
            one.is_round_off for one in evidence_of(found)
        )
        yield "map" if is_map else "nearest map", words
    for fault in found.faults:
        for direction in fault.undetermined:
            yield (
                "not determined",
                f"{fault.name} along {vector(direction)}: no change of it changes the motion",
            )
    for confirm in dict.fromkeys(fault.confirm for fault in found.faults if fault.confirm):
        yield "to confirm", confirm


def _what_is_wrong(one: ExplainedCase) -> Iterator[tuple[Cell, Cell]]:
    if one.wrong:
        first, *others = one.wrong
        also = f"; also wrong: {names([other.quantity for other in others])}" if others else ""
        yield "wrong", f"{first.text}{also}"
    if not one.case.ok:
        outcome = one.case.columns["outcome"]
        text, tint = f"{outcome}: {one.case.columns['message']}", "bad" if outcome in FAULTS else "open"
        yield "outcome", Span(text, tint)


def _parameter_table(found: Diagnosis, of: str) -> Table:
    columns = (
        Column("fault", "name"),
        Column("parameter"),
        Column("value", "number"),
        Column("95 % interval"),
    )
    is_whole = found.verdict != "nearest"  # the interval is that of a fault which explains all of the error
    rows = tuple(
        (
            fault.name,
            " ".join(filter(None, (p.name, p.unit))),
            number(p.value, 6),
            _interval(p) if is_whole else "not known, as some error is left",
        )
        for fault in found.faults
        for p in fault.parameters
    )
    return Table(columns, rows, title=f"Fitted parameters{of}")


def _interval(parameter: FittedParameter) -> str:
    if np.isinf(parameter.high) and np.isinf(parameter.low):
        return "not determined"
    if np.isinf(parameter.high):
        return f"at least {number(parameter.low, 6)}"
    if np.isinf(parameter.low):
        return f"at most {number(parameter.high, 6)}"
    return f"{number(parameter.low, 6)} to {number(parameter.high, 6)}"


def _evidence_table(evidence: Sequence[Evidence], of: str) -> Table:
    columns = (
        Column("quantity"),
        Column("holds"),
        Column("difference", "number"),
        Column("left", "number"),
        Column("round-off", "number"),
    )
    rows = tuple(
        (
            "omega in its axes" if one.quantity == "omega" else one.quantity,
            Span("yes", "good") if one.holds else Span("no", "bad"),
            number(one.before, 3),
            number(one.after, 3),
            number(one.round_off, 2),
        )
        for one in evidence
    )
    heading = "Evidence, as largest difference from the map over the examined sample intervals"
    return Table(columns, rows, title=f"{heading}{of}")


def _issue_table(names: Sequence[str], of: str) -> Table:
    rows = tuple((issue.what, issue.url) for issue in similar_issues(names))
    columns = (Column("issue"), Column("address", "fixed"))
    return Table(columns, rows, title=f"Issues of the same kind in other projects{of}")


def explanation_data(cases: Sequence[ExplainedCase]) -> list[dict[str, Any]]:
    """Return the explanations as plain data."""
    found = []
    for one in cases:
        diagnosis = one.diagnosis
        found.append(
            {
                "scenario": one.problem.scenario.name,
                "method": ":".join(one.key),
                "dt_s": one.case.dt_s,
                "outcome": one.case.columns["outcome"],
                "wrong": [verdict.text for verdict in one.wrong],
                "diagnosis": None if diagnosis is None else replace(diagnosis, fits=(), circumstances=None),
                "evidence": [] if diagnosis is None else evidence_of(diagnosis),
                "issues": []
                if diagnosis is None
                else similar_issues([fault.name for fault in diagnosis.faults]),
            }
        )
    return found


def explanation_page(cases: Sequence[ExplainedCase]) -> str:
    """Return the explanations as one self-contained HTML page, with the figure if matplotlib is installed."""
    document = explanation_document(cases)
    drawn = drawn_explanations(cases, "that the engine reports")
    return page(replace(document, parts=(*document.parts, drawn)))


def drawn_explanations(cases: Sequence[ExplainedCase], start: str) -> Drawing:
    """Return a panel for each case with differences; none without matplotlib. start: of each interval."""
    from bodycheck.reports.render.figures import panel

    differ = [one for one in cases if one.diagnosis and errors_over_time(one.diagnosis)]
    if find_spec("matplotlib") is None:
        differ = []
    return Drawing(
        title="The difference from the map, without and with the fault",
        note="The largest difference of any quantity over one sample interval, divided by the scale of the "
        f"quantity. Each interval starts from the state {start}, so earlier errors do not accumulate.",
        drawing=Markup().join(panel(explanation_figure([one], ".svg", on_page=True)) for one in differ),
    )


def explanation_figure(cases: Sequence[ExplainedCase], suffix: str, *, on_page: bool = False) -> bytes:
    """Return a figure of the differences from the map over time, without and with the explanation.

    suffix: .png, .svg or .pdf. One panel per case. on_page: of one column, which a phone shows whole, and
    without a background, for light and dark.
    """
    from bodycheck.reports.render.figures import WIDTHS_IN, figure_bytes, rendering

    rows = [(one, errors) for one in cases if one.diagnosis and (errors := errors_over_time(one.diagnosis))]
    with rendering():
        from matplotlib.figure import Figure

        width_in = WIDTHS_IN[1 if on_page else 2]
        drawn = Figure(figsize=(width_in, _PANEL_IN * max(len(rows), 1)), layout="constrained")
        for row, (one, (times, before, after)) in enumerate(rows, 1):
            axes = drawn.add_subplot(len(rows), 1, row, title=one.title, yscale="log")
            axes.plot(times, np.maximum(before, _MIN_SHOWN), ".-", label="difference from the map")
            if after is not None:
                axes.plot(times, np.maximum(after, _MIN_SHOWN), ".-", label="with the fault in the map")
            axes.set_ylabel("per interval, of scale")
            axes.legend(fontsize=6)
            axes.set_xlabel("t, s")
        return figure_bytes(drawn, suffix, transparent=on_page)
