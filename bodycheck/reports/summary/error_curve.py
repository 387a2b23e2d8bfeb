"""The error of one method against its step: measured, or predicted between and beyond the measured steps.

A case or a step meets an error tolerance if its error, including the truth's bound, does. Coarse steps that
meet the tolerance by accident are excluded.

A prediction follows from the order and the constant of the steps that settle the order
(`order.predicted_error`). It is unsure where these do not determine it: without a settled order, above the
largest stable step, near the floor, and where its interval is wide.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

from bodycheck._util.formatting import step
from bodycheck.reports.measurement.case import SWITCH_NOTE, CaseResult
from bodycheck.reports.measurement.convergence import ABOVE_FLOOR, LARGEST_ERROR, LARGEST_ROUND_OFF
from bodycheck.reports.measurement.measure_bounds import bound_of
from bodycheck.reports.measurement.order import Order, predicted_error, settled_order
from bodycheck.reports.run_files.run_tables import MethodKey, Tables, cases_by_method, key_of

RefinementSequence: TypeAlias = Sequence[CaseResult]
"""The cases of one method on one scenario, finest first."""


def sequences_of(cases: Iterable[CaseResult]) -> Mapping[tuple[str, MethodKey], RefinementSequence]:
    """Return the cases of each method on each scenario, finest first."""
    return {
        (scenario, key): finest_first(own)
        for scenario, methods in cases_by_method(cases).items()
        for key, own in methods.items()
    }


def finest_first(cases: Iterable[CaseResult]) -> RefinementSequence:
    """Return the cases of one method on one scenario, finest first."""
    return sorted(cases, key=lambda case: case.setting.fineness or 0.0)


def largest_error(case: CaseResult, quantity: str) -> float:
    """measured + bound: an upper bound of the true error; infinite where the case did not end well."""
    return case.largest_errors.get(quantity, math.inf)


def cases_within(sequence: RefinementSequence, error: float, quantity: str) -> Iterator[CaseResult]:
    """Yield the cases that meet the error tolerance, finest first, up to the first one that does not.

    A coarser step that meets the tolerance after that does so by accident. A failure with an error below 1e-9
    does not count, because round-off can make finer steps worse there; in single precision it can make all
    steps worse that are finer than the best one, which are left out.
    """
    for case in without_round_off(sequence, quantity):
        largest = largest_error(case, quantity)
        if largest <= error:
            yield case
        elif largest > LARGEST_ROUND_OFF:
            return


def cheapest(sequences: Iterable[RefinementSequence], error: float, quantity: str) -> CaseResult | None:
    """Return the timed case of any method that meets an error tolerance with the least processor time."""
    meeting = (case for sequence in sequences for case in cases_within(sequence, error, quantity))
    timed = (case for case in meeting if "cpu_s" in case.columns)
    return min(timed, key=lambda case: case.columns["cpu_s"], default=None)


def without_round_off(sequence: RefinementSequence, quantity: str) -> RefinementSequence:
    """Return the cases of a method, finest first, without those that single precision makes worse."""
    if not sequence or sequence[0].columns.get("precision", "float64") == "float64":
        return sequence
    errors = [largest_error(case, quantity) for case in sequence]
    best = min(range(len(sequence)), key=lambda i: (errors[i], -i))
    return sequence[best:]


Basis: TypeAlias = Literal["measured", "predicted", "unsure"]

MAX_STEPS = 10**9
"""The most steps of a setting that is recommended."""

NO_BETTER = ("does-not-converge", "error-grows")
"""The verdicts with which no error is predicted."""

_MIN_POINTS = 3  # from which a guess is possible
_WIDEST = 1.5  # ratio of the upper end of the interval to the error, above which a prediction is unsure
_FINER = 8  # steps tried below the coarsest one that meets an error, where that is unsure
_LARGEST_LOG = 700.0  # exp of it is finite
_LARGEST_ORDER = 1000.0
_REFINED = 2.0  # ratio of the finest measured step to the next one of a search
_SAME = 1e-9  # relative difference of two steps that count as equal


@dataclass(frozen=True)
class ErrorEstimate:
    """The error of a method at a setting: its upper end, where it comes from, and why it is unsure.

    setting: the step in s or the tolerance; None for a method that has neither. error: measured error plus
    the truth's bound, or the upper end of the 95 % interval of the prediction.
    """

    setting: float | None
    error: float
    basis: Basis
    why: str = ""


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """The cases of one method on one scenario, finest first, and what limits predictions from them.

    duration_s: of the scenario. interval_s: the sampling interval, a multiple of a step. verdict, floor: of
    the quantity, as in methods.csv; None and 0 where it has no row. order: in theory, if known. stable_s: the
    largest stable step, if known. switches_s: the times at which loads switch. snippet: the statements with
    which a program selects the method; {dt_s} stands for the step.
    """

    cases: RefinementSequence
    quantity: str
    duration_s: float
    interval_s: float
    verdict: str | None = None
    floor: float = 0.0
    order: int | None = None
    stable_s: float | None = None
    switches_s: tuple[float, ...] = ()
    snippet: str = ""

    @property
    def control(self) -> str:
        """What controls the method: dt, tolerance or none."""
        return str(self.cases[0].columns["control"])

    @cached_property
    def measured(self) -> tuple[CaseResult, ...]:
        """The cases that ended well and have the quantity, finest first."""
        return tuple(case for case in self.cases if largest_error(case, self.quantity) < math.inf)

    @cached_property
    def most_accurate(self) -> CaseResult:
        """The measured case with the smallest error; there must be one."""
        return min(self.measured, key=lambda case: largest_error(case, self.quantity))

    def at(self, setting: float) -> ErrorEstimate | None:
        """Return the error at a step or tolerance; None where it is neither measured nor predictable.

        None also for a step that is longer than the scenario.
        """
        if self.is_shorter_than(setting):
            return None
        case = self._case_at(setting)
        if case is None:
            return self._predicted(setting)
        largest = largest_error(case, self.quantity)
        return ErrorEstimate(setting, largest, "measured") if largest < math.inf else None

    def failure_at(self, setting: float) -> str | None:
        """Return the outcome of the case at a step or tolerance, if it did not end well."""
        case = self._case_at(setting)
        return None if case is None or case.ok else str(case.columns["outcome"])

    def _case_at(self, setting: float) -> CaseResult | None:
        settings = ((case, case.setting.fineness) for case in self.cases)
        return next(
            (case for case, own in settings if own and math.isclose(own, setting, rel_tol=_SAME)), None
        )

    def coarsest_within(self, error: float) -> ErrorEstimate | None:
        """Return the coarsest step predicted to meet an error, if coarser than each measured one that does.

        A sure prediction takes precedence over a coarser, unsure one. Without a measured step that meets the
        error, an unsure one is better than none.
        """
        if self.control != "dt" or not self.cases:
            return None
        meeting = [case.dt_s or 0.0 for case in cases_within(self.cases, error, self.quantity)]
        failing = [case.dt_s or 0.0 for case in self.cases if not largest_error(case, self.quantity) <= error]
        above = max(meeting, default=0.0)
        below = min((dt_s for dt_s in failing if dt_s > above), default=math.inf)
        limit = self._largest_stable_s * (1.0 + _SAME)
        steps = [
            dt_s
            for dt_s in self.steps
            if above * (1.0 + _SAME) < dt_s < below * (1.0 - _SAME)
            and dt_s <= limit
            and self._least(dt_s) <= error
        ]
        # errors fall with the step
        first = bisect_left(steps, True, key=lambda dt_s: self._meets(dt_s, error))
        nearest = steps[first : first + _FINER]
        found = [one for dt_s in nearest if (one := self._predicted(dt_s, error)) is not None]
        sure = next((one for one in found if one.basis == "predicted"), None)
        return sure or (found[0] if found and not meeting else None)

    def finer_step(self, error: float) -> float | None:
        """Return the step to measure next where none is known to meet an error; None where none helps."""
        outcomes = {case.columns["outcome"] for case in self.cases}
        cannot_help = self.verdict in NO_BETTER or not outcomes & {"ok", "unstable"}
        if self.control != "dt" or cannot_help or error <= self.floor:
            return None
        finest = min(case.dt_s or math.inf for case in self.cases)
        return next((dt_s for dt_s in self.steps if dt_s <= finest / _REFINED), None)

    def is_shorter_than(self, dt_s: float) -> bool:
        """Whether the scenario ends before one step, so that no run has this step."""
        return self.control == "dt" and dt_s > self.duration_s * (1.0 + _SAME)

    def divides_interval(self, dt_s: float | None) -> bool:
        """Whether a run of the scenario can use this step."""
        return self.control == "dt" and dt_s is not None and _divides(dt_s, self.interval_s)

    @property
    def is_predictable(self) -> bool:
        """Whether there are enough measured steps for a prediction."""
        return len(self._fitted) >= _MIN_POINTS

    @property
    def least_predicted(self) -> float:
        """The least error that any prediction states, since orders say nothing about round-off."""
        return ABOVE_FLOOR * self.floor

    def _meets(self, dt_s: float, error: float) -> bool:
        found = self._predicted(dt_s)
        return found is not None and found.error <= error

    @cached_property
    def steps(self) -> tuple[float, ...]:
        """The steps 2^-a 5^-b of the sampling interval, coarsest first.

        Steps inside which a load switches are left out, unless such steps were measured.
        """
        max_stride = MAX_STEPS * self.interval_s / self.duration_s
        powers = [5**b for b in range(int(math.log(max_stride, 5)) + 1)] if max_stride >= 1.0 else []
        strides = sorted(five << a for five in powers for a in range(int(math.log2(max_stride / five)) + 1))
        # 12 digits divide the interval as well, and are shorter to write
        steps = [float(f"{self.interval_s / n:.12g}") for n in strides]
        return tuple(dt_s for dt_s in steps if not self._is_first_with_switch(dt_s))

    @cached_property
    def _has_switches(self) -> bool:
        """Whether a load switches inside a step of a case."""
        return any(SWITCH_NOTE in case.columns["message"] for case in self.cases)

    def _is_first_with_switch(self, dt_s: float) -> bool:
        """Whether a load switches inside such a step, but inside none that was measured."""
        return not self._has_switches and not all(_divides(dt_s, at) for at in self.switches_s)

    @cached_property
    def _usable(self) -> list[tuple[float, float]]:
        """The steps and errors that are usable for an order, coarsest first."""
        errors = {case.dt_s: float(case.columns[self.quantity]) for case in self.measured if case.dt_s}
        return sorted(
            ((dt_s, e) for dt_s, e in errors.items() if ABOVE_FLOOR * self.floor < e < LARGEST_ERROR),
            reverse=True,
        )

    @cached_property
    def _settled(self) -> Order | None:
        steps, errors = zip(*self._usable, strict=True) if self._usable else ((), ())
        return settled_order(steps, errors, self.floor)

    @cached_property
    def _fitted(self) -> list[tuple[float, float]]:
        """The points that settle the order, or else all usable ones, coarsest first."""
        order = self._settled
        return self._usable if order is None else self._usable[order.first : order.first + order.points]

    @property
    def _largest_stable_s(self) -> float:
        if self.stable_s is not None:
            return self.stable_s
        unstable = [case.dt_s for case in self.cases if not case.ok and case.dt_s is not None]
        stable = [case.dt_s for case in self.cases if case.ok and case.dt_s is not None]
        return max((dt_s for dt_s in stable if dt_s < min(unstable, default=math.inf)), default=0.0)

    def _predicted(self, dt_s: float, tolerance: float = 0.0) -> ErrorEstimate | None:
        """Return the error predicted at a step; far below the tolerance, a wide interval leaves it sure."""
        if self.control != "dt" or self.verdict in NO_BETTER:
            return None
        if not self.is_predictable:
            return self._guessed(dt_s)
        steps, errors = zip(*self._fitted, strict=True)
        found = predicted_error(steps, errors, self.floor, dt_s)
        bound = bound_of(self.cases[0].columns, self.quantity)
        why = self._why_unsure(dt_s, found.error, found.high, tolerance)
        high = max(found.high + bound, self._least(dt_s))
        return ErrorEstimate(dt_s, high, "unsure" if why else "predicted", why)

    def _guessed(self, dt_s: float) -> ErrorEstimate | None:
        """e (h / h_f)^p with the order p in theory and the finest usable step h_f; None without either."""
        if self.order is None or not self._usable:
            return None
        finest, error = self._usable[-1]
        why = f"predicted from dt {step(finest)} s and the theoretical order {self.order}"
        factor = math.exp(min(self.order * math.log(dt_s / finest), _LARGEST_LOG))
        return ErrorEstimate(dt_s, max(error * factor, self._least(dt_s)), "unsure", why)

    def _least(self, dt_s: float) -> float:
        """Return the least error that is predicted at a step: 10 floors, which grow as a random walk."""
        finest = min(case.dt_s or math.inf for case in self.cases)
        return self.least_predicted * max(1.0, math.sqrt(finest / dt_s))

    def _why_unsure(self, dt_s: float, error: float, high: float, tolerance: float) -> str:
        """Return why a prediction is unsure; "" where it is not."""
        if self._settled is None:
            return f"the measured steps do not determine the order ({self.verdict or 'too-few-points'})"
        if dt_s > self._largest_stable_s * (1.0 + _SAME):
            return f"above the largest stable step, {self._largest_stable_s:.3g} s"
        if self._is_first_with_switch(dt_s):
            return "a load switches inside this step, but inside no measured one"
        coarsest = self._fitted[0][0]
        if dt_s > coarsest and any((case.dt_s or 0.0) > coarsest for case in self.cases):
            return f"above {coarsest:g} s, up to which errors follow the order"
        if high > LARGEST_ERROR:
            return f"errors above {LARGEST_ERROR:g} do not follow the order"
        if error < self._least(dt_s):
            return "near the floor of round-off and of the truth"
        # half the interval on a logarithmic scale, once more above its end, still meets the tolerance
        if high > _WIDEST * error and high * (high / error) > tolerance:
            return f"far from the measured steps: uncertain by a factor of {high / error:.2g}"
        return ""


def _divides(dt_s: float, at_s: float) -> bool:
    return math.isclose(at_s / dt_s, round(at_s / dt_s), rel_tol=_SAME)


def curves_of(
    run: Tables, quantity: str, more: tuple[CaseResult, ...] = ()
) -> Mapping[tuple[str, MethodKey], ErrorCurve]:
    """Return the curve of each scenario and method of a run; more: cases that were measured in addition."""
    judged = {
        (row["scenario"], key_of(row)): row for row in run.rows("methods") if row["quantity"] == quantity
    }
    stable = {
        (row["scenario"], key_of(row)): row["dt_stable_s"]
        for row in run.rows("stability")
        if "dt_stable_s" in row
    }
    curves = {}
    for key, cases in sequences_of((*run.cases, *more)).items():
        scenario, (engine, method) = key
        stored, row = run.manifest["scenarios"][scenario], judged.get(key, {})
        expected = row.get("expected_order", math.nan)
        facts = run.manifest["engines"][engine]["methods"][method]
        curves[key] = ErrorCurve(
            cases=cases,
            quantity=quantity,
            duration_s=stored["duration_s"],
            interval_s=stored["duration_s"] / (stored["samples"] - 1),
            verdict=row.get("verdict"),
            floor=max(0.0, row.get("floor", 0.0)),
            order=int(expected) if 0.0 <= expected <= _LARGEST_ORDER else facts["order"],
            stable_s=stable.get(key),
            switches_s=tuple(
                load[end]
                for load in stored.get("forcing", ())
                for end in ("from_s", "until_s")
                if load.get(end)
            ),
            snippet=facts.get("snippet", ""),
        )
    return curves
