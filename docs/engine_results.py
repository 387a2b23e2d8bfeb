"""Write what runs measured into the engines' pages, and the list of all engines into docs/engines.md.

python docs/engine_results.py RUN...: folders of runs, such as one of `bodycheck run smoke heavy-top
off-centre-link --engine ...`. Rewrites what is between the two comments below, for each engine of the runs.
A method that two runs have is taken from the last.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bodycheck._util.formatting import scientific, step
from bodycheck.reports.document import escaped_markdown, markdown_table
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.run_files.method_words import NO_KNOWN_MAP, NOT_MEASURED
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.reports.summary.sentences import Summary
from bodycheck.reports.summary.worst_results import faulty

PAGES = Path(__file__).parent
BEGIN, END = "<!-- measured -->", "<!-- end of measured -->"
MEASURED_ON = "free-flight"
"""The scenario of the orders and floors: a free body that every engine can represent."""
_HEAD = (
    *("method", "one-step map", "verdict", "order"),
    *("least error, rad", "floor, rad", "predicted floor, rad"),
)
_ALL = (
    "engine",
    "version",
    "precision",
    "methods",
    "orders",
    "least error, rad",
    "does not represent",
    "methods with findings",
)


@dataclass(frozen=True)
class MeasuredMethod:
    """One method in the runs.

    row: of methods.csv, the orientation error on free-flight; None where the method does not represent it.
    verdicts: of the orientation error, by scenario. refused: why scenarios, or scenes of laws, are not
    represented. finding: the worst, and the number of others; "" for a healthy method. fingerprint: the
    measured map and its distance; "" for a method without steps.
    """

    name: str
    version: str
    precision: str
    row: Mapping[str, Any] | None
    verdicts: Mapping[str, str]
    refused: tuple[str, ...]
    finding: str
    fingerprint: str


def measured(runs: Iterable[Tables]) -> dict[str, dict[str, MeasuredMethod]]:
    """Return engine -> name -> method, each of the last run that has it."""
    found: dict[str, dict[str, MeasuredMethod]] = {}
    for run in runs:
        for engine, methods in _of_run(run).items():
            found.setdefault(engine, {}).update(methods)
    return found


def _of_run(run: Tables) -> dict[str, dict[str, MeasuredMethod]]:
    findings = {one.method: one.sentence for one in faulty(Summary.of(run).worst)}
    rows: list[Any] = run.methods[run.methods["quantity"] == ORIENTATION].to_dict("records")
    refused: dict[tuple[str, str], dict[str, None]] = {}
    for case in run.cases:
        if case.columns["outcome"] == "unsupported":
            key = (case.columns["engine"], case.columns["method"])
            refused.setdefault(key, {})[case.columns["message"]] = None
    for law in run.laws.to_dict("records"):
        _, unsupported, reason = str(law["message"]).partition("unsupported: ")
        if unsupported:
            refused.setdefault((law["engine"], law["method"]), {})[reason] = None
    maps = {
        (row["engine"], row["method"]): _map_of(row)
        for row in run.fingerprints.to_dict("records")
        if row["fingerprint"] != NOT_MEASURED
    }
    found: dict[str, dict[str, MeasuredMethod]] = {}
    for engine, facts in run.manifest["engines"].items():
        for name, stated in facts.get("methods", {}).items():
            mine = {r["scenario"]: r for r in rows if (r["engine"], r["method"]) == (engine, name)}
            found.setdefault(engine, {})[name] = MeasuredMethod(
                name,
                facts["version"],
                stated["precision"],
                mine.get(MEASURED_ON),
                {scenario: row["verdict"] for scenario, row in mine.items()},
                tuple(refused.get((engine, name), ())),
                findings.get(f"{engine}:{name}", ""),
                maps.get((engine, name), ""),
            )
    return found


def with_measured(page: str, lines: Sequence[str]) -> str:
    """Return the page with what is between the comments replaced."""
    before, _, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"no {BEGIN} ... {END} in the page")
    return "\n".join([f"{before}{BEGIN}", *lines, f"{END}{after}"])


def engine_lines(methods: Iterable[MeasuredMethod]) -> Iterator[str]:
    """Yield the table of an engine's page, what it does not represent, and its faults."""
    methods = list(methods)
    ran = ", ".join(f"`{one}`" for one in dict.fromkeys(name for one in methods for name in one.verdicts))
    yield f"Version {methods[0].version} on {ran}."
    yield f"Order, error and floors are those of the orientation on `{MEASURED_ON}`."
    yield ""
    yield from markdown_table(_HEAD, [_cells(one) for one in methods])
    yield from _listed(
        "Not represented", ((reason, one) for one in methods for reason in one.refused), methods
    )
    yield from _listed("Findings", ((one.finding, one) for one in methods if one.finding), methods)


