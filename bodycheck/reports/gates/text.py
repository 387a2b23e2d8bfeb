"""The gates on the terminal: one line each, then a table of what failed with the commands that show it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.text import Text

from bodycheck.reports.console import console, print_columns
from bodycheck.reports.gates.proposal import Change
from bodycheck.reports.gates.verdict import Check, GateResult, distance
from bodycheck.reports.wording import count, number

_HEADS = ("gate", "scenario", "method", "at", "obtained", "bound", "distance", "command")
_STYLES = {"passed": "green", "failed": "red", "nothing": "red"}


def line_of(result: GateResult) -> str:
    """Return what became of a gate, without its status: its title, and the worst of its rows."""
    cases = count(len(result.checks), "case")
    if result.status == "nothing":
        return f"{result.gate.title}: measured nothing: {result.why}"
    if result.status == "failed":
        return f"{result.gate.title}: {len(result.failed)} of {cases} failed; {_worst(result)}"
    return f"{result.gate.title}: {cases}; {_worst(result)}"


def _worst(result: GateResult) -> str:
    worst = result.worst
    assert worst is not None
    away = distance(worst, result.gate)
    return f"worst {obtained(worst)}" + (f", {away}" if away else "")


def obtained(check: Check) -> str:
    """Return a value in words, or why there is none."""
    value = check.row.obtained
    if value is None:
        return check.row.why
    if not isinstance(value, str):
        return number(value)
    return f"{value}: {check.row.about}" if check.row.about else value


def failure_rows(results: Sequence[GateResult]) -> list[tuple[str, ...]]:
    """Return the cells of every row that failed: gate, who, where, obtained, bound, distance, command."""
    return [
        (
            str(place),
            check.row.scenario,
            f"{check.row.engine}:{check.row.method}",
            check.row.at,
            obtained(check),
            f"{result.gate.measure} {result.gate.bound}",
            distance(check, result.gate),
            check.row.reproduce,
        )
        for place, result in enumerate(results)
        for check in result.failed
    ]


def print_results(results: Sequence[GateResult]) -> None:
    """Print one line a gate, the table of what failed, and the count."""
    out = console()
    for place, result in enumerate(results):
        status = Text(f"{result.status:7}", style=_STYLES[result.status])
        out.print(status.append(f"  [{place}] {line_of(result)}", style="default"), soft_wrap=True)
    rows = failure_rows(results)
    if rows:
        out.print()
        print_columns(out, _HEADS, rows)
        out.print()
    for place, result in enumerate(results):
        if result.status != "passed":
            out.print(Text(f"[{place}] {result.gate.reason}"), soft_wrap=True)
    ended = Counter[str](result.status for result in results)
    words = {"passed": "passed", "failed": "failed", "nothing": "measured nothing"}
    told = ", ".join(f"{ended[status]} {word}" for status, word in words.items() if ended[status])
    out.print(f"{count(len(results), 'gate')}: {told}")


def print_changes(changes: Sequence[Change], results: Sequence[GateResult], margin: float) -> None:
    """Print the bounds that were replaced, each with what was measured and the margin to it."""
    out = console()
    for change in changes:
        gate = results[change.place].gate
        out.print(
            f"[{change.place}] {gate.scenario} {gate.engine}:{gate.method} {gate.measure}: {change.key} "
            f"{number(change.old)} -> {number(change.new)}; measured {number(change.measured)}"
            + ("" if change.key == "near" else f", margin {number(margin)} decades")
            + ("; loosened" if change.loosens else ""),
            soft_wrap=True,
            markup=False,
        )
    loosened = {change.place for change in changes if change.loosens}
    kept = sum(result.status != "passed" and place not in loosened for place, result in enumerate(results))
    if kept:
        out.print(f"{count(kept, 'gate')} that did not pass left as they are: loosen with --loosen REASON")
    out.print(f"{count(len(changes), 'bound')} replaced")
