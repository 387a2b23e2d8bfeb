"""Measure the settings that `advise` predicts: how many meet the error tolerance, and how many are unsure.

Each scenario, method and error of a run is one question, answered from the run's own steps. The predicted
steps are then measured, unless they cost more than --most-steps steps. A prediction holds if the measured
error is at most 1.5 times the requested one. Exit status 1 if a prediction that is not unsure does not hold,
or if more than a tenth of the predictions or of all answers are unsure or missing.

    bodycheck run standard --no-speed --out std && python tools/advice_trials.py std
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from trials import command

from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import MethodKey, key_of
from bodycheck.reports.summary.error_curve import (
    ErrorCurve,
    ErrorEstimate,
    cases_within,
    curves_of,
    largest_error,
)
from bodycheck.runs.advice_run import measure_steps
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import NULL_PROGRESS

FACTOR = 1.5
MAX_UNSURE = 0.1


@dataclass(frozen=True)
class Question:
    """One scenario, one method and one error, with the estimate that answers it."""

    place: tuple[str, MethodKey]
    error: float
    estimate: ErrorEstimate

    @property
    def dt_s(self) -> float:
        """Return the predicted step."""
        assert self.estimate.setting is not None
        return self.estimate.setting


def main(
    run: Path,
    measure: str = "orientation_error_rad",
    errors: str = "1e-1,1e-2,1e-3,1e-4,1e-5,1e-6",
    engines: str = "",
    most_steps: float = 3e5,
    questions: int | None = None,
    seed: int = 1,
) -> bool:
    """Print the figures of the folder of a run with the coarse steps.

    engines: only these, separated by commas; questions: the size of a random sample; all by default.
    """
    tables = read_tables(run)
    curves = {
        place: curve
        for place, curve in curves_of(tables, measure).items()
        if curve.control == "dt"
        and (not engines or place[1][0] in engines.split(","))
        and any(case.columns["outcome"] != "unsupported" for case in curve.cases)
    }
    kinds = Counter[str]()
    predicted = list(_questions(curves, [float(error) for error in errors.split(",")], kinds))
    _print_counts("answers", kinds)
    cheap = [one for one in predicted if _steps(curves[one.place], one.dt_s) <= most_steps]
    if questions is not None and questions < len(cheap):
        chosen = np.random.default_rng(seed).choice(len(cheap), questions, replace=False)
        cheap = [cheap[place] for place in sorted(chosen)]
    print(f"{len(predicted)} predictions, {len(cheap)} of them measured")

    found, factors = Counter[str](), []
    for batch in _batches(cheap):
        steps = {one.place: one.dt_s for one in batch}
        measured = measure_steps(tables, steps, Request(speed=False), lambda _: nullcontext(NULL_PROGRESS))
        cases = {(case.columns["scenario"], key_of(case.columns)): case for case in measured.cases}
        for one in batch:
            ratio = largest_error(cases[one.place], measure) / one.error
            found[f"{one.estimate.basis}, {'holds' if ratio <= FACTOR else 'fails'}"] += 1
            if one.estimate.basis == "predicted":
                factors.append(ratio)
            if ratio > FACTOR:
                print(
                    f"  {one.place[0]} {':'.join(one.place[1])} {one.error:g}: {one.estimate} -> {ratio:.3g}"
                )
    _print_counts("measured", found)
    if factors:
        quantiles = np.quantile(factors, [0.0, 0.05, 0.5, 0.95, 1.0])
        print("measured over requested error: " + ", ".join(f"{value:.3g}" for value in quantiles), end="")
        print(" (least, 5 %, median, 95 %, largest)")
    predictions, answers = kinds["predicted"] + kinds["unsure"], sum(kinds.values())
    unsure = kinds["unsure"] / max(predictions, 1)
    without = (kinds["unsure"] + kinds["none"]) / answers
    print(f"unsure: {100 * unsure:.1f} % of {predictions} predictions")
    print(f"unsure or no setting: {100 * without:.1f} % of {answers} answers")
    return found["predicted, fails"] > 0 or max(unsure, without) > MAX_UNSURE


def _questions(
    curves: Mapping[tuple[str, MethodKey], ErrorCurve], errors: Iterable[float], kinds: Counter[str]
) -> Iterable[Question]:
    """Yield the questions whose answer is a prediction, and count the answers of all questions."""
    for error in errors:
        for place, curve in curves.items():
            found = curve.coarsest_within(error)
            if found is not None:
                kinds[found.basis] += 1
                yield Question(place, error, found)
            else:
                kept = any(True for _ in cases_within(curve.cases, error, curve.quantity))
                kinds["measured" if kept else "none"] += 1


def _steps(curve: ErrorCurve, dt_s: float) -> float:
    return curve.duration_s / dt_s


def _batches(questions: Iterable[Question]) -> list[list[Question]]:
    """Return batches in which each scenario and method has one step."""
    batches: list[dict[tuple[str, MethodKey], Question]] = []
    for one in questions:
        fitting = next((batch for batch in batches if one.place not in batch), None)
        if fitting is None:
            batches.append({one.place: one})
        else:
            fitting[one.place] = one
    return [list(batch.values()) for batch in batches]


def _print_counts(what: str, counts: Counter[str]) -> None:
    reported = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
    print(f"{what}: {reported} ({sum(counts.values())} in all)")


if __name__ == "__main__":
    command(main)
