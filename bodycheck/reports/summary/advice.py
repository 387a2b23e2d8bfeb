"""The cheapest settings that meet an error tolerance, and the error of a step: measured, else predicted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number, suggestion
from bodycheck._util.untrusted import shell_join, shell_split
from bodycheck.adapters.engine_names import REFERENCE, with_method
from bodycheck.adapters.registry import requested_name
from bodycheck.reports.measurement.case import ALLOW_CODE, CaseResult, scenario_spec
from bodycheck.reports.measurement.measures import MEASURES, QUANTITIES
from bodycheck.reports.measurement.verdicts import unit_of
from bodycheck.reports.run_files.run_tables import MethodKey
from bodycheck.reports.summary.error_curve import (
    MAX_STEPS,
    NO_BETTER,
    Basis,
    ErrorCurve,
    ErrorEstimate,
    cases_within,
    largest_error,
)
from bodycheck.scenarios.library import as_suite

_ADVISED = tuple(name for name in QUANTITIES if MEASURES[name].judged == "limit")
_SURENESS: tuple[Basis, ...] = ("measured", "predicted", "unsure")

SHORTEST_STEP_S = 1e-5
"""The shortest step in s that is recommended, unless all settings are requested."""

Curves: TypeAlias = Mapping[tuple[str, MethodKey], ErrorCurve]
"""(scenario, method) -> its error against its step."""


@dataclass(frozen=True)
class Option:
    """A method at one setting: its error, where that comes from, its cost, and how to confirm and use it.

    setting: the step in s or the tolerance; None for a method that has neither. error: an upper end: measured
    error plus the truth's bound, or that of the prediction's 95 % interval; the largest over the scenarios.
    basis: measured, predicted, or unsure for the reason `why`. real_time: simulated seconds per CPU second,
    and cpu_s: CPU seconds of the whole scenarios; None where no time was measured. evaluations: right-hand
    sides of the whole scenarios, the cost where no time was measured. rotation_rad: max |omega|
    times the step. limiting: the scenario that requires this setting. duration_s: simulated time, of
    all scenarios together. confirm: the command that measures it; "" where no run can use the step.
    snippet: the statements that select it in a program; "" if the engine declares none. measured_in: the
    folder of another run that measured the error; "" if none did.
    """

    engine: str
    method: str
    control: str
    setting: float | None
    error: float
    basis: Basis
    why: str
    cpu_s: float | None
    real_time: float | None
    evaluations: float | None
    rotation_rad: float | None
    limiting: str
    duration_s: float
    confirm: str
    snippet: str
    measured_in: str = ""

    @property
    def name(self) -> str:
        """The method as `--engine` accepts it."""
        return with_method(self.engine, self.method)

    @property
    def impractical(self) -> str:
        """Why a setting that meets the tolerance is not recommended; "" if it is."""
        if self.control == "dt" and self.setting is not None and self.setting < SHORTEST_STEP_S:
            return f"its step is below {number(SHORTEST_STEP_S)} s"
        if self.real_time is not None and self.real_time < 1.0:
            return f"slower than real time, {number(self.real_time, 2)} x"
        return ""


@dataclass(frozen=True)
class ScenarioAdvice:
    """The options on one scenario, or on all scenarios together if scenario is None.

    options: the best option of each engine, or, for the error of a step, of each method; best first, the
    reference last. left_out: the best one of each engine whose options are all impractical. without: each
    other engine or method with the reason. nearest: the option with the smallest measured error where there
    is no other; None where nothing was measured. searchable: whether a finer step may have a smaller error.
    """

    scenario: str | None
    options: tuple[Option, ...]
    without: tuple[tuple[str, str], ...] = ()
    nearest: Option | None = None
    left_out: tuple[Option, ...] = ()
    searchable: bool = False


@dataclass(frozen=True)
class Advice:
    """The answers to one question: which settings meet `error`, or which error the step `dt_s` has."""

    measure: str
    error: float | None
    dt_s: float | None
    run: str
    answers: tuple[ScenarioAdvice, ...]


def check_question(error: float | None, dt_s: float | None, measure: str) -> None:
    """Raise InputError for an invalid error tolerance or step, or an unknown measure."""
    if (error is None) == (dt_s is None):
        raise InputError("give either --error, the tolerance to meet, or --dt, the step whose error to print")
    for option, value in (("--error", error), ("--dt", dt_s)):
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"{option} {value!r}: must be a positive number")
    if measure not in _ADVISED:
        raise InputError(f"--measure {measure}: unknown measure{suggestion(measure, _ADVISED)}")


def settings_within(
    curves: Curves, error: float, scenarios: Sequence[str], *, predicted: bool = True, every: bool = False
) -> tuple[ScenarioAdvice, ...]:
    """Return the cheapest setting of each engine that meets an error, for all scenarios and for each.

    predicted: whether steps that were not measured count; without them, answers name no nearest setting and
    no other reasons than that. every: whether impractical settings are recommended as well.
    """

    def best(curve: ErrorCurve) -> Option | None:
        return cheapest_within(curve, error, predicted=predicted)

    def why(curve: ErrorCurve) -> str:
        return _why_none(curve, error) if predicted else "no measured setting meets it"

    by_scenario = _by_scenario(curves)
    each = {name: _found(by_scenario.get(name, {}), best, why, nearest=predicted) for name in scenarios}
    finer = {name for (name, _), curve in curves.items() if predicted and curve.finer_step(error) is not None}
    answers = [_cheapest_of_engines(name, *each[name], name in finer, every=every) for name in scenarios]
    if len(scenarios) > 1:
        is_open = all(one.options or one.left_out or one.searchable for one in answers)
        answers.insert(0, _cheapest_of_engines(None, *_over_all(each, curves, error), is_open, every=every))
    return tuple(answers)


def errors_at(curves: Curves, dt_s: float, scenarios: Sequence[str]) -> tuple[ScenarioAdvice, ...]:
    """Return the error of each method at a step, for all scenarios and for each, most accurate first."""

    def at(curve: ErrorCurve) -> Option | None:
        return None if (found := _at(curve, dt_s)) is None else _option(curve, found)

    def why(curve: ErrorCurve) -> str:
        if curve.is_shorter_than(dt_s):
            return f"the scenario lasts {curve.duration_s:g} s"
        if (outcome := curve.failure_at(dt_s)) is not None:
            return f"{outcome} at this step"
        return _why_none(curve, None)

    by_scenario = _by_scenario(curves)
    each = {name: _found(by_scenario.get(name, {}), at, why) for name in scenarios}
    answers = [_by_error(name, *each[name]) for name in scenarios]
    if len(scenarios) > 1:
        answers.insert(0, _by_error(None, *_over_all(each, curves)))
    return tuple(answers)


def cheapest_within(curve: ErrorCurve, error: float, *, predicted: bool) -> Option | None:
    """Return the cheapest setting of a method that meets an error: measured, or coarser and predicted."""
    found = curve.coarsest_within(error) if predicted else None
    if found is not None:
        return _option(curve, found)
    # if no cost is known, the coarsest step
    meeting = list(cases_within(curve.cases, error, curve.quantity))[::-1]
    if meeting and all(case.columns.get("cpu_s") is not None for case in meeting):  # costs need no estimate
        return _measured(curve, min(meeting, key=_measured_cost))
    return min((_measured(curve, case) for case in meeting), key=_cost, default=None)


_Options: TypeAlias = dict[MethodKey, Option]
_Reasons: TypeAlias = dict[MethodKey, str]


def _by_scenario(curves: Curves) -> dict[str, dict[MethodKey, ErrorCurve]]:
    found: dict[str, dict[MethodKey, ErrorCurve]] = {}
    for (name, key), curve in curves.items():
        found.setdefault(name, {})[key] = curve
    return found


def _found(
    curves: Mapping[MethodKey, ErrorCurve],
    option: Callable[[ErrorCurve], Option | None],
    why: Callable[[ErrorCurve], str],
    *,
    nearest: bool = True,
) -> tuple[_Options, _Reasons, _Options]:
    """Return the options of one scenario, the reasons where there is none, and the most accurate settings.

    nearest: whether to find the latter.
    """
    options: _Options = {}
    reasons: _Reasons = {}
    most_accurate: _Options = {}
    for key, curve in curves.items():
        found = option(curve)
        if found is not None:
            options[key] = found
        else:
            reasons[key] = why(curve)
        if nearest and curve.measured:
            most_accurate[key] = _measured(curve, curve.most_accurate)
    return options, reasons, most_accurate


def _at(curve: ErrorCurve, dt_s: float) -> ErrorEstimate | None:
    return curve.at(dt_s) if curve.control == "dt" else None


def _measured(curve: ErrorCurve, case: CaseResult) -> Option:
    found = ErrorEstimate(case.setting.fineness, largest_error(case, curve.quantity), "measured")
    return _option(curve, found, case if case.columns.get("cpu_s") is not None else None)


def _option(curve: ErrorCurve, found: ErrorEstimate, timed: CaseResult | None = None) -> Option:
    """Return the option of an estimate; its cost is that of the nearest timed step, in proportion.

    timed: the case of this setting, if its CPU time was measured.
    """
    timed_case = timed or _nearest_timed(curve, found.setting)
    columns, setting, cpu_s = timed_case.columns, found.setting, timed_case.columns.get("cpu_s")
    dt_s = setting if curve.control == "dt" else None
    evaluations = columns.get("rhs_evaluations")
    if dt_s is not None and timed_case.dt_s is not None:
        cpu_s = _times(cpu_s, timed_case.dt_s / dt_s)
        evaluations = _times(evaluations, timed_case.dt_s / dt_s)
    omega = columns.get("omega_scale_rad_s")
    return Option(
        engine=columns["engine"],
        method=columns["method"],
        control=curve.control,
        setting=setting,
        error=found.error,
        basis=found.basis,
        why=found.why,
        cpu_s=cpu_s,
        real_time=None if not cpu_s else curve.duration_s / cpu_s,
        evaluations=evaluations,
        rotation_rad=None if dt_s is None or omega is None else omega * dt_s,
        limiting=columns["scenario"],
        duration_s=curve.duration_s,
        confirm=_with_step(columns["reproduce"], dt_s)
        if dt_s is None or curve.divides_interval(dt_s)
        else "",
        snippet="" if dt_s is None else curve.snippet.replace("{dt_s}", repr(dt_s)),
    )


def _nearest_timed(curve: ErrorCurve, setting: float | None) -> CaseResult:
    """Return the case with the nearest setting; one whose CPU time was measured takes precedence."""

    def distance(case: CaseResult) -> tuple[bool, float]:
        own = case.setting.fineness
        distance_decades = abs(math.log(own / setting)) if own is not None and setting is not None else 0.0
        # the cost of a tolerance does not follow from that of another
        exact = distance_decades > 0.0 and curve.control != "dt"
        return case.columns.get("cpu_s") is None or exact, distance_decades

    return min(curve.measured, key=distance)


@lru_cache
def _with_step(command: str, dt_s: float | None) -> str:
    """Return the command of a case with another step."""
    arguments = shell_split(command)
    if dt_s is not None and "--dt" in arguments:
        arguments[arguments.index("--dt") + 1] = repr(dt_s)
    return shell_join(arguments)


def _measured_cost(case: CaseResult) -> tuple[float, float]:
    evaluations = case.columns.get("rhs_evaluations")
    return case.columns["cpu_s"], math.inf if evaluations is None else evaluations


def _cost(option: Option) -> tuple[float, float]:
    cpu_s, evaluations = option.cpu_s, option.evaluations
    return math.inf if cpu_s is None else cpu_s, math.inf if evaluations is None else evaluations


def _why_none(curve: ErrorCurve, error: float | None) -> str:
    """Return why a method has no setting that meets an error, or no known error at a step."""
    if not curve.measured:
        ended = next((case.columns["outcome"] for case in curve.cases if not case.ok), "failed")
        return f"{ended} at every measured setting"
    if curve.control != "dt":
        return "no measured setting meets it" if error is not None else "has no step"
    if curve.verdict in NO_BETTER:
        return f"{curve.verdict}: finer steps do not reduce the error reliably"
    if error is not None and error < curve.least_predicted:
        floor = f"{curve.floor:.2g}{unit_of(curve.quantity)}"
        return f"near the floor of round-off and of the truth, {floor}"
    if not curve.is_predictable:
        return "the errors at the measured steps follow no order, so that none is predicted"
    return f"needs more than {number(MAX_STEPS)} steps"


def _cheapest_of_engines(
    scenario: str | None,
    options: _Options,
    reasons: _Reasons,
    nearest: _Options,
    searchable: bool,
    *,
    every: bool,
) -> ScenarioAdvice:
    """Return the cheapest option of each engine: a practical one, then a sure one, takes precedence."""

    def rank(one: Option) -> tuple[bool, bool, bool, tuple[float, float]]:
        return bool(one.impractical) and not every, one.engine == REFERENCE, one.basis == "unsure", _cost(one)

    best: dict[str, Option] = {}
    for option in sorted(options.values(), key=rank):
        best.setdefault(option.engine, option)
    ranked = sorted(best.values(), key=rank)
    shown = tuple(one for one in ranked if every or not one.impractical)
    without: dict[str, str] = {}
    for key in sorted(
        reasons, key=lambda key: key not in nearest
    ):  # first why measured methods do not meet it
        if key[0] not in best:
            without.setdefault(key[0], reasons[key])
    closest = None if best else min(nearest.values(), key=lambda one: one.error, default=None)
    return ScenarioAdvice(
        scenario, shown, tuple(without.items()), closest, tuple(ranked[len(shown) :]), searchable
    )


def _by_error(scenario: str | None, options: _Options, reasons: _Reasons, _: _Options) -> ScenarioAdvice:
    options_shown = tuple(sorted(options.values(), key=lambda one: (one.engine == REFERENCE, one.error)))
    return ScenarioAdvice(
        scenario, options_shown, tuple((with_method(*key), why) for key, why in reasons.items())
    )


def _over_all(
    each: Mapping[str, tuple[_Options, _Reasons, _Options]], curves: Curves, error: float | None = None
) -> tuple[_Options, _Reasons, _Options]:
    """Return the options that hold on every scenario at once, and for all others why there is none.

    error: the tolerance that they must meet, if any.
    """
    options = _on_every_scenario([found[0] for found in each.values()], curves, error)
    nearest = _on_every_scenario([found[2] for found in each.values()], curves)
    keys = dict.fromkeys(key for found in each.values() for key in (*found[0], *found[1]))
    reasons = {
        key: next(
            (
                f"{name}: {found[1].get(key, 'not measured')}"
                for name, found in each.items()
                if key not in found[0]
            ),
            "what one scenario requires does not meet it on another",
        )
        for key in keys
        if key not in options
    }
    return options, reasons, nearest


def _on_every_scenario(found: Sequence[_Options], curves: Curves, error: float | None = None) -> _Options:
    """Return the methods that have an option on every scenario, at the finest of their settings.

    error: a tolerance that all scenarios must meet there, if any. Finer is not always better: round-off may
    grow, and a load may switch inside a finer step.
    """
    joint = {}
    for key in dict.fromkeys(key for options in found for key in options):
        each = [options[key] for options in found if key in options]
        if len(each) < len(found):
            continue
        limiting = min(each, key=lambda one: (math.inf if one.setting is None else one.setting, -one.error))
        there = {one.limiting: _estimate_at(limiting.setting, one, curves[one.limiting, key]) for one in each}
        known = {name: estimate for name, estimate in there.items() if estimate is not None}
        if error is None or (len(known) == len(each) and max(e.error for e in known.values()) <= error):
            joint[key] = _joint(key, each, limiting, known, curves)
    return joint


def _estimate_at(setting: float | None, option: Option, curve: ErrorCurve) -> ErrorEstimate | None:
    """Return the error of an option's method on its scenario at another setting; None where it is unknown."""
    if setting is None or option.setting == setting:
        return ErrorEstimate(option.setting, option.error, option.basis, option.why)
    found = curve.at(setting)
    is_finer = option.setting is not None and setting < option.setting and curve.control == "dt"
    if found is None and is_finer and curve.failure_at(setting) is None:
        return ErrorEstimate(setting, option.error, "unsure", "finer than the measured steps that meet it")
    return found


