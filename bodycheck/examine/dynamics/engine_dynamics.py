"""What an engine reports of trees, reading by reading: deviations, stages after a step, and causes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Precision
from bodycheck.adapters.reading_names import READINGS
from bodycheck.adapters.workers.tree_readings import TreeReadings
from bodycheck.examine.dynamics.tree_case import PARTS, TreeCase, TreeState
from bodycheck.examine.dynamics.tree_diagnosis import Cause, WrongTree, causes_of
from bodycheck.reference_impl.arrays import Array

Stage: TypeAlias = Literal["start", "end", "one step before", "unclear", ""]
Verdict: TypeAlias = Literal["right", "wrong", "unsupported", "failed"]

LABELS: Mapping[str, str] = dict(
    zip(
        READINGS,
        ("mass matrix", "bias", "gravity", "accelerations", "joint wrenches", "energy", "P and L", "poses"),
        strict=True,
    )
)
_RIGHT: Mapping[Precision, float] = {"float64": 1e-9, "float32": 3e-5, "mixed": 3e-5}
"""Largest relative deviation of a right reading: of rotation vectors near pi, not of M, which adds to it."""
_EPS: Mapping[Precision, float] = {"float64": 2.2e-16, "float32": 1.2e-7, "mixed": 1.2e-7}
_SOLVED = ("accelerations", "wrenches")
_CLEAR = 3.0
"""Times farther that the second nearest stage must be."""
_STAGES: tuple[Stage, ...] = ("one step before", "start", "end")


@dataclass(frozen=True, eq=False)
class ReadTree:
    """A tree, and what an engine reports of it, or why it reports nothing: an outcome and a message."""

    case: TreeCase
    readings: TreeReadings | None
    outcome: str = "ok"
    message: str = ""

    def tolerance(self, reading: str) -> float:
        """Return the largest deviation of a right reading; that of a solution grows with cond M."""
        assert self.readings is not None
        precision = self.readings.precision
        least = max(_RIGHT[precision], self.readings.resolution.get(reading, 0.0))
        solved = 100.0 * _EPS[precision] * self.case.largest_condition if reading in _SOLVED else 0.0
        return least + solved

    def stage(self, reading: str) -> Stage:
        """Return the state that a reading after two steps belongs to: before, between or after them.

        Of the parts of a reading, such as force and moment, the one that fits best decides.
        """
        if self.readings is None or reading not in self.readings.after:
            return ""
        states = zip(self.readings.q, self.readings.u, strict=True)
        passed = TreeCase("", tuple(TreeState(self.case.scene, q, u) for q, u in states))
        passed = passed.changed(lambda state: state)
        found = self.readings.after[reading]
        exact = passed.exact(reading)
        if found.shape != exact.shape[1:]:
            return "unclear"
        differences = np.abs(passed.differences(reading, np.array([found] * len(exact))))
        parts = PARTS.get(reading, (slice(None),))
        by_part = [np.max(differences[..., part].reshape(len(exact), -1), axis=1) for part in parts]
        nearest = np.sort(min(by_part, key=np.min))
        if not np.isfinite(nearest[0]) or nearest[1] <= _CLEAR * nearest[0]:
            return "unclear"
        return _STAGES[int(np.argmin(min(by_part, key=np.min)))]


@dataclass(frozen=True)
class ReadingResult:
    """One reading over all trees.

    median, worst: of the relative deviations of the trees; None if nothing was read. at: the worst tree.
    right, read: numbers of trees. at_rest: the worst deviation in states of rest. stage: of the state that
    the reading belongs to after a step. native: the engine's call, axes and order. reasons: why some trees
    have no such reading. known_fault: of the engine itself, as its adapter states it.
    """

    reading: str
    verdict: Verdict
    median: float | None
    worst: float | None
    at: str
    right: int
    read: int
    at_rest: float | None
    stage: Stage
    native: str
    reasons: tuple[str, ...]
    known_fault: str = ""


@dataclass(frozen=True)
class EngineDynamics:
    """The answer of `bodycheck dynamics`: readings, the causes of wrong ones, and trees without readings."""

    engine: str
    version: str
    trees: tuple[str, ...]
    seed: int
    readings: tuple[ReadingResult, ...]
    causes: tuple[Cause, ...]
    unexplained: tuple[str, ...]
    no_step: str
    unread: Mapping[str, str]

    @property
    def wrong(self) -> tuple[ReadingResult, ...]:
        """The wrong readings."""
        return tuple(one for one in self.readings if one.verdict in ("wrong", "failed"))

    @property
    def late(self) -> tuple[ReadingResult, ...]:
        """The readings that belong to an earlier state than the one that is read with them."""
        return tuple(one for one in self.readings if one.stage in ("start", "one step before"))


def dynamics_rows(found: EngineDynamics) -> list[dict[str, Any]]:
    """Return one row per reading, which gates read."""
    return [
        {
            "engine": found.engine,
            "reading": one.reading,
            "verdict": one.verdict,
            "median": one.median,
            "worst": one.worst,
            "message": "; ".join(one.reasons),
        }
        for one in found.readings
    ]


def engine_dynamics(engine: str, version: str, trees: Sequence[ReadTree], seed: int) -> EngineDynamics:
    """Return the results of an engine on trees."""
    read = [tree for tree in trees if tree.readings is not None]
    results = tuple(_reading_result(reading, read) for reading in READINGS)
    wrong = [one for one in map(_wrong_tree, read) if one.wrong]
    causes, unexplained = causes_of(wrong)
    unread = {tree.case.name: f"{tree.outcome}: {tree.message}" for tree in trees if tree.readings is None}
    no_step = next(
        (tree.readings.reasons["step"] for tree in read if tree.readings and "step" in tree.readings.reasons),
        "",
    )
    return EngineDynamics(
        engine,
        version,
        tuple(tree.case.name for tree in trees),
        seed,
        results,
        causes,
        tuple(reading for reading in READINGS if reading in unexplained),
        no_step,
        unread,
    )


def _wrong_tree(tree: ReadTree) -> WrongTree:
    assert tree.readings is not None
    values = tree.readings.values
    return WrongTree(tree.case, values, {name: tree.tolerance(name) for name in values})


def _reading_result(reading: str, trees: Sequence[ReadTree]) -> ReadingResult:
    deviations: dict[str, float] = {}
    resting: list[float] = []
    right, reasons = 0, Counter[str]()
    native, known_fault, stages = "", "", Counter[Stage]()
    for tree in trees:
        assert tree.readings is not None
        native = tree.readings.native.get(reading, native)
        known_fault = tree.readings.known_faults.get(reading, known_fault)
        if (found := tree.readings.values.get(reading)) is None:
            reasons[tree.readings.reasons.get(reading, "not read")] += 1
            continue
        deviation = deviations[tree.case.name] = tree.case.deviation(reading, found)
        right += deviation <= tree.tolerance(reading)
        resting += [_at_rest(tree.case, reading, found)]
        if stage := tree.stage(reading):
            stages[stage] += 1
    clear = [stage for stage, _ in stages.most_common() if stage != "unclear"]
    worst = max(deviations, key=deviations.__getitem__, default="")
    failed = any(reason.startswith("failed") for reason in reasons)
    verdict: Verdict = "right" if right == len(deviations) else "wrong"
    if not deviations:
        verdict = "failed" if failed else "unsupported"
    return ReadingResult(
        reading,
        verdict,
        median(deviations.values()) if deviations else None,
        deviations[worst] if deviations else None,
        worst,
        right,
        len(deviations),
        max(resting, default=None),
        clear[0] if clear else "unclear" if stages else "",
        native,
        tuple(reason for reason, _ in reasons.most_common()),
        known_fault,
    )


def _at_rest(case: TreeCase, reading: str, found: Array) -> float:
    """Return the largest deviation in the states of rest."""
    if found.shape != case.exact(reading).shape:
        return float("inf")
    differences = np.abs(case.differences(reading, found))
    return max(
        (
            float(np.max(row))
            for row, state in zip(differences, case.states, strict=True)
            if not state.u.any()
        ),
        default=0.0,
    )
