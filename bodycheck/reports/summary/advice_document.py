"""The answers of `advise` as a document: settings with their errors, how to confirm them, what to paste."""

from __future__ import annotations

from collections.abc import Iterator

from bodycheck._util.formatting import names, number, setting, step
from bodycheck.reports.document import Column, Command, Document, Part, Sentence, Table
from bodycheck.reports.summary.advice import Advice, Option, ScenarioAdvice

_MAX_COMMANDS = 4
_COLUMNS = (
    Column("engine:method", "name"),
    Column("setting", "fixed"),
    Column("error <=", "number"),
    Column("basis", "fixed"),
    Column("real time", "number"),
    Column("|omega| dt", "number"),
)


def advice_document(advice: Advice) -> Document:
    """Return the best options of each answer, how to confirm them, and the line that selects the first one.

    Of a step's errors on several scenarios, only those on all of them together are included.
    """
    joint = advice.answers[0].scenario is None
    answers = advice.answers[:1] if joint and advice.error is None else advice.answers
    parts = [part for answer in answers for part in _answer_parts(answer, len(advice.answers) - 1)]
    if len(answers) < len(advice.answers):
        parts.append(Sentence("name a scenario to see its errors alone"))
    question = Sentence(f"{_question(advice)}, from the run {advice.run}")
    return Document("bodycheck: advice", (question, *parts))


def _question(advice: Advice) -> str:
    if advice.error is None:
        return f"{advice.measure} at dt {step(advice.dt_s)} s"
    return f"{advice.measure} <= {number(advice.error)}"


def _answer_parts(answer: ScenarioAdvice, scenarios: int) -> Iterator[Part]:
    """Yield a table of the options, what is unsure or missing, commands, and the line to paste."""
    name = f"all {scenarios} scenarios" if answer.scenario is None else answer.scenario
    if answer.options:
        if answer.scenario is not None:
            name += f", {number(answer.options[0].duration_s)} s"
        yield Table(_COLUMNS, tuple(map(_row, answer.options)), name)
    else:
        yield Sentence(name, strong=True)
    if answer.scenario is None:
        for scenario in dict.fromkeys(option.limiting for option in answer.options):
            limited = [option.name for option in answer.options if option.limiting == scenario]
            yield Sentence(f"limited by {scenario}: {names(limited)}")
    for option in answer.options:
        if option.why:
            yield Sentence(f"{option.name}: unsure, {option.why}", "open")
    for engine, why in answer.without:
        yield Sentence(f"{engine}: {why}", "open")
    if not answer.options:
        yield from _nothing(answer)
    if any(not option.confirm for option in answer.options):
        yield Sentence(
            "no run can confirm this step, because it does not divide the sampling interval", "open"
        )
    for option in answer.options[:_MAX_COMMANDS]:
        if option.confirm:
            yield Command(option.confirm, "measured by" if option.basis == "measured" else "confirm with")
    pasted = next((option for option in answer.options if option.snippet), None)
    if pasted is not None:
        yield Command(pasted.snippet, f"use {pasted.name}")


def _row(option: Option) -> tuple[str, ...]:
    speed = "" if option.real_time is None else f"{number(option.real_time, 3)} x"
    chosen = setting(option.control, option.setting)
    error, turn = number(option.error, 3), number(option.rotation_rad, 3)
    return option.name, chosen, error, option.basis, speed, turn


def _nothing(answer: ScenarioAdvice) -> Iterator[Part]:
    one = answer.nearest
    if one is None:
        if not answer.without:
            yield Sentence("nothing was measured", "open")
        return
    nearest = f"{one.name}, {setting(one.control, one.setting)}: {number(one.error, 3)}"
    yield Sentence(
        f"no setting is known to meet it; the nearest is {nearest}; --search measures finer steps", "open"
    )
    yield Command(one.confirm)
