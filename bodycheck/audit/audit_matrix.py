"""Compare the mass matrix of a model file at random configurations with those of importers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import names
from bodycheck.adapters.importers import CONFIGURATIONS, MassMatrices
from bodycheck.audit.audit import FOLLOWS, SINGLE, MatrixComparison
from bodycheck.audit.audit_joints import HeldJoints, matched_joints
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_quaternion
from bodycheck.reference_impl.trees.tree_dynamics import tree_dynamics
from bodycheck.scenarios.model_files.exact_arithmetic import ExactInertia, Frame, exact, mp
from bodycheck.scenarios.model_files.joint import StatedJoint
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, StatedInertia
from bodycheck.scenarios.model_files.model_tree import ModelTree, model_trees


@dataclass(frozen=True, eq=False)
class _Pair:
    """A tree of the file and, at each configuration, the matrices of it and of an importer.

    Each is that of the joints with the base at rest; with a free base, the one with the base free follows.
    joints: link and number of each row. scales: sqrt(M_ii) of the file, with the base at rest.
    """

    joints: Sequence[tuple[str, int]]
    stated: list[Array]
    held: list[Array]
    scales: list[Array]

    def worst(self, change: Callable[[Array], Array] = lambda M: M) -> tuple[float, tuple[int, int]]:
        """Return the largest |dM_ij| / sqrt(M_ii M_jj) and its place; `change`: of the matrix of the file."""
        found, place = 0.0, (0, 0)
        for M, held, scale in zip(self.stated, self.held, self.scales, strict=True):
            relative = np.abs(held - change(M)) / np.outer(scale, scale)
            relative = np.where(np.isnan(relative), np.inf, relative)
            if (largest := float(relative.max())) > found:
                found = largest
                row, column = divmod(int(relative.argmax()), len(relative))
                place = row, column
        return found, place


def compared_matrices(
    model: ModelFile, held: HeldJoints, found: Sequence[MassMatrices], why_none: str
) -> MatrixComparison:
    """Return the comparison of an importer's mass matrices with those of the file."""
    if not found:
        return MatrixComparison(None, cause=why_none or "the importer has no mass matrix of this model")
    places = {
        (link.name, k): one.place
        for link in model.links
        if link.name in held.named
        for k, one in enumerate(matched_joints(link, held))
        if one is not None
    }
    try:
        pairs = [_pair(tree, places, held, found) for tree in model_trees(model)]
    except InputError as error:
        why = str(error).removeprefix(f"{model.path}:").strip()
        return MatrixComparison(None, cause=f"line {why}" if why[0].isdigit() else why)
    if not pairs:
        return MatrixComparison(None, cause="no joint moves")
    worst, pair = max(((one.worst()[0], one) for one in pairs), key=lambda one: one[0])
    i, j = pair.worst()[1]
    joints = tuple(dict.fromkeys(_name(model, pair.joints[k]) for k in (i, j)))
    if worst <= SINGLE:
        return MatrixComparison(worst, joints)
    return MatrixComparison(worst, joints, _cause(model, pairs, held, found))


def matrices_of_file(model: ModelFile) -> tuple[list[MassMatrices], str]:
    """Return the mass matrices of a file at random configurations, and why there are none."""
    place = {link.name: index for index, link in enumerate(model.links)}
    rng, found = np.random.default_rng(1), []
    try:
        for tree in model_trees(model):
            scene = tree.scene
            labels = zip(tree.joints, scene.rate_slices, strict=True)
            columns = [
                (place[link], k) for (link, k), rates in labels for _ in range(rates.stop - rates.start)
            ]
            moved = rng.uniform(-1.0, 1.0, (CONFIGURATIONS, len(columns)))
            values = [_mass_matrix(tree, displacement) for displacement in moved]
            found.append(MassMatrices(columns, moved, np.array(values)))
    except InputError as error:
        return [], str(error)
    return found, ""


def _mass_matrix(tree: ModelTree, displacement: Array) -> Array:
    """Return M (n, n) at displacements (n,) of its rates; raises InputError where the tree is singular."""
    scene = tree.scene
    q = scene.q0.copy()
    for (_, number), at, rates in zip(tree.joints, scene.coordinate_slices, scene.rate_slices, strict=True):
        moved = displacement[rates]
        if number >= 0:
            q[at] = moved if len(moved) == 1 else exp_quaternion(moved)
    try:
        return tree_dynamics(scene, q, np.zeros(len(scene.u0))).mass_matrix
    except ArithmeticError:
        raise InputError("its M is singular or out of range at a random configuration") from None