def _listed(
    title: str, found: Iterable[tuple[str, MeasuredMethod]], methods: Sequence[MeasuredMethod]
) -> Iterator[str]:
    """Yield each sentence once, with the methods that it concerns unless these are all."""
    sentences = _together(found, methods)
    yield from ("", f"{title}:" if sentences else f"{title}: none.")
    if sentences:
        yield ""
    yield from (f"- {sentence}" for sentence in sentences)


def _together(found: Iterable[tuple[str, MeasuredMethod]], methods: Sequence[MeasuredMethod]) -> list[str]:
    """Return each sentence once, after the names of the methods that it concerns unless these are all."""
    together: dict[str, list[str]] = {}
    for sentence, one in found:
        together.setdefault(sentence, []).append(one.name)
    return [
        ("" if len(names) == len(methods) else f"`{', '.join(names)}`: ") + escaped_markdown(sentence)
        for sentence, names in together.items()
    ]


def _cells(one: MeasuredMethod) -> tuple[str, ...]:
    row = one.row or {}
    at = _number(row.get("best_dt_s"))
    least = _figure(row.get("least_error"))
    return (
        f"`{one.name}`",
        one.fingerprint,
        _verdicts(one.verdicts.values()),
        _order(row),
        f"{least} at {step(at)} s" if least and at is not None else least or _figure(row.get("finest_error")),
        _figure(row.get("measured_floor")),
        _figure(row.get("predicted_floor")),
    )


def _map_of(row: Mapping[str, Any]) -> str:
    if row["fingerprint"] == NO_KNOWN_MAP:
        return NO_KNOWN_MAP
    return f"{row['fingerprint']} to {row['agreement']:.1e}"


def _verdicts(verdicts: Iterable[str]) -> str:
    counts: dict[str, int] = {}
    for verdict in verdicts:
        counts[verdict] = counts.get(verdict, 0) + 1
    return ", ".join(verdict if n == 1 else f"{verdict} {n}" for verdict, n in counts.items())


def _number(value: Any) -> float | None:
    return None if value is None or value != value else float(value)


def _figure(value: Any) -> str:
    found = _number(value)
    return "" if found is None else scientific(found)


def _order(row: Mapping[str, Any]) -> str:
    found = _number(row.get("order"))
    return "" if found is None else f"{found:.2f}"


def overview_lines(engines: Mapping[str, Mapping[str, MeasuredMethod]]) -> Iterator[str]:
    """Yield the list of all engines."""
    yield from markdown_table(
        _ALL, [_overview(name, list(methods.values())) for name, methods in engines.items()]
    )


def _overview(engine: str, methods: Sequence[MeasuredMethod]) -> tuple[str, ...]:
    orders = [found for one in methods if (found := _number((one.row or {}).get("order"))) is not None]
    errors = [
        found
        for one in methods
        if (found := _number((one.row or {}).get("least_error"))) is not None
        or (found := _number((one.row or {}).get("finest_error"))) is not None
    ]
    refused = ((reason, one) for one in methods for reason in one.refused)
    wrong = [one.name for one in methods if one.finding]
    return (
        engine,
        methods[0].version,
        ", ".join(dict.fromkeys(one.precision for one in methods)),
        str(len(methods)),
        _range([f"{order:.1f}" for order in sorted(orders)]),
        _range([scientific(error) for error in sorted(errors)]),
        "; ".join(_together(refused, methods)).replace("`", "") or "all represented",
        ", ".join(wrong) or "none",
    )


def _range(ordered: Sequence[str]) -> str:
    if not ordered:
        return ""
    return ordered[0] if ordered[0] == ordered[-1] else f"{ordered[0]} to {ordered[-1]}"


def main(folders: Sequence[str]) -> None:
    """Rewrite the page of each engine of the runs, and the list of all."""
    engines = measured(read_tables(Path(folder)) for folder in folders)
    for engine, methods in engines.items():
        _rewrite(PAGES / "engines" / f"{engine}.md", engine_lines(methods.values()))
    _rewrite(PAGES / "engines.md", overview_lines(engines))


def _rewrite(path: Path, lines: Iterable[str]) -> None:
    path.write_text(with_measured(path.read_text(encoding="utf-8"), list(lines)), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
