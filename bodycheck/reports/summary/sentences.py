"""The summary of a run: what is wrong, what is correct and what is undecided, as sentences and tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bodycheck._util.formatting import count, names, number
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.measurement.convergence import LARGEST_ERROR
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.run_tables import FAILED_CHECKS, MethodKey, Tables
from bodycheck.reports.summary.cells import Cell, Overview, overviews, summary_cells
from bodycheck.reports.summary.shared_maps import shared_maps
from bodycheck.reports.summary.worst_results import MethodResults, faulty, headline, worst_methods
from bodycheck.reports.table_layout import Column, Medium, Span

_REFUSED = ("invalid", "unsupported")
_ENGINES_IN_COMMON, _METHODS_IN_COMMON = 2, 3  # that have one wrong limit: fewer may agree by chance
_SAME_LIMIT = 1.02  # ratio of the largest to the smallest distance from the truth
_UNDECIDED = ("pre-asymptotic", "too-few-points", "chaotic")
_LISTED_METHODS = 6  # on a console; a larger run has one line per engine
_LISTED_FINDINGS = 3  # on a console
_NAMED = 3  # methods in the conclusion
_FOLDED: tuple[Medium, ...] = ("markdown", "page")


@dataclass(frozen=True)
class Summary:
    """The conclusions from a run, as shown by the terminal, Markdown and the report.

    cells: by scenario, then by engine and method. worst: the methods with results, worst first. alike,
    details: what is said of methods that make one map of a tree. failed: the checks that failed, in words.
    """

    cells: dict[str, dict[MethodKey, Cell]]
    worst: list[MethodResults]
    alike: tuple[str, ...] = ()
    details: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()

    @classmethod
    def of(cls, run: Tables) -> Summary:
        """Return the summary of a run."""
        cells, failed = summary_cells(run), run.manifest.get(FAILED_CHECKS, ())
        return cls(cells, worst_methods(run, cells), *map(tuple, (*shared_maps(run), failed)))

    @property
    def shared(self) -> tuple[str, ...]:
        """What is said of methods that make one map of a tree, with its details after the first sentence."""
        return *self.alike[:1], *self.details, *self.alike[1:]

    @property
    def sentences(self) -> list[str]:
        """The results in a few sentences that name every method with findings."""
        return [*self.shared, *verdict_sentences(self.cells, self.worst)]

    @property
    def conclusion(self) -> str:
        """The result in one sentence: which methods have findings, how many are sound or undecided."""
        if not any(self.cells.values()):
            return "This run has no cases."
        if shared := next(filter(None, (_common_cause(*one) for one in self.cells.items())), ""):
            return shared
        methods = overviews(self.cells)
        found = [one.method for one in faulty(self.worst)]
        states = Counter(self.group_of(one) for one in methods)
        where = " in some scenarios" if len(self.cells) > 1 else ""
        others = ", ".join(
            f"{states[group]} {one if states[group] == 1 else many}{where * (group == 'undecided')}"
            for group, (one, many) in _GROUPS.items()
            if states[group] and group != "findings"
        )
        if not found:
            if single := self._of_a_single_step:
                return single
            on = f" on {len(self.cells)} scenarios" if len(self.cells) > 1 else ""
            nothing = "No other findings" if self.failed else "No findings"
            what = nothing if states["unsupported"] < len(methods) else "Nothing was measured"
            return f"{what} in {count(len(methods), 'method')}{on}{self._far_off}: {others}."
        listed = names(found if len(found) <= _NAMED else [*found[:_NAMED], f"{len(found) - _NAMED} more"])
        rest = f"; {others}" if others else ""
        return f"Findings in {len(found)} of {count(len(methods), 'method')}: {listed}{rest}."

    @property
    def _every_cell(self) -> list[tuple[str, str, Cell]]:
        """Scenario, method and cell, of every cell."""
        return [
            (scenario, ":".join(key), cell)
            for scenario, by_method in self.cells.items()
            for key, cell in by_method.items()
        ]

    @property
    def _of_a_single_step(self) -> str:
        """The error of a run with one case that cannot show an order; "" for any other run."""
        every = self._every_cell
        if len(every) != 1:
            return ""
        scenario, method, cell = every[0]
        if cell.cases > 1 or cell.finest is None or cell.is_sound:
            return ""
        error = f"{method} is up to {number(cell.finest, 3)} rad from the truth in {scenario}"
        return f"{error} at {cell.finest_at}; a single step shows no order."

    @property
    def _far_off(self) -> str:
        """The method that is farthest from the truth, at its finest step or else at any, if it is far off."""
        chaotic = self.chaotic
        far = [
            (is_finest, scenario not in chaotic, error, method, scenario, at)
            for scenario, method, cell in self._every_cell
            for is_finest, error, at in (
                (True, cell.finest, f"at its finest step, {cell.finest_at}"),
                (False, cell.largest, f"at {cell.largest_at}"),
            )
            if error is not None and error >= LARGEST_ERROR
        ]
        if not far:
            return ""
        _, regular, error, method, scenario, at = max(far)
        where = scenario if regular else f"{scenario}, which is chaotic,"
        return f", but {method} is up to {number(error, 2)} rad from the truth in {where} {at}"

    @property
    def chaotic(self) -> frozenset[str]:
        """The scenarios whose motion no method can follow for long."""
        return frozenset(scenario for scenario, _, cell in self._every_cell if cell.state == "chaotic")

    def group_of(self, method: Overview) -> str:
        """Return the group of a method over all scenarios, a key of _GROUPS."""
        states = {state for state in method.states if state != "unsupported"}
        if any(one.method == method.method for one in faulty(self.worst)):
            return "findings"
        if not states:
            return "unsupported"
        sound = all(cell.is_sound for cell in method.cells.values() if cell.state in states)
        return "sound" if sound else "undecided"


_GROUPS = {
    "findings": ("has findings", "have findings"),
    "sound": ("converges or is at the floor", "converge or are at the floor"),
    "undecided": ("is undecided", "are undecided"),
    "unsupported": ("is not supported", "are not supported"),
}
"""Group of methods -> what is true of one of them and of several."""

_GROUP_CELLS = {
    "findings": Span("with findings", "bad"),
    "sound": Span("converge", "good"),
    "undecided": Span("undecided", "open"),
    "unsupported": Span("not supported"),
}


def verdict_sentences(cells: Mapping[str, Mapping[MethodKey, Cell]], found: list[MethodResults]) -> list[str]:
    """Return the results of the run in a few sentences that name every method with findings."""
    if not cells:
        return ["This run has no cases."]
    shared = (_common_cause(scenario, methods) for scenario, methods in cells.items())
    sentences = [*shared, headline(found), _as_expected(cells, found), _undecided(cells), _properties(found)]
    return [sentence for sentence in sentences if sentence]


def _common_cause(scenario: str, methods: Mapping[MethodKey, Cell]) -> str:
    """State that all methods of several engines have the same wrong limit; "" where they do not."""
    supported = {key: cell for key, cell in methods.items() if cell.state != "unsupported"}
    limits = [cell.wrong[0] for cell in supported.values() if cell.wrong and cell.wrong[0].has_wrong_limit]
    sizes = [one.size or 0.0 for one in limits]
    engines = {engine for engine, _ in supported}
    alone = len(engines) < _ENGINES_IN_COMMON or len(limits) < max(_METHODS_IN_COMMON, len(supported))
    if alone or len({one.quantity for one in limits}) > 1 or max(sizes) > _SAME_LIMIT * min(sizes):
        return ""
    return (
        f"All {len(limits)} methods of {len(engines)} engines have the same wrong limit in {scenario}: "
        f"{limits[0].text}. First check what they share: the scenario, its loads and its truth."
    )


def _as_expected(cells: Mapping[str, Mapping[MethodKey, Cell]], found: list[MethodResults]) -> str:
    """Name the methods that converge, or are at the floor, in every quantity wherever supported."""
    wrong = {one.method for one in faulty(found)}
    as_expected: dict[str, bool] = {}
    for methods in cells.values():
        for key, cell in methods.items():
            if cell.state != "unsupported":
                method = ":".join(key)
                as_expected[method] = as_expected.get(method, method not in wrong) and cell.is_sound
    good = [method for method, good_so_far in as_expected.items() if good_so_far]
    others = [method for method, good_so_far in as_expected.items() if not good_so_far]
    where = "wherever supported" if len(cells) > 1 else f"in {next(iter(cells))}"
    qualities = f"in all quantities {where}, with no order below the expected one"
    if not good:
        return ""
    if len(as_expected) == 1:
        return f"{good[0]} converges, or is at the floor, {qualities}."
    converge = f"methods converge, or are at the floor, {qualities}"
    if not others:
        return f"All {len(as_expected)} {converge}."
    return f"{len(good)} of {len(as_expected)} {converge}: {names(good)}."


def _undecided(cells: Mapping[str, Mapping[MethodKey, Cell]]) -> str:
    pairs = [cell for methods in cells.values() for cell in methods.values()]
    undecided = sum(cell.state in _UNDECIDED for cell in pairs)
    if not undecided:
        return ""
    scenarios = [s for s, methods in cells.items() if any(c.state in _UNDECIDED for c in methods.values())]
    return (
        f"No verdict for {undecided} of {count(len(pairs), 'pair')} of method and scenario, "
        f"in {names(scenarios)}: too few steps show an order."
    )


def _properties(found: list[MethodResults]) -> str:
    """Name the properties of the engines' states: an unnormalised quaternion is a design, not a fault."""
    results = [
        f"{one.method}: {result.sentence}"
        for one in found
        for result in one.results
        if result.kind == "property"
    ]
    return f"Properties of the engines' states, not faults: {'; '.join(results)}." if results else ""


