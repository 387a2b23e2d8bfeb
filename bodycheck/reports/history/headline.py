"""The first line of a nightly run."""

from __future__ import annotations

from bodycheck._util.formatting import count
from bodycheck.reports.comparison.headlines import lines_of
from bodycheck.reports.history.baseline import Baseline
from bodycheck.reports.history.open_regressions import open_lines
from bodycheck.reports.history.regression import Judgement

_MAX_NAMED = 3


def _why_no_baseline(baseline: Baseline) -> str:
    if baseline.runs:
        return "Insufficient history, no earlier nightly run has one of these cases"
    if baseline.other:
        return "Insufficient history, the earlier nightly runs were made on other machines"
    return "Insufficient history, no earlier run is readable" if baseline.left_out else "First nightly run"


def headline(judged: Judgement) -> str:
    """Return what is worse and why, since when if it was before, or that nothing is, in one line."""
    lines = open_lines(judged.open)
    if judged.status == "nothing measured":
        messages = (case.columns.get("message") for case in judged.newest.cases)
        why = next((f"; {message}" for message in messages if message), "")
        return f"Nothing was measured: no case has outcome ok{why}."
    if lines:
        first, *others = lines
        still = "" if first.newly else f"Still worse since {first.duration}: "
        return still + first.text + (f"; {count(len(others), 'more regression')}" if others else "")
    if judged.status == "insufficient history":
        cases = count(sum(case.ok for case in judged.newest.cases), "case")
        why = _why_no_baseline(judged.baseline)
        return f"{why}: nothing to compare with yet, {cases} stored for the next run."
    better = [] if judged.comparison is None else lines_of(judged.comparison)
    improved = [one.subject for one in better if one.direction == "improved"]
    recovered = list(dict.fromkeys(one.line.subject for one in open_lines(judged.state.recovered)))
    parts = ["No regression"]
    if recovered:
        parts.append(f"{_named(recovered)} back at {'its' if len(recovered) == 1 else 'their'} level")
    if improved:
        parts.append(f"{_named(improved)} improved")
    return f"{'; '.join(parts)}."


def _named(methods: list[str]) -> str:
    return ", ".join(methods) if len(methods) <= _MAX_NAMED else count(len(methods), "method")


def title(judged: Judgement) -> str:
    """Return the first effect on the method that is worst, for a heading; else the headline."""
    lines = open_lines(judged.open)
    return lines[0].line.title if lines and judged.status == "regression" else headline(judged)
