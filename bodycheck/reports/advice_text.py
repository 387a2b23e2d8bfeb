"""Advice on the terminal, or in a pipe."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.text import Text

from bodycheck.reports.advice import Answer, Option
from bodycheck.reports.console import console, print_columns
from bodycheck.reports.wording import names, number, step


def print_advice(answers: Sequence[Answer], error: float, quantity: str, where: str) -> None:
    """Print what keeps the error, the cheapest of each engine; where nothing does, what comes nearest."""
    out = console()
    out.print(Text(f"{quantity} of {number(error)} or less, by what was measured in {where}"))
    for answer in answers:
        out.print(Text(f"\n{_name(answer, len(answers) - 1)}", style="bold"))
        if answer.options:
            rows = [_row(option) for option in answer.options]
            heads = ("engine:method", "setting", "error at most", "cpu_s", "to see it again")
            print_columns(out, heads, rows, right=heads[2:4])
            if answer.without:
                out.print(
                    Text(f"no setting that was measured keeps it in {names(answer.without)}", style="yellow")
                )
        else:
            for line in _nothing(answer):
                out.print(Text(line, style="yellow"))


def _name(answer: Answer, scenarios: int) -> str:
    return f"all {scenarios} scenarios" if answer.scenario is None else answer.scenario


def _row(option: Option) -> tuple[str, ...]:
    time = "not measured" if option.cpu_s is None else number(option.cpu_s, 3)
    method = f"{option.engine}:{option.method}"
    return method, _setting_text(option), number(option.error, 3), time, option.reproduce


def _setting_text(option: Option) -> str:
    """Return the step or tolerance, from the finest to the coarsest where scenarios need different ones."""
    known = sorted({setting for setting in option.settings if setting is not None})
    if not known:
        return "no steps"
    word, unit = ("dt ", " s") if option.control == "dt" else ("tolerance ", "")
    return f"{word}{' to '.join(step(value) for value in dict.fromkeys((known[0], known[-1])))}{unit}"


def _nothing(answer: Answer) -> Iterator[str]:
    one = answer.nearest
    if one is None:
        yield "nothing was measured" if answer.scenario else "no method was measured on all of them"
        return
    yield (
        f"nothing that was measured keeps it; nearest is {one.engine}:{one.method}, {_setting_text(one)}: "
        f"{number(one.error, 3)}"
    )
    yield f"    {one.reproduce}"
