"""The tableaus of the Runge-Kutta methods and of known maps against the order conditions, by rooted trees."""

from __future__ import annotations

from functools import cache
from itertools import combinations_with_replacement
from math import factorial, prod
from typing import TypeAlias

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.facts import Integrator, Tableau
from bodycheck.reference_impl.one_step_maps.tableaus import (
    CROUCH_GROSSMAN_3,
    EXPLICIT,
    IMPLICIT,
    NamedTableau,
)

EPS = float(np.finfo(np.float64).eps)

every_tableau = pytest.mark.parametrize(
    "method", [method for method in INTEGRATORS.values() if method.tableau is not None], ids=lambda m: m.name
)

Tree: TypeAlias = "tuple[Tree, ...]"
"""A rooted tree: the subtrees at its root."""


def tableau_of(method: Integrator) -> Tableau:
    """Return the tableau of a method that has one."""
    assert method.tableau is not None
    return method.tableau


@cache
def forests(nodes: int, largest: int) -> list[tuple[Tree, ...]]:
    """Return all multisets of trees with this many nodes in total and none above `largest`."""
    if nodes == 0:
        return [()]
    if largest == 0:
        return []
    found = []
    for count in range(nodes // largest + 1):
        for of_largest in combinations_with_replacement(trees(largest), count):
            found += [of_largest + rest for rest in forests(nodes - count * largest, largest - 1)]
    return found


def trees(nodes: int) -> list[Tree]:
    """Return all rooted trees with this many nodes."""
    return forests(nodes - 1, nodes - 1)


def size(tree: Tree) -> int:
    """Return the number of nodes."""
    return 1 + sum(map(size, tree))


def density(tree: Tree) -> int:
    """gamma(t) = |t| gamma(t_1) ... gamma(t_k)."""
    return size(tree) * prod(map(density, tree))


def stage_weights(tree: Tree, a: Array) -> Array:
    """g_i(t) = product over the subtrees u of sum_j a_ij g_j(u), (s,)."""
    weights = np.ones(len(a))
    for subtree in tree:
        weights = weights * (a @ stage_weights(subtree, a))
    return weights


def order_defect(tableau: Tableau | NamedTableau, order: int) -> float:
    """Return max |b . g(t) - 1 / gamma(t)| over the trees of `order` nodes."""
    return max(
        abs(float(tableau.b @ stage_weights(tree, tableau.a)) - 1.0 / density(tree)) for tree in trees(order)
    )


def test_number_of_trees_is_cayleys() -> None:
    """There are 1, 1, 2, 4, 9, 20, 48, 115 rooted trees of 1 to 8 nodes (Cayley 1857)."""
    assert [len(trees(n)) for n in range(1, 9)] == [1, 1, 2, 4, 9, 20, 48, 115]
    assert all(size(tree) == 6 for tree in trees(6))


@every_tableau
def test_tableau_is_explicit_and_its_nodes_are_the_sums_of_its_rows(method: Integrator) -> None:
    """a is strictly lower triangular, and sum_j a_ij = c_i."""
    a, b, c = tableau_of(method)
    assert a.shape == (len(b), len(b))
    assert np.array_equal(a, np.tril(a, -1))
    assert np.max(np.abs(a.sum(axis=1) - c)) <= 8 * EPS
    assert method.evaluations == len(b)


@pytest.mark.parametrize(
    "method",
    [
        *(method for method in INTEGRATORS.values() if method.tableau is not None),
        *(*EXPLICIT, *IMPLICIT, CROUCH_GROSSMAN_3),
    ],
    ids=lambda m: m.name,
)
def test_tableau_has_exactly_the_stated_order(method: Integrator | NamedTableau) -> None:
    """b . g(t) = 1 / gamma(t) for every tree of up to `order` nodes, but not for all of one node more.

    Butcher (1963); Hairer, Norsett and Wanner (1993), Solving ODEs I, theorem II.2.13.
    """
    tableau = tableau_of(method) if isinstance(method, Integrator) else method
    for order in range(1, method.order + 1):
        assert order_defect(tableau, order) <= 16 * EPS, order
    assert order_defect(tableau, method.order + 1) > 1e-8


@every_tableau
def test_stability_function_is_the_exponential_to_the_order(method: Integrator) -> None:
    """R(z) - sum z^k / k! over k <= order is O(z^(order + 1))."""
    for z in (0.1j, -0.1, 0.1 + 0.1j):
        series = sum(z**k / factorial(k) for k in range(method.order + 1))
        gap = abs(tableau_of(method).stability_function(z) - series)
        assert gap <= abs(z) ** (method.order + 1) + 4 * EPS
