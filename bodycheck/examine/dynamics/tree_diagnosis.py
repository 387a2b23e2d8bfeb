"""Name the faults that explain wrong readings of trees, each with its parameters.

A fault explains a reading if the exact equations with that fault give it, in all states. The faults that are
named explain most of the wrong readings, and change fewest of the right ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bodycheck.examine.diagnosis.faults.fault import number_text
from bodycheck.examine.dynamics.faults import TREE_FAULTS
from bodycheck.examine.dynamics.faults.tree_fault import TreeFault
from bodycheck.examine.dynamics.tree_case import TreeCase
from bodycheck.reference_impl.arrays import Array

_CASES = 3
"""Trees that all faults are tried on; fewer bodies first."""
_SHARE = 1e-3
"""Of a deviation, at most, that a fault leaves."""
_ITERATIONS, _SHORTER, _SOON = 10, 3, 2
_FITTED = 2
_ANCHORS = 2
_CHANGE = 1e-6
_SAME = 1e-3


@dataclass(frozen=True, eq=False)
class WrongTree:
    """A tree some of whose readings are wrong: values, and the deviations that count as right, by reading."""

    case: TreeCase
    found: Mapping[str, Array]
    tolerances: Mapping[str, float]

    def deviation(self, reading: str) -> float:
        """Return the deviation of a reading from the exact one."""
        return self.case.deviation(reading, self.found[reading])

    @property
    def wrong(self) -> list[str]:
        """The wrong readings."""
        return [name for name in self.found if self.deviation(name) > self.tolerances[name]]


@dataclass(frozen=True, eq=False)
class TreeExplanation:
    """A fault with its parameters in one tree; explained, contradicted: wrong and right readings."""

    fault: TreeFault
    tree: str
    bodies: tuple[int, ...]
    every: bool
    values: Array
    text: str
    explained: frozenset[str]
    contradicted: frozenset[str]

    @property
    def key(self) -> tuple[str, str, bool]:
        """What the same fault has in common in several trees."""
        return self.fault.name, self.fault.sentence, self.every


@dataclass(frozen=True)
class Cause:
    """A named fault: the readings that it explains, and a tree that shows it.

    parameters: by their names. trees: how many of the examined trees it explains, of how many.
    """

    fault: str
    text: str
    readings: tuple[str, ...]
    parameters: Mapping[str, float]
    tree: str
    trees: tuple[int, int]


def causes_of(wrong: Sequence[WrongTree]) -> tuple[tuple[Cause, ...], frozenset[str]]:
    """Return the faults that explain the wrong readings of trees, those that explain most first.

    Also return the readings that no fault explains in some of the examined trees.
    """
    examined = sorted((one for one in wrong if one.wrong), key=lambda one: len(one.case.scene.bodies))
    chosen: list[WrongTree] = []
    covered: set[str] = set()
    for one in examined:  # trees that show further readings, then more of the same
        if not covered.issuperset(one.wrong):
            chosen.append(one)
            covered.update(one.wrong)
    chosen += [one for one in examined if one not in chosen][: max(0, _CASES - len(chosen))]
    found = [list(_explanations(one)) for one in chosen]
    causes: list[Cause] = []
    left = [set(one.wrong) for one in chosen]
    while any(left):
        useful = [
            [one for one in some if one.explained & rest] for rest, some in zip(left, found, strict=True)
        ]
        best = _best(useful, left)
        if not best:
            break
        causes.append(_cause(best, left))
        for explanation in best:
            rest = left[[one.case.name for one in chosen].index(explanation.tree)]
            rest -= explanation.explained
    return tuple(causes), frozenset().union(*left)


def _best(found: Sequence[Sequence[TreeExplanation]], left: Sequence[set[str]]) -> list[TreeExplanation]:
    """Return the explanations by the same fault, one of a tree, that explain most of what is left."""
    by_key: dict[tuple[str, str, bool], list[TreeExplanation]] = {}
    for some in found:
        for explanation in sorted(some, key=lambda one: -len(one.explained)):
            same = by_key.setdefault(explanation.key, [])
            if explanation.tree not in [other.tree for other in same]:
                same.append(explanation)
    rests = {some[0].tree: rest for some, rest in zip(found, left, strict=True) if some}

    def badness(same: list[TreeExplanation]) -> tuple[int, int, int, int]:
        return (
            -sum(len(one.explained & rests[one.tree]) for one in same),
            sum(len(one.contradicted) for one in same),
            len(same[0].values),
            TREE_FAULTS.index(same[0].fault),
        )

    return min(by_key.values(), key=badness, default=[])


def _cause(same: list[TreeExplanation], left: Sequence[set[str]]) -> Cause:
    first = same[0]
    readings = frozenset().union(*(one.explained for one in same))
    parameters = dict(zip((one.name for one in first.fault.parameters), first.values.tolist(), strict=True))
    ordered = tuple(name for name in first.fault.readings if name in readings)
    return Cause(
        first.fault.name, first.text, ordered, parameters, first.tree, (len(same), sum(map(bool, left)))
    )


def _explanations(tree: WrongTree) -> Iterator[TreeExplanation]:
    """Yield the faults that explain readings of a tree, up to one that explains them all."""
    wrong = frozenset(tree.wrong)
    for fault in TREE_FAULTS:
        for bodies, every in _scopes(fault, tree):
            for explanation in _explained_by(fault, bodies, every, tree):
                yield explanation
                if explanation.explained == wrong and not explanation.contradicted:
                    return


def _scopes(fault: TreeFault, tree: WrongTree) -> Iterator[tuple[tuple[int, ...], bool]]:
    """Yield the bodies that may have a fault: none for a fault of the tree, all, or each alone."""
    if not fault.applies(tree.case):
        return
    if fault.bodies is None:
        yield (), True
        return
    able = tuple(fault.bodies(tree.case.scene))
    if able:
        yield able, True
    if len(able) > 1:
        yield from (((body,), False) for body in able)


def _explained_by(
    fault: TreeFault, bodies: tuple[int, ...], every: bool, tree: WrongTree
) -> Iterator[TreeExplanation]:
    """Yield the explanations by one fault, each of wrong readings with the same parameters."""
    case, left = tree.case, [name for name in tree.wrong if name in fault.readings]
    left.sort(key=lambda name: -tree.found[name].size)  # those that say most come first
    right = [name for name in fault.readings if name in tree.found and name not in tree.wrong]
    right = [] if fault.is_partial else right
    for _ in range(_ANCHORS if fault.parameters else 1):
        if not left:
            return
        with suppress(ValueError), np.errstate(all="ignore"):  # no tree has such parameters
            values = _fitted(fault, bodies, tree, left[0]) if fault.parameters else np.empty(0)
            faulty = fault.plant(case, bodies, values)
            if explained := frozenset(name for name in left if _is_explained(tree, name, faulty(name))):
                contradicted = frozenset(
                    name
                    for name in right
                    if case.deviation(name, faulty(name)) > 10.0 * tree.tolerances[name]
                )
                text = _text(fault, bodies, every, values, case)
                yield TreeExplanation(fault, case.name, bodies, every, values, text, explained, contradicted)
                left = [name for name in left if name not in explained]
                continue
        left = left[1:]


def _is_explained(tree: WrongTree, reading: str, faulty: Array) -> bool:
    remaining = tree.case.deviation(reading, tree.found[reading], faulty)
    return remaining <= min(100.0 * tree.tolerances[reading], _SHARE * tree.deviation(reading))


def _fitted(fault: TreeFault, bodies: tuple[int, ...], tree: WrongTree, reading: str) -> Array:
    """Return the parameters with which a fault explains a reading best, by Gauss-Newton steps.

    The fit uses the last states, which move.
    """
    case = replace(tree.case, states=tree.case.states[-_FITTED:])
    found, values = tree.found[reading][-_FITTED:], np.array(fault.start)
    limits = np.array([(one.low, one.high) for one in fault.parameters]).T

    def remaining(at: Array) -> Array:
        return case.differences(reading, found, fault.plant(case, bodies, at)(reading)).ravel()

    differences = remaining(values)
    first = float(np.linalg.norm(differences))
    for iteration in range(_ITERATIONS):
        changes = _CHANGE * np.eye(len(values))
        slopes = np.column_stack([(remaining(values + one) - differences) / _CHANGE for one in changes])
        if not np.all(np.isfinite(slopes)):
            break
        step = np.linalg.lstsq(slopes, -differences, rcond=1e-8)[0]
        for _ in range(_SHORTER):
            closer = np.clip(values + step, *limits)
            after = remaining(closer)
            if np.linalg.norm(after) < 0.9 * np.linalg.norm(differences):
                break
            step = 0.25 * step
        else:
            break
        values, differences = closer, after
        if iteration == _SOON and np.linalg.norm(differences) > 0.3 * first:
            break
    return values


def _text(fault: TreeFault, bodies: tuple[int, ...], every: bool, values: Array, case: TreeCase) -> str:
    sentence = fault.sentence
    for special, known in fault.special(case, bodies[0] if bodies else 0).items():
        if np.allclose(values, known, rtol=_SAME, atol=_SAME):
            sentence = special
    at = "" if not bodies else case.scene.bodies[bodies[0]].name
    if every and len(bodies) > 1:
        at = "every body"
    return sentence.format(*map(number_text, values), at=at)
