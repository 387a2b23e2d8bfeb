"""The columns of results.csv, each declared once, with its value where the case itself gives it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Method
from bodycheck.adapters.execution import Answer
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.truth.truth import QUANTITIES
from bodycheck.reference_impl.wrench import StepPlan
from bodycheck.reports.measurement.compared_motion import Compared
from bodycheck.reports.measurement.convergence import LARGEST_ERROR
from bodycheck.reports.measurement.joint_errors import worst_body
from bodycheck.reports.measurement.measures import IDENTITY, MEASURES, ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.tree_map_made import DISTANCE, MAP, NEXT

SCHEMA_VERSION = "1.0"
"""MAJOR.MINOR of the schema of results: every column is required, so that MAJOR rises with a new one."""

SPEEDS = ("cpu_s", "cpu_s_low", "cpu_s_high", "ns_per_step", "relative_cpu")
"""The columns that are measured times, or ratios of them."""

Holds: TypeAlias = Literal["number", "whole number", "words", "yes or no"]


@dataclass(frozen=True, eq=False)
class AnsweredCase:
    """A case that its engine supports, and the answer; plan: None for a method that chooses its steps."""

    problem: Problem
    method: Method
    plan: StepPlan | None
    answer: Answer


@dataclass(frozen=True, eq=False)
class ComparedCase:
    """A case that ended well, beside the truth; series: its measures over time (compared,)."""

    problem: Problem
    compared: Compared
    series: Mapping[str, Array]


@dataclass(frozen=True)
class CaseColumn:
    """A column of results.csv.

    of_answer, of_motion: its value in a case, None where there is none. Without either, others give it:
    `Problem.columns` what all cases of a scenario share, `study` what compares cases, `speed` what is timed,
    `run_case` how the case is identified and ended.
    """

    name: str
    holds: Holds = "number"
    of_answer: Callable[[AnsweredCase], Any] | None = None
    of_motion: Callable[[ComparedCase], Any] | None = None


def _steps(case: AnsweredCase) -> int | None:
    return case.answer.steps if case.plan is None else case.plan.steps


def _rhs_evaluations(case: AnsweredCase) -> int | None:
    steps, each = _steps(case), case.method.evaluations
    return None if steps is None or each is None else each * steps


def _horizon_s(case: ComparedCase) -> float | None:
    """Return the last time up to which the error stayed at or below 0.3 rad, 0 if none; if chaotic."""
    if not case.problem.is_chaotic:
        return None
    beyond = case.series[ORIENTATION] > LARGEST_ERROR
    within = int(np.argmax(beyond)) if beyond.any() else len(beyond)
    return float(case.problem.times[within - 1]) if within else 0.0


COLUMNS = (
    *(CaseColumn(name, "words") for name in IDENTITY),
    CaseColumn("control", "words"),
    CaseColumn("precision", "words"),
    CaseColumn("dt_s"),
    CaseColumn("tolerance"),
    CaseColumn("steps", "whole number", of_answer=_steps),
    CaseColumn("duration_s"),
    CaseColumn("outcome", "words"),
    CaseColumn("message", "words"),
    CaseColumn("reproduce", "words"),
    CaseColumn("reused", "yes or no"),
    CaseColumn("build", "words"),
    CaseColumn("length_scale_m"),
    CaseColumn("speed_scale_m_s"),
    CaseColumn("omega_scale_rad_s"),
    CaseColumn("energy_scale_j"),
    CaseColumn("rotational_energy_scale_j"),
    CaseColumn("angular_momentum_scale_kg_m2_s"),
    CaseColumn("linear_momentum_scale_kg_m_s"),
    *(CaseColumn(name) for measure in MEASURES.values() for name in measure.columns),
    CaseColumn("invariant", "words"),
    CaseColumn("worst_body", "words", of_motion=lambda case: worst_body(case.series)),
    CaseColumn(MAP, "words"),
    CaseColumn(DISTANCE),
    CaseColumn(NEXT),
    CaseColumn("successive_difference_rad"),
    CaseColumn("truth", "words"),
    *(CaseColumn(f"truth_bound_{quantity}") for quantity in QUANTITIES),
    CaseColumn("compared_until_s"),
    CaseColumn("horizon_s", of_motion=_horizon_s),
    *(CaseColumn(name) for name in SPEEDS),
    CaseColumn("rhs_evaluations", "whole number", of_answer=_rhs_evaluations),
    CaseColumn("stepping", "words", of_answer=lambda case: case.answer.stepping),
)
"""The columns but run_id, in order."""


def answer_columns(case: AnsweredCase) -> dict[str, Any]:
    """Return the columns that follow from an answer, as far as they are known."""
    found = {one.name: one.of_answer(case) for one in COLUMNS if one.of_answer is not None}
    return {name: value for name, value in found.items() if value is not None}


def motion_columns(case: ComparedCase) -> dict[str, Any]:
    """Return the columns, besides measures, that follow from a motion, as far as it has them."""
    found = {one.name: one.of_motion(case) for one in COLUMNS if one.of_motion is not None}
    return {name: value for name, value in found.items() if value is not None}
