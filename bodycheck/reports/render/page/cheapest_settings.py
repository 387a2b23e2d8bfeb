"""The table of the first screen: for each error tolerance, the cheapest setting of each engine."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bodycheck._util.formatting import number, step
from bodycheck.adapters.engine_names import REFERENCE
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.render.page.downsampling import rounded
from bodycheck.reports.run_files.run_tables import MethodKey, Run
from bodycheck.reports.summary.advice import Option, ScenarioAdvice, settings_within
from bodycheck.reports.summary.error_curve import (
    RefinementSequence,
    cases_within,
    cheapest,
    curves_of,
    largest_error,
    sequences_of,
)

TOLERANCES: tuple[float, ...] = tuple(float(f"1e-{k}") for k in range(1, 13))
"""The positions of the slider: tolerances of the orientation error in rad."""

START = 2
"""The position of the slider when the page opens: 1e-3 rad."""


@dataclass(frozen=True, eq=False)
class CheapestSettings:
    """The answers of `bodycheck advise` to each position of the slider.

    each: whether also for each scenario alone.
    """

    run: Run
    each: bool = True

    @cached_property
    def scopes(self) -> list[str | None]:
        """What can be chosen: all scenarios together (None), if there are several, and each one."""
        names = [problem.scenario.name for problem in self.run.problems]
        return [*([None] if len(names) > 1 else []), *(names if self.each else ())]

    @cached_property
    def engines(self) -> list[str]:
        """The engines of the run, in its order."""
        return list(dict.fromkeys(case.columns["engine"] for case in self.run.cases))

    @cached_property
    def rows(self) -> list[list[list[dict[str, Any]]]]:
        """One row per engine, by scope and tolerance, as the page shows it."""
        curves = curves_of(self.run, ORIENTATION)
        answers_by_error = [
            settings_within(curves, error, self._scenarios, predicted=False)[: len(self.scopes)]
            for error in TOLERANCES
        ]
        nearest = [self._nearest(scope) for scope in self.scopes]
        return [
            [self._rows(answers[index], nearest[index]) for answers in answers_by_error]
            for index in range(len(self.scopes))
        ]

    @property
    def data(self) -> dict[str, Any]:
        """The data of the slider: tolerances, the distinct rows, and their numbers by scope and tolerance."""
        numbers: dict[str, int] = {}
        numbers_by_scope = [
            [[numbers.setdefault(json.dumps(row), len(numbers)) for row in rows] for rows in of_scope]
            for of_scope in self.rows
        ]
        return {
            "tolerances": list(TOLERANCES),
            "rows": list(map(json.loads, numbers)),
            "places": numbers_by_scope,
        }

    @cached_property
    def _scenarios(self) -> list[str]:
        return [problem.scenario.name for problem in self.run.problems]

    @cached_property
    def _sequences(self) -> Mapping[tuple[str, MethodKey], RefinementSequence]:
        return sequences_of(self.run.cases)

    def _rows(self, answer: ScenarioAdvice, nearest: Mapping[str, str]) -> list[dict[str, Any]]:
        """Return the rows of one scope at one tolerance: engines that meet it first, the reference last."""
        met = [_row(option) for option in answer.options]
        names = {row["engine"] for row in met}
        missed = [{"engine": name, "missed": nearest[name]} for name in self.engines if name not in names]
        return sorted([*met, *missed], key=lambda row: row["engine"] == REFERENCE)

    def _nearest(self, scope: str | None) -> dict[str, str]:
        """Return, for each engine, the smallest error that any of its methods reaches in the scope."""
        scenarios = self._scenarios if scope is None else [scope]
        found: dict[str, tuple[float, str]] = {}
        for key in dict.fromkeys(key for _, key in self._sequences):
            worst = max((self._smallest_error(name, key), name) for name in scenarios)
            found[key[0]] = min(found.get(key[0], (math.inf, "")), (worst[0], _reached(key, *worst)))
        return {engine: text or "not measured" for engine, (_, text) in found.items()}

    def _smallest_error(self, scenario: str, key: MethodKey) -> float:
        sequence = self._sequences.get((scenario, key), ())
        return min((largest_error(case, ORIENTATION) for case in sequence), default=math.inf)


def _row(option: Option) -> dict[str, Any]:
    return {
        "engine": option.engine,
        "method": option.method,
        "control": option.control,
        "setting": "none" if option.setting is None else step(option.setting),
        "error": number(option.error, 3),
        "speed": None if not option.real_time else number(float(f"{option.real_time:.3g}"), 6),
        "limiting": option.limiting,
        "reproduce": option.confirm,
        "snippet": option.snippet,
    }


def _reached(key: MethodKey, error: float, scenario: str) -> str:
    if error == math.inf:
        return ""
    return f"smallest measured error {number(error, 3)} rad ({key[1]}, limited by {scenario})"


def cell_data(sequence: RefinementSequence) -> dict[str, Any]:
    """Return the numbers of one cell of the heat map.

    met: by tolerance, the speed of the cheapest case that meets it, as a multiple of real time; 0 where its
    time was not measured, None where no case meets it. errors: the orientation error at each step.
    """
    return {
        "met": [_fastest(sequence, error) for error in TOLERANCES],
        "errors": {
            step(case.dt_s): rounded(case.columns[ORIENTATION])
            for case in sequence
            if case.ok and case.dt_s is not None and ORIENTATION in case.columns
        },
    }


def _fastest(sequence: RefinementSequence, error: float) -> float | None:
    case = cheapest([sequence], error, ORIENTATION)
    if case is not None and (cpu_s := case.columns["cpu_s"]) > 0.0:  # a coarse clock may measure 0
        return rounded(case.columns["duration_s"] / cpu_s)
    return 0.0 if any(cases_within(sequence, error, ORIENTATION)) else None
