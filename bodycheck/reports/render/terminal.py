"""Print the summary at the end of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from bodycheck._util.formatting import console, count, print_columns
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.summary.cells import Overview, overviews, summary_cells
from bodycheck.reports.summary.sentences import verdict_sentences
from bodycheck.reports.summary.worst_results import worst_methods

if TYPE_CHECKING:
    from bodycheck.reports.run_files.run_tables import Run

_TINT_STYLES = {"good": "green", "floor": "green", "open": "yellow", "bad": "red", "fault": "red", "none": ""}


def print_summary(run: Run) -> None:
    """Print the outcomes, one line per method, and the worst results with their commands."""
    out = console()
    outcomes = ", ".join(f"{amount} {outcome}" for outcome, amount in run.manifest["outcomes"].items())
    seconds, compiling = run.manifest["run_s"], run.manifest["compile_s"]
    cases = count(len(run.cases), "case")
    out.print(f"{cases} in {seconds:.0f} s (compiling {compiling:.0f} s): {outcomes}")
    for engine in run.manifest["engines"].values():
        if "unavailable" in engine:
            out.print(Text(f"not measured: {engine['unavailable']}", style="yellow"))
    for scenario in (problem.scenario for problem in run.problems):
        for note in scenario.body.notes:
            out.print(Text(f"{scenario.name}: {note}", style="yellow"))
    cells = summary_cells(run)
    for sentence in verdict_sentences(run, cells):
        out.print(Text(sentence))
    rows = [(one.method, one.order, one.largest_error, _verdicts(one)) for one in overviews(cells)]
    heads = ("engine:method", "order of orientation", "largest error", "scenarios")
    print_columns(out, heads, rows, right=heads[1:2])
    worst = worst_methods(run)
    if worst:
        out.print(Text("\nWorst result of each method", style="bold"))
    for one in worst:
        style = "yellow" if one.worst.kind in ("property", "lower-order") else "red"
        out.print(Text(f"{one.method}: {one.sentence}", style=style))
        out.print(Text(f"    {one.worst.reproduce}"), soft_wrap=True)


def _verdicts(overview: Overview) -> Text:
    """Return the number of scenarios with each verdict, each in its colour."""
    words = (
        Text(f"{STATES[state].word} {amount}", style=_TINT_STYLES[STATES[state].tint])
        for state, amount in overview.states.items()
    )
    return Text(", ").join(words)