def _joint(
    key: MethodKey,
    each: Sequence[Option],
    limiting: Option,
    errors: Mapping[str, ErrorEstimate],
    curves: Curves,
) -> Option:
    """Return one option for all scenarios: the setting of the limiting one, and the total cost at this.

    errors: at this setting, on the scenarios on which they are known.
    """
    cpu_s = _total(_times(one.cpu_s, _ratio(one, limiting)) for one in each)
    simulated = sum(curves[one.limiting, key].duration_s for one in each)
    commands = [one.confirm for one in each]
    fits = all(curves[one.limiting, key].divides_interval(limiting.setting) for one in each)
    return Option(
        *key,
        control=limiting.control,
        setting=limiting.setting,
        error=max(one.error for one in errors.values()),
        basis=max((one.basis for one in errors.values()), key=_SURENESS.index),
        why=_reasons({scenario: one.why for scenario, one in errors.items() if one.why}),
        cpu_s=cpu_s,
        real_time=None if not cpu_s else simulated / cpu_s,
        evaluations=_total(_times(one.evaluations, _ratio(one, limiting)) for one in each),
        rotation_rad=limiting.rotation_rad,
        limiting=limiting.limiting,
        duration_s=simulated,
        confirm=_command(key, commands, limiting.setting if fits else None) if all(commands) else "",
        snippet=limiting.snippet,
    )