def _pair(
    tree: ModelTree,
    places: Mapping[tuple[str, int], tuple[int, int]],
    held: HeldJoints,
    found: Sequence[MassMatrices],
) -> _Pair:
    """Return the matrices of a tree and of the importer; raises InputError where it lacks a joint of it."""
    labels, rows, columns, of = [], list[int](), list[int](), None
    scene, base = tree.scene, list[int]()
    for (link, number), rates in zip(tree.joints, scene.rate_slices, strict=True):
        own = list(range(rates.start, rates.stop))
        if number < 0:
            base = own
            continue
        place = places.get((link, number))
        of = of or next((one for one in found if place in one.columns), None)
        its = [k for k, one in enumerate([] if of is None else of.columns) if one == place]
        if len(its) != len(own):
            raise InputError(f"a joint of {link!r:.60} is not in the mass matrix of the importer")
        rows, columns = rows + own, columns + its
        labels += [(link, number)] * len(own)
    assert of is not None
    root = of.columns[columns[0]][0]
    while held.links[root].parent >= 0:
        root = held.links[root].parent
    its_base = [k for k, (link, _) in enumerate(of.columns) if link == root and k not in columns]
    pair = _Pair(labels, [], [], [])
    for displacement, M in zip(of.displacements, of.values, strict=True):
        moved = np.zeros(len(scene.u0))
        moved[rows] = displacement[columns]
        exact_M = _mass_matrix(tree, moved)
        both = bool(base and its_base)
        pair.stated.extend(_of_joints(exact_M, rows, base if both else []))
        pair.held.extend(_of_joints(M, columns, its_base if both else []))
        pair.scales.extend([np.sqrt(np.diagonal(exact_M)[rows])] * (1 + both))
    return pair


def _of_joints(M: Array, joints: list[int], base: list[int]) -> Iterator[Array]:
    """Yield M_jj and, if the base is free, M_jj - M_jb M_bb^-1 M_bj: neither depends on the base's axes."""
    own = M[np.ix_(joints, joints)]
    yield own
    if base:
        across = M[np.ix_(base, joints)]
        try:
            yield own - across.T @ np.linalg.solve(M[np.ix_(base, base)], across)
        except np.linalg.LinAlgError:
            raise InputError("the base has no inertia") from None


def _cause(model: ModelFile, pairs: Sequence[_Pair], held: HeldJoints, found: Sequence[MassMatrices]) -> str:
    """Return why matrices differ, by trying each known fault."""
    try:
        if _explained_by_held(model.path, held, found):
            return FOLLOWS
    except InputError:
        return "the bodies and joints that it holds make no regular tree"
    for pair in pairs:
        n = len(pair.joints)
        for a, b in combinations(range(n), 2):
            order = list(range(n))
            order[a], order[b] = b, a
            if pair.worst(lambda M, order=order: M[np.ix_(order, order)])[0] <= SINGLE:  # type: ignore[misc]
                which = names([_name(model, pair.joints[k]) for k in (a, b)])
                return f"joint order: the rates of {which} exchanged"
    return "not that of the bodies and joints that it holds"


def _name(model: ModelFile, joint: tuple[str, int]) -> str:
    link, number = joint
    return model.by_name[link].joints[number].name or f"joint of {link}"


def _explained_by_held(path: Path, held: HeldJoints, found: Sequence[MassMatrices]) -> bool:
    """Return whether an importer's matrices are those of its numbers; raises InputError if it has no tree."""
    links = []
    frames = [Frame(exact(one.rotation), exact(one.position_m)) for one in held.links]
    for index, link in enumerate(held.links):
        here = frames[index] if link.parent < 0 else frames[link.parent].inverse() @ frames[index]
        body = ExactInertia(mp.mpf(link.mass), exact(link.centre_m), exact(link.inertia_kg_m2))
        parent = None if link.parent < 0 else str(link.parent)
        joints = link.joints or (StatedJoint("", "fixed", 0),)
        links.append(
            ModelLink(
                str(index),
                0,
                path,
                parent,
                here,
                joints[0] if len(joints) == 1 else None,
                StatedInertia(0, body, Frame.of()),
                several=joints if len(joints) > 1 else (),
            )
        )
    model = ModelFile(path, "mjcf", tuple(links))
    places = {
        (str(index), k): (index, k) for index, link in enumerate(held.links) for k in range(len(link.joints))
    }
    return all(_pair(tree, places, held, found).worst()[0] <= SINGLE for tree in model_trees(model))
