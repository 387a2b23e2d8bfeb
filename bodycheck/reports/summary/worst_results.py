"""The worst results of a run, each with its quantity, size, step and the command that reproduces it.

The terminal, Markdown, the report and nightly runs all show exactly these.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from bodycheck._util.formatting import count, number, step
from bodycheck.reports.measurement.measures import SIGNED, gain_word
from bodycheck.reports.measurement.verdicts import FAULTS
from bodycheck.reports.run_files.run_tables import MethodKey, Tables, key_of
from bodycheck.reports.summary.cells import Cell
from bodycheck.reports.summary.error_curve import sequences_of

_WORST_FIRST = (
    "invalid",
    "failed",
    "does-not-converge",
    "error-grows",
    "off",
    "inconsistent",
    "lower-order",
    "timeout",
    "unstable",
    "property",
)


@dataclass(frozen=True)
class Result:
    """One finding against a method, or a property of its state, with a command that reproduces it.

    kind: a state, or `property`. quantity: a measure, or the check of a probe; "" where a case did not end
    well. size: of the quantity; results are sorted by it, descending. scenarios: where it occurs, the one
    with the largest size first; empty for a probe. cause: the diagnosis of the motion with that size.
    """

    kind: str
    method: str
    quantity: str
    text: str
    reproduce: str
    scenarios: tuple[str, ...] = ()
    size: float = 0.0
    cause: str = ""

    @property
    def sentence(self) -> str:
        """The result, its scenarios and its cause in one line."""
        first, *others = self.scenarios or ("",)
        more = f" and {count(len(others), 'more scenario')}" if others else ""
        where = f" in {first}{more}" if first else ""
        cause = f"; diagnosis: {self.cause}" if self.cause else ""
        return f"{self.text}{where}{cause}"


@dataclass(frozen=True)
class MethodResults:
    """All results of one method, worst first."""

    method: str
    results: tuple[Result, ...]

    @property
    def worst(self) -> Result:
        """The worst result."""
        return self.results[0]

    @property
    def sentence(self) -> str:
        """The worst result in one line, and the number of others."""
        more = len(self.results) - 1
        return self.worst.sentence + (f"; {count(more, 'more finding')}" if more else "")


_Cells = Mapping[str, Mapping[MethodKey, Cell]]


def worst_results(run: Tables, cells: _Cells) -> list[Result]:
    """Return all results, worst first; a result that recurs in several scenarios is listed once."""
    found: dict[tuple[str, str, str], list[Result]] = {}
    for one in (*_broken(run), *_judged(run, cells), *_probed(run), *_lawless(run)):
        found.setdefault((one.kind, one.method, one.quantity), []).append(one)
    merged = (_merged(same) for same in found.values())
    return sorted(merged, key=lambda one: (_WORST_FIRST.index(one.kind), -one.size))


def worst_methods(run: Tables, cells: _Cells) -> list[MethodResults]:
    """Return the methods that have results, each once, the one with the worst result first."""
    by_method: dict[str, list[Result]] = {}
    for one in worst_results(run, cells):
        by_method.setdefault(one.method, []).append(one)
    return [MethodResults(method, tuple(results)) for method, results in by_method.items()]


def faulty(methods: Iterable[MethodResults]) -> list[MethodResults]:
    """Return the methods that have more than properties of their state."""
    return [one for one in methods if one.worst.kind != "property"]


def _merged(same: list[Result]) -> Result:
    """Merge results that differ only in the scenario into the one with the largest size."""
    ordered = sorted(same, key=lambda one: -one.size)
    first = ordered[0]
    scenarios = tuple(dict.fromkeys(name for one in ordered for name in one.scenarios))
    return replace(first, scenarios=scenarios)


def _broken(run: Tables) -> Iterator[Result]:
    cases: dict[tuple[str, MethodKey, str], list[Mapping[str, Any]]] = {}
    for columns in (case.columns for case in run.cases):
        if (outcome := columns["outcome"]) in FAULTS:
            cases.setdefault((columns["scenario"], key_of(columns), outcome), []).append(columns)
    for (scenario, key, outcome), own in cases.items():
        text = f"{outcome} in {count(len(own), 'case')}: {own[0]['message']}"
        yield Result(outcome, ":".join(key), "", text, own[0]["reproduce"], (scenario,), len(own))


def _judged(run: Tables, cells: _Cells) -> Iterator[Result]:
    sequences = sequences_of(run.cases)
    for scenario, methods in cells.items():
        for key, cell in methods.items():
            ended = [case for case in sequences[scenario, key] if case.ok]
            for one in (*cell.wrong, *cell.properties) if ended else ():
                shown = next((case for case in ended if case.setting.fineness == one.fineness), ended[0])
                command = shown.columns["reproduce"]
                kind = "property" if one.is_property else one.state
                method = ":".join(key)
                cause = "" if one.is_property else cell.cause
                signed = shown.columns.get(f"{one.quantity}{SIGNED}")
                text = one.text if signed is None else f"{one.text}, {gain_word(signed)} energy"
                yield Result(kind, method, one.quantity, text, command, (scenario,), one.size or 0.0, cause)


def _probed(run: Tables) -> Iterator[Result]:
    """Yield the probe checks that a method failed."""
    for row in run.rows("probes"):
        if row["verdict"] == "inconsistent":
            yield Result(
                "inconsistent",
                ":".join(key_of(row)),
                row["check"],
                _probe_text(row),
                row["reproduce"],
                size=row.get("deviation", 0.0),
            )


def _lawless(run: Tables) -> Iterator[Result]:
    """Yield the laws that a method breaks."""
    for row in run.rows("laws"):
        if row["verdict"] == "broken":
            text = f"law {row['law']} broken: {row.get('message', '')}"
            method = ":".join(key_of(row))
            size = row.get("size", 0.0)
            yield Result("inconsistent", method, row["law"], text, row["reproduce"], size=size)


def _probe_text(row: Mapping[str, Any]) -> str:
    """Return the measured and expected values of a probe, its step and its message."""
    at = f" at dt {step(row['dt_s'])} s" if "dt_s" in row else ""
    message = f": {row['message']}" if row.get("message") else ""
    if row["check"].endswith("read_back"):  # the message has the values
        return f"{row['check']}{at}{message}"
    measured, expected = number(row.get("measured"), 6), number(row.get("expected"))
    return f"{row['check']} {measured}, expected {expected}{at}{message}"


def headline(methods: Iterable[MethodResults]) -> str:
    """Return one sentence that names the faulty methods and one for those only unstable; "" if none."""
    wrong = faulty(methods)
    unstable = [one.method for one in wrong if one.worst.kind == "unstable"]
    others = [one.method for one in wrong if one.worst.kind != "unstable"]
    parts = []
    if others:
        parts.append(f"{count(len(others), 'method')} with findings: {', '.join(others)}.")
    if unstable:
        parts.append(f"{count(len(unstable), 'method')} unstable in some cases: {', '.join(unstable)}.")
    return " ".join(parts)