def _reasons(why: Mapping[str, str]) -> str:
    """Return the reasons by scenario, each once."""
    found: dict[str, list[str]] = {}
    for scenario, reason in why.items():
        found.setdefault(reason, []).append(scenario)
    return "; ".join(
        f"{reason} ({some[0] if len(some) == 1 else f'{len(some)} scenarios'})"
        for reason, some in found.items()
    )


def _ratio(one: Option, limiting: Option) -> float:
    """Return how many times as many steps an option takes at the setting of the limiting one."""
    if one.control != "dt" or one.setting is None or limiting.setting is None:
        return 1.0
    return one.setting / limiting.setting


def _times(cost: float | None, factor: float) -> float | None:
    return None if cost is None else cost * factor


def _total(times: Iterable[float | None]) -> float | None:
    known = list(times)
    return None if None in known else math.fsum(time for time in known if time is not None)


def _command(key: MethodKey, each: Sequence[str], dt_s: float | None) -> str:
    """Merge several commands into one that runs the method on all their scenarios."""
    specs = [name for command in each if (name := scenario_spec(command)) is not None]
    code = [ALLOW_CODE] if any(ALLOW_CODE in shell_split(command) for command in each) else []
    step = [] if dt_s is None else ["--dt", repr(dt_s)]
    engine, method = key
    name = with_method(requested_name(engine), method)
    return shell_join(["bodycheck", "run", *as_suite(specs), "--engine", name, *step, *code])