def run_document(run: Tables) -> Document:
    """Return the conclusion, one row per method or engine, outcomes, and the worst results with commands.

    Consoles leave the rows of many methods, the properties and the reasons of partial support to the other
    media.
    """
    summary = Summary.of(run)
    methods = overviews(summary.cells)
    is_short = len(methods) <= _LISTED_METHODS
    folded = refusals(run)
    never = {one.method for one in methods if set(one.states) == {"unsupported"}}
    refused = [one for one in folded if one.outcome == "invalid" or never & set(one.names)]
    return Document(
        f"bodycheck: {count(len(summary.cells), 'scenario')}, {count(len(run.cases), 'case')}",
        (
            *_without_engines(run),
            *(Sentence(f"Failed check: {one}", "bad") for one in summary.failed),
            Sentence(summary.conclusion, strong=True, only=("console",)),
            *(Sentence(sentence, only=("console",)) for sentence in summary.alike),
            *_remarks(run),
            *(Sentence(sentence, only=_FOLDED) for sentence in summary.sentences),
            _method_table(methods) if is_short else replace(_method_table(methods), only=_FOLDED),
            *([] if is_short else [_engine_table(run, summary, methods)]),
            *(replace(table, only=("console",)) for table in refusal_table(refused)),
            *(replace(table, only=_FOLDED) for table in refusal_table(folded)),
            replace(_worst_table(summary.worst), only=_FOLDED),
            replace(
                _worst_table(faulty(summary.worst)),
                only=("console",),
                max_rows=_LISTED_FINDINGS,
                rest="report.html lists all",
            ),
            Sentence(_outcomes(run)),
            Sentence(_machine(run.manifest), only=("markdown",)),
        ),
    )


