"""What a run says on the terminal at its end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from bodycheck.reports.console import console, print_columns
from bodycheck.reports.offenders import offenders
from bodycheck.reports.overview import Overview, overviews
from bodycheck.reports.states import STATES
from bodycheck.reports.summary import summary_cells
from bodycheck.reports.wording import count

if TYPE_CHECKING:
    from bodycheck.reports.run import Run

_TINT_STYLES = {"good": "green", "floor": "green", "open": "yellow", "bad": "red", "fault": "red", "none": ""}
_MOST_OFFENDERS = 10


def print_summary(run: Run) -> None:
    """Print how the cases ended, one line a method, and the worst that was found with its commands."""
    out = console()
    outcomes = ", ".join(f"{amount} {outcome}" for outcome, amount in run.manifest["outcomes"].items())
    seconds, compiling = run.manifest["run_s"], run.manifest["compile_s"]
    cases = count(len(run.cases), "case")
    out.print(f"{cases} in {seconds:.0f} s (compiling {compiling:.0f} s): {outcomes}")
    for engine in run.manifest["engines"].values():
        if "unavailable" in engine:
            out.print(Text(f"not measured: {engine['unavailable']}", style="yellow"))
    for scenario in (subject.scenario for subject in run.subjects):
        for note in scenario.body.notes:
            out.print(Text(f"{scenario.name}: {note}", style="yellow"))
    rows = [
        (one.method, one.order, one.largest_error, _verdicts(one)) for one in overviews(summary_cells(run))
    ]
    heads = ("engine:method", "order of orientation", "largest error", "scenarios")
    print_columns(out, heads, rows, right=heads[1:2])
    worst = offenders(run)
    if worst:
        out.print(Text("\nThe worst", style="bold"))
    for one in worst[:_MOST_OFFENDERS]:
        out.print(Text(f"{one.method} in {one.scenario}: {one.text}", style="red"))
        out.print(Text(f"    {one.reproduce}"), soft_wrap=True)
    if len(worst) > _MOST_OFFENDERS:
        out.print(f"and {len(worst) - _MOST_OFFENDERS} more, in the report")


def _verdicts(overview: Overview) -> Text:
    """Return how many scenarios came to each verdict, each in its colour."""
    words = (
        Text(f"{STATES[state].word} {amount}", style=_TINT_STYLES[STATES[state].tint])
        for state, amount in overview.states.items()
    )
    return Text(", ").join(words)
