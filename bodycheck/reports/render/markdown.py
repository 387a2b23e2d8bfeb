"""Summarise a run in about 60 lines of Markdown, for a comment on a pull request."""

from __future__ import annotations

from bodycheck._util.formatting import count, escaped_markdown, markdown_table
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.run_tables import MethodKey, RunTables
from bodycheck.reports.summary.cells import Cell, overviews, summary_cells
from bodycheck.reports.summary.sentences import verdict_sentences
from bodycheck.reports.summary.worst_results import worst_methods

_MOST_METHODS = 24


def markdown_summary(run: RunTables) -> str:
    """Return verdict, outcomes, the worst result of each method with its command, methods and machine."""
    manifest = run.manifest
    cells = summary_cells(run)
    ended = ", ".join(f"{amount} {outcome}" for outcome, amount in manifest["outcomes"].items())
    lines = [
        f"### bodycheck: {count(len(cells), 'scenario')}, {count(len(run.cases), 'case')}",
        "",
        *(f"- {escaped_markdown(sentence)}" for sentence in verdict_sentences(run, cells)),
        *(
            f"- Not measured: {escaped_markdown(engine['unavailable'])}"
            for engine in manifest["engines"].values()
            if "unavailable" in engine
        ),
        "",
        f"Cases: {ended}.",
        "",
        *_worst_lines(run),
        *_method_lines(cells),
        *_machine_lines(run),
    ]
    return "\n".join(lines)


def _worst_lines(run: RunTables) -> list[str]:
    worst = worst_methods(run)
    if not worst:
        return []
    rows = [(one.method, one.sentence, f"`{one.worst.reproduce}`") for one in worst]
    lines = ["**Worst result of each method**", "", *markdown_table(("method", "result", "reproduce"), rows)]
    return [*lines, ""]


def _method_lines(cells: dict[str, dict[MethodKey, Cell]]) -> list[str]:
    """Return one line per method: the count of each verdict, and the largest error at the common steps."""
    rows = [
        (
            one.method,
            ", ".join(f"{STATES[state].word} {amount}" for state, amount in one.states.items()),
            one.order,
            one.largest_error,
        )
        for one in overviews(cells)
    ]
    head = ("method", "scenarios", "order of orientation", "largest error at the common step")
    table = markdown_table(head, rows[:_MOST_METHODS])
    if len(rows) > _MOST_METHODS:
        table.append(f"\nand {len(rows) - _MOST_METHODS} more methods, in report.html.")
    return ["<details><summary>Methods</summary>", "", *table, "", "</details>", ""]


def _machine_lines(run: RunTables) -> list[str]:
    manifest = run.manifest
    there = {name: entry for name, entry in manifest["engines"].items() if "version" in entry}
    facts = (
        f"bodycheck {manifest['bodycheck']}",
        *(f"{name} {entry['version']}" for name, entry in there.items()),
        f"Python {manifest['python']}",
        f"{manifest['cpu']}, {manifest['cores']} cores, {manifest['platform']}",
        f"run {manifest['run_id']} of {manifest['created']}",
    )
    return [f"{escaped_markdown('; '.join(facts))}."]