def run_data(run: Tables) -> dict[str, Any]:
    """Return the same as data: verdicts, orders and errors by method and scenario, and all results."""
    summary = Summary.of(run)
    return {
        "run_id": run.manifest["run_id"],
        "outcomes": run.manifest["outcomes"],
        "unavailable": {
            name: e["unavailable"] for name, e in run.manifest["engines"].items() if "unavailable" in e
        },
        "refusals": refusals(run),
        "conclusion": summary.conclusion,
        "sentences": summary.sentences,
        "methods": {one.method: one.cells for one in overviews(summary.cells)},
        "worst": summary.worst,
    }


def _outcomes(run: Tables) -> str:
    ended = ", ".join(f"{amount} {outcome}" for outcome, amount in run.manifest["outcomes"].items())
    seconds, compiling = run.manifest["run_s"], run.manifest["compile_s"] or 0.0
    compiled = f", after compiling for {compiling:.0f} s" if round(compiling) else ""
    took = "" if seconds is None else f" in {seconds:.0f} s{compiled}"
    return f"{count(len(run.cases), 'case')}{took}" + (f": {ended}" if ended else "")


def _without_engines(run: Tables) -> Iterator[Sentence]:
    """Yield that only the reference was measured, if engines were wanted; why follows in the remarks."""
    engines = run.manifest["engines"]
    if [name for name, entry in engines.items() if "version" in entry] == ["reference"] != [*engines]:
        yield Sentence("No engine was measured, only the reference.", "bad")


def _remarks(run: Tables) -> Iterator[Sentence]:
    """Yield why engines were not measured, how shards differ, and the notes on the scenarios' bodies."""
    for engine in run.manifest["engines"].values():
        if "unavailable" in engine:
            yield Sentence(f"Not measured: {engine['unavailable']}", "open")
    for finding in run.manifest.get("merged", {}).get("findings", ()):
        yield Sentence(finding, "open")
    for name, scenario in run.manifest["scenarios"].items():
        body = scenario["body"]
        for one in body if isinstance(body, list) else [body]:
            for note in one.get("notes", ()):
                yield Sentence(f"{name}: {note}", "open")