def to_measure(
    curves: Curves, advice: Sequence[ScenarioAdvice], error: float
) -> dict[tuple[str, MethodKey], float]:
    """Return the steps that would turn the answers into measured ones.

    These are the predicted and unsure settings on single scenarios, and, of an engine that has none, a finer
    step of each of its methods whose errors may still fall; then those on all scenarios together.
    """
    steps: dict[tuple[str, MethodKey], float] = {}
    names = [answer.scenario for answer in advice if answer.scenario is not None]
    for answer in advice:
        if answer.scenario is None:
            continue
        for option in answer.options:
            if option.basis != "measured" and option.setting is not None:
                steps[answer.scenario, (option.engine, option.method)] = option.setting
        missing = {engine for engine, _ in answer.without}
        for (name, key), curve in curves.items():
            if (
                name == answer.scenario
                and key[0] in missing
                and (finer := curve.finer_step(error)) is not None
            ):
                steps[name, key] = finer
    for option in (one for answer in advice if answer.scenario is None for one in answer.options):
        key = option.engine, option.method
        for name in names:
            curve = curves[name, key]
            if option.setting is not None and curve.divides_interval(option.setting):
                found = curve.at(option.setting)
                is_measured = found is not None and found.basis == "measured"
                if not is_measured and curve.failure_at(option.setting) is None:
                    steps.setdefault((name, key), option.setting)
    return steps
