"""The answers of `advise` as a document: what to use, its error, how to confirm it, what to paste."""

from __future__ import annotations

from collections.abc import Iterator

from bodycheck._util.formatting import brief, names, number, setting, step
from bodycheck.adapters.engine_names import REFERENCE
from bodycheck.reports.document import Command, Document, Part, Sentence, Table
from bodycheck.reports.measurement.verdicts import unit_of
from bodycheck.reports.summary.advice import Advice, Option, ScenarioAdvice
from bodycheck.reports.table_layout import Column

_COLUMNS = (
    Column("engine:method", "name"),
    Column("setting", "fixed"),
    Column("error <=", "number"),
    Column("basis", "fixed"),
    Column("real time", "number"),
    Column("|omega| dt", "number"),
)


def advice_document(advice: Advice) -> Document:
    """Return what to use, the best options, how to confirm the first one, and the line that selects it.

    Of several scenarios, only the answer for all of them together has these; each alone has one row.
    """
    answer, *each = advice.answers
    parts = [*_answer_parts(advice, answer, len(each))]
    if each:
        rows = tuple((one.scenario or "", *_best_row(one)) for one in each)
        columns = (Column("scenario", "name"), *_COLUMNS[:4])
        parts.append(Table(columns, rows, "Each scenario alone; name one to see its engines"))
    return Document("bodycheck: advice", tuple(parts))


def _answer_parts(advice: Advice, answer: ScenarioAdvice, scenarios: int) -> Iterator[Part]:
    """Yield the sentence that answers, the question, a table of the options, commands, the line to paste."""
    best = next(iter((*answer.options, *answer.left_out[:1])), answer.nearest)
    over = f"on all {scenarios} scenarios" if answer.scenario is None else f"in {answer.scenario}"
    if best is not None:
        yield Sentence(_conclusion(advice, answer, best), strong=True)
        if answer.scenario is not None:
            over += f", {number(best.duration_s)} s"
    else:
        yield Sentence("nothing was measured" if not answer.without else "no error is known", "open")
    confirmed_by = f", confirmed by {best.measured_in}" if best is not None and best.measured_in else ""
    yield Sentence(f"{_question(advice)} {over}, from the run {advice.run}{confirmed_by}")
    if answer.options:
        has_own = any(option.engine == REFERENCE for option in answer.options)
        about = "; last the reference, the integrator of bodycheck itself" * has_own
        yield Table(_COLUMNS, tuple(map(_row, answer.options)), f"Settings{about}")
    for option in answer.options[:1]:
        if option.why:
            yield Sentence(f"unsure: {option.why}", "open")
        if answer.scenario is None:
            yield Sentence(f"limited by {option.limiting}")
    if answer.options and answer.left_out:
        yield Sentence(f"left out, --all shows them: {'; '.join(map(_left_out, answer.left_out))}", "open")
    without: dict[str, list[str]] = {}
    for engine, why in answer.without:
        without.setdefault(why, []).append(engine)
    for why, engines in without.items():
        yield Sentence(f"{names(engines)}: {why}", "open")
    if best is not None:
        yield from _commands(answer, best)


def _conclusion(advice: Advice, answer: ScenarioAdvice, best: Option) -> str:
    """Return the answer in one sentence."""
    error = f"error at most {brief(best.error)}{unit_of(advice.measure)}"
    basis = "" if best.basis == "measured" else f" ({best.basis})"
    if advice.error is None:
        engine = "" if best.engine == REFERENCE else " engine"  # the reference is listed last
        return f"most accurate{engine} with dt = {step(advice.dt_s)} s: {best.name}, {error}{basis}"
    tolerance = f"{brief(advice.error)}{unit_of(advice.measure)}"
    if best is answer.nearest:
        if answer.searchable:
            return f"no setting is known to meet {tolerance}; the nearest is {_named(best)}: {error}"
        return (
            f"no setting meets {tolerance}; the smallest {error.replace('at most', 'is')}, of {_named(best)}"
        )
    if not answer.options:
        return f"nothing practical meets {tolerance}; the nearest is {_named(best)}, but {best.impractical}"
    if best.basis == "measured":
        return f"confirmed: {brief(best.error)} <= {tolerance}; use {_named(best)}"
    return f"use {_named(best)}: {error}{basis}"


def _question(advice: Advice) -> str:
    if advice.error is None:
        return f"{advice.measure} at dt {step(advice.dt_s)} s"
    return f"{advice.measure} <= {brief(advice.error)}"


def _named(option: Option) -> str:
    """Return "mujoco:rk4 with dt = 0.01 s"."""
    if option.setting is None:
        return option.name
    unit = " s" if option.control == "dt" else ""
    return f"{option.name} with {option.control} = {step(option.setting)}{unit}"


def _left_out(option: Option) -> str:
    return f"{_named(option)}, {option.impractical}"


def _row(option: Option) -> tuple[str, ...]:
    speed = "" if option.real_time is None else f"{number(option.real_time, 3)} x"
    chosen = setting(option.control, option.setting)
    error, turn = brief(option.error), number(option.rotation_rad, 3)
    return option.name, chosen, error, option.basis, speed, turn


def _best_row(answer: ScenarioAdvice) -> tuple[str, ...]:
    """Return the first columns of the best option of a scenario, or else of the nearest one."""
    if answer.options:
        return _row(answer.options[0])[:4]
    nearest = next(iter(answer.left_out), answer.nearest)
    if nearest is None:
        return "nothing was measured", "", "", ""
    return *_row(nearest)[:3], "left out" if answer.left_out else "does not meet it"


def _commands(answer: ScenarioAdvice, best: Option) -> Iterator[Part]:
    """Yield the command that measures a setting, and the line that selects it in a program."""
    if best is answer.nearest and answer.searchable:
        yield Sentence("--search measures finer steps", "open")
    if best.confirm:
        yield Command(best.confirm, "measured by" if best.basis == "measured" else "confirm with")
    else:
        yield Sentence(
            "no run can confirm this step, because it does not divide the sampling interval", "open"
        )
    pasted = next((option for option in answer.options if option.snippet), None)
    if pasted is not None:
        yield Command(pasted.snippet, f"use {pasted.name}")
