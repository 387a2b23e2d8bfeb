"""The cheapest settings that keep an error, among the cases of a run: measured, never extrapolated."""

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
    """What a method needs to keep the error, and what that costs.

    settings: the step or tolerance on each scenario, None of a method that has neither. error: the measured
    one and the truth's bound; of several scenarios the largest. cpu_s: processor time of the whole scenarios
    in s, None where it was not measured. reproduce: the command that shows it again.
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
    """What keeps the error on a scenario; where that is None, on all of them.

    options: the cheapest of each engine, the cheapest first; those whose time was not measured at the end.
    without: the engines that were measured and keep it by no method. nearest: what comes closest where
    nothing keeps it, None where nothing was measured at all.
    """

    scenario: str | None
    options: tuple[Option, ...]
    without: tuple[str, ...]
    nearest: Option | None


def check_question(error: float, quantity: str) -> None:
    """Raise InputError where there is no such question."""
    if not 0.0 < error < math.inf:
        raise InputError(f"--error {error!r}: must be a positive number")
    if quantity not in _ADVISED:
        raise InputError(f"--quantity {quantity}: is none that can be kept; there are {', '.join(_ADVISED)}")


def advise(
    cases: Iterable[CaseResult], error: float, quantity: str, scenarios: Sequence[str]
) -> tuple[Answer, ...]:
    """Return the answer for all the scenarios together, if they are several, and for each.

    Raises InputError as check_question does.
    """
    check_question(error, quantity)
    ladders = ladders_of(case for case in cases if case.columns["scenario"] in scenarios)
    kept: dict[str, dict[MethodKey, Option]] = {name: {} for name in scenarios}
    best: dict[str, dict[MethodKey, Option]] = {name: {} for name in scenarios}
    for (name, key), ladder in ladders.items():
        options = [_option(case, quantity) for case in keeping(ladder, error, quantity)]
        if options:
            kept[name][key] = min(reversed(options), key=_cost)  # of unknown costs the coarsest step
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
    """Return the methods that are found everywhere, with the largest error and the sum of the times."""
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
    """Return the one command that runs a method on the scenarios of several commands."""
    asked = [name for command in each if (name := scenario_spec(command)) is not None]
    code = [ALLOW_CODE] if any(ALLOW_CODE in parted(command) for command in each) else []
    return joined(["bodycheck", "run", *asked, "--engine", ":".join(key), *code])
