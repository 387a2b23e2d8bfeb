"""The cheapest settings of a run that meet an error tolerance: measured, never extrapolated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import joined, parted
from bodycheck.reports.measurement.case import ALLOW_CODE, CaseResult, scenario_spec
from bodycheck.reports.measurement.measures import MEASURES, QUANTITIES
from bodycheck.reports.run_files.run_tables import MethodKey
from bodycheck.reports.summary.cases_within import keeping, ladders_of, largest_error

_ADVISED = tuple(name for name in QUANTITIES if MEASURES[name].judged == "limit")


@dataclass(frozen=True)
class Option:
    """The settings with which a method meets the error tolerance, and their cost.

    settings: the step or tolerance on each scenario; None for a method that has neither. error: measured
    error plus the truth's bound, the largest over the scenarios. cpu_s: CPU time of the whole scenarios in s;
    None where it was not measured. reproduce: the command that reproduces it.
    """

    engine: str
    method: str
    control: str
    settings: tuple[float | None, ...]
    error: float
    cpu_s: float | None
    reproduce: str


@dataclass(frozen=True)
class Answer:
    """What meets the error tolerance on one scenario, or on all scenarios together if scenario is None.

    options: the cheapest option of each engine, cheapest first, those without measured time last. without:
    the measured engines of which no method meets the tolerance. nearest: the option with the smallest error
    where none meets the tolerance; None where nothing was measured.
    """

    scenario: str | None
    options: tuple[Option, ...]
    without: tuple[str, ...]
    nearest: Option | None


def check_question(error: float, quantity: str) -> None:
    """Raise InputError for an invalid error tolerance or an unknown quantity."""
    if not 0.0 < error < math.inf:
        raise InputError(f"--error {error!r}: must be a positive number")
    if quantity not in _ADVISED:
        raise InputError(f"--quantity {quantity}: unknown quantity (available: {', '.join(_ADVISED)})")


def advise(
    cases: Iterable[CaseResult], error: float, quantity: str, scenarios: Sequence[str]
) -> tuple[Answer, ...]:
    """Return the answers for all scenarios together, if there are several, and for each one.

    Raises InputError as check_question does.
    """
    check_question(error, quantity)
    ladders = ladders_of(case for case in cases if case.columns["scenario"] in scenarios)
    kept: dict[str, dict[MethodKey, Option]] = {name: {} for name in scenarios}
    best: dict[str, dict[MethodKey, Option]] = {name: {} for name in scenarios}
    for (name, key), ladder in ladders.items():
        options = [_option(case, quantity) for case in keeping(ladder, error, quantity)]
        if options:
            kept[name][key] = min(reversed(options), key=_cost)  # if no cost is known, the coarsest step
        if measured := [
            _option(case, quantity) for case in ladder if largest_error(case, quantity) < math.inf
        ]:
            best[name][key] = min(measured, key=lambda option: option.error)
    engines = tuple(dict.fromkeys(engine for _, (engine, _) in ladders))
    answers = [_answer(name, kept[name], best[name], engines) for name in scenarios]
    if len(scenarios) > 1:
        answers.insert(0, _answer(None, _on_all(kept), _on_all(best), engines))
    return tuple(answers)


def _option(case: CaseResult, quantity: str) -> Option:
    columns: Mapping[str, Any] = case.columns
    return Option(
        engine=columns["engine"],
        method=columns["method"],
        control=columns["control"],
        settings=(case.setting.fineness,),
        error=largest_error(case, quantity),
        cpu_s=columns.get("cpu_s"),
        reproduce=columns["reproduce"],
    )


def _cost(option: Option) -> float:
    return math.inf if option.cpu_s is None else option.cpu_s


def _answer(
    scenario: str | None,
    kept: Mapping[MethodKey, Option],
    best: Mapping[MethodKey, Option],
    engines: Iterable[str],
) -> Answer:
    cheapest: dict[str, Option] = {}
    for option in sorted(kept.values(), key=_cost):
        cheapest.setdefault(option.engine, option)
    nearest = None if cheapest else min(best.values(), key=lambda option: option.error, default=None)
    without = tuple(engine for engine in engines if engine not in cheapest)
    return Answer(scenario, tuple(cheapest.values()), without, nearest)


def _on_all(found: Mapping[str, Mapping[MethodKey, Option]]) -> dict[MethodKey, Option]:
    """Return the methods that have an option on every scenario, with the largest error and the total time."""
    together = {}
    for key in dict.fromkeys(key for options in found.values() for key in options):
        each = [options[key] for options in found.values() if key in options]
        if len(each) < len(found):
            continue
        times = [option.cpu_s for option in each]
        together[key] = Option(
            *key,
            control=each[0].control,
            settings=tuple(option.settings[0] for option in each),
            error=max(option.error for option in each),
            cpu_s=None if None in times else sum(time for time in times if time is not None),
            reproduce=_command(key, [option.reproduce for option in each]),
        )
    return together


def _command(key: MethodKey, each: Sequence[str]) -> str:
    """Merge several commands into one that runs the method on all their scenarios."""
    asked = [name for command in each if (name := scenario_spec(command)) is not None]
    code = [ALLOW_CODE] if any(ALLOW_CODE in parted(command) for command in each) else []
    return joined(["bodycheck", "run", *asked, "--engine", ":".join(key), *code])