@dataclass(frozen=True)
class Refusal:
    """Cases of one engine that ended as unsupported or invalid for the same reason."""

    outcome: str
    engine: str
    reason: str
    methods: tuple[str, ...]
    scenarios: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """The methods with their engine."""
        return [f"{self.engine}:{method}" for method in self.methods]


def refusals(run: Tables) -> list[Refusal]:
    """Return why cases are unsupported or invalid, invalid ones first."""
    found: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for columns in (case.columns for case in run.cases):
        if columns["outcome"] in _REFUSED:
            key = (columns["outcome"], columns["engine"], columns["message"])
            found.setdefault(key, []).append(columns)
    distinct = [
        Refusal(
            *key,
            methods=tuple(dict.fromkeys(row["method"] for row in rows)),
            scenarios=tuple(dict.fromkeys(row["scenario"] for row in rows)),
        )
        for key, rows in found.items()
    ]
    return sorted(distinct, key=lambda one: _REFUSED.index(one.outcome))


def refusal_table(found: list[Refusal]) -> Iterator[Table]:
    """Yield a table of the reasons; nothing if there are none."""
    columns = (Column("outcome", "fixed"), Column("engine:method", "name"), Column("in"), Column("reason"))
    rows = tuple(
        (
            Span(one.outcome, STATES[one.outcome].tint),
            ", ".join(one.names),
            names(one.scenarios),
            one.reason,
        )
        for one in found
    )
    if rows:
        yield Table(columns, rows, title="Not measured", folded=True)


def _method_table(methods: list[Overview]) -> Table:
    columns = (
        Column("engine:method", "name"),
        Column("verdict"),
        Column("order", "fixed"),
        Column("largest error, rad", "number"),
        Column("at"),
    )
    rows = tuple((one.method, _verdicts(one), one.order, *one.largest_error) for one in methods)
    return Table(columns, rows, title="Methods", folded=True)


def _engine_table(run: Tables, summary: Summary, methods: Sequence[Overview]) -> Table:
    """Return one row per engine: the groups of its methods, and the most accurate at the common steps."""
    by_engine: dict[str, list[Overview]] = {}
    for one in methods:
        by_engine.setdefault(one.method.partition(":")[0], []).append(one)
    rows, chaotic = [], summary.chaotic
    for engine, own in by_engine.items():
        groups = Counter(map(summary.group_of, own))
        spans: list[Span] = []
        for group, span in _GROUP_CELLS.items():
            if groups[group]:
                comma = ", " if spans else ""
                spans.append(Span(f"{comma}{groups[group]} {span.text}", span.tint))
        most = max(one.supported for one in own)
        rated = [
            (error, one.method.partition(":")[2])
            for one in own
            if one.supported == most and (error := one.error_at_step(chaotic)) is not None
        ]
        error, method = min(rated, default=(None, ""))
        version = run.manifest["engines"].get(engine, {}).get("version", "")
        rows.append((f"{engine} {version}".strip(), tuple(spans), method, number(error, 2)))
    columns = (
        Column("engine", "name"),
        Column("methods"),
        Column("most accurate", "name"),
        Column("error, rad", "number"),
    )
    return Table(
        columns,
        tuple(rows),
        title="Engines, with the most accurate method at the common steps",
        only=("console",),
    )


def _verdicts(overview: Overview) -> tuple[Span, ...]:
    """Return each verdict in its colour, with the number of scenarios where there are several."""
    spans: list[Span] = []
    for state, amount in overview.states.items():
        number = f" in {amount}" if len(overview.cells) > 1 else ""
        spans += [Span(", ")] * bool(spans)
        spans.append(Span(STATES[state].word + number, STATES[state].tint))
    return tuple(spans)


def _worst_table(worst: list[MethodResults]) -> Table:
    columns = (Column("engine:method", "name"), Column("result"), Column("reproduce", "command"))
    rows = []
    for one in worst:
        tint = "open" if one.worst.kind in ("property", "lower-order") else "bad"
        rows.append((one.method, Span(one.sentence, tint), one.worst.reproduce))
    return Table(columns, tuple(rows), title="Worst result of each method")


def _machine(manifest: Mapping[str, Any]) -> str:
    available = {name: entry for name, entry in manifest["engines"].items() if "version" in entry}
    facts = (
        f"bodycheck {manifest['bodycheck']}",
        *(f"{name} {entry['version']}" for name, entry in available.items()),
        f"Python {manifest['python']}",
        f"{manifest['cpu']}, {manifest['cores']} cores, {manifest['platform']}",
        f"run {manifest['run_id']} of {manifest['created']}",
    )
    return f"{'; '.join(facts)}."
