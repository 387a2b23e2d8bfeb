"""A recording of a tree: its columns `body.NAME.x_m`, `joint.NAME.q_rad` ... compared with the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number, suggestion
from bodycheck.examine.diagnosis.diagnosis import Diagnosis
from bodycheck.recordings.formats import read_recording
from bodycheck.recordings.resolution import digits_of
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_bodies import tree_trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.measurement.measure_bounds import FLOOR_BOUNDS
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.trajectory_files import COLUMNS, read_arrays, state_columns, tree_table
from bodycheck.reports.table_layout import Column
from bodycheck.scenarios.tree_model import TreeScenario

_UNITS = {
    "quaternion": ("rad", "orientation", "bound_rad"),
    "position_m": ("m", "position", "bound_m"),
    "velocity_m_s": ("m/s", "velocity", "bound_m_s"),
    "omega_body_rad_s": ("rad/s", "angular velocity, body axes", "bound_omega_rad_s"),
    "omega_world_rad_s": ("rad/s", "angular velocity, world axes", "bound_omega_rad_s"),
}
"""Quantity of a body -> unit and words of its error, and the bound of the truth."""


@dataclass(frozen=True)
class TreeError:
    """The largest difference of one quantity from the truth, when, and what truth and digits leave open."""

    name: str
    quantity: str
    error: float
    unit: str
    at_s: float
    floor: float

    @property
    def is_wrong(self) -> bool:
        """Whether it differs from the truth by more than can be open."""
        return self.error > self.floor


@dataclass(frozen=True)
class JudgedTree:
    """The errors of a recording, the largest first among those of joints and of bodies, and its diagnosis."""

    path: Path
    errors: tuple[TreeError, ...]
    diagnosis: Diagnosis | None


def judged_tree(
    path: Path, tree: TreeScenario, spec: str, dt_s: float | None, cache: Cache | None
) -> JudgedTree:
    """Compare the columns of a file with the truth at its times.

    dt_s: the step of the program that wrote it, with which its cause is named. Raises InputError where the
    file has no column of the tree, or others, or times outside the scenario.
    """
    scene = tree.scene
    columns = _columns(path, scene)
    t_s = columns.get("t_s")
    if t_s is None or len(t_s) < 1 or np.any(np.diff(t_s) <= 0.0) or not 0.0 <= t_s[0] <= t_s[-1]:
        raise InputError(f"{path}: t_s: needs ascending times in s from 0 on")
    if t_s[-1] > scene.duration_s * (1.0 + 1e-9):
        raise InputError(
            f"{path}: t_s ends at {float(t_s[-1])!r} s, after the scenario, at {scene.duration_s!r} s"
        )
    truth = known_truth(scene, t_s, cache)
    trusted = t_s < truth.trusted_until_s
    if not trusted[0]:
        raise InputError(f"{path}: the truth ends before the first time in t_s: {truth.end_reason}")
    table = tree_table(scene, truth.trajectory)
    right = {str(name): table[name].to_numpy() for name in table.columns}
    own = {name: v for name, v in columns.items() if name != "t_s" and not name.startswith("bound_")}
    for name in own:
        if name not in right:
            raise InputError(f"{path}: {name}: no column of this tree{suggestion(name, right)}")
    if not own:
        raise InputError(f"{path}: has no column of the tree, such as {[*right][1]}")
    bounds = {kind: getattr(truth, kind) for _, _, kind in _UNITS.values()}
    errors = tuple(_errors(own, right, t_s, trusted, bounds))
    return JudgedTree(path, errors, _cause(tree, spec, own, t_s, dt_s, cache))


def _columns(path: Path, scene: TreeScene) -> dict[str, Array]:
    """Return the columns of a file; the arrays (n, bodies, ...) that a run stores have those of `truth`."""
    recording = read_recording(path, "")
    if "position_m[0][0]" not in recording.names:
        return {name: recording.values(name) for name in recording.names}
    arrays = read_arrays(path)
    shapes = {"position_m": (len(scene.bodies), 3), "q": scene.q0.shape, "u": scene.u0.shape}
    for name, shape in shapes.items():
        held = arrays[name].shape[1:] if name in arrays else None
        if held != shape:
            raise InputError(f"{path}: {name} has {held or 'no values'} per sample, not {shape} as this tree")
    table = tree_table(scene, Trajectory(**arrays))
    return {str(name): table[name].to_numpy() for name in table.columns}


def _errors(
    own: Mapping[str, Array],
    right: Mapping[str, Array],
    t_s: Array,
    trusted: np.ndarray[Any, np.dtype[np.bool_]],
    bounds: Mapping[str, Array],
) -> Iterator[TreeError]:
    for names, whose, unit, words, bound in _quantities(own):
        found, exact = (np.column_stack([table[name] for name in names]) for table in (own, right))
        if len(names) == 4:
            sizes = geodesic_angle(found, exact)
        else:
            difference = found - exact
            if unit == "rad":
                difference -= 2.0 * np.pi * np.round(difference / (2.0 * np.pi))
            sizes = np.linalg.norm(difference, axis=1)
        sizes = np.where(trusted, sizes, 0.0)
        worst = int(np.argmax(sizes))
        spacing = max(_spacing(own[name]) for name in names)
        floor = FLOOR_BOUNDS * float(np.max(bounds[bound][trusted])) + spacing * len(names)
        yield TreeError(whose, words, float(sizes[worst]), unit, float(t_s[worst]), floor)


def _quantities(own: Mapping[str, Array]) -> Iterator[tuple[list[str], str, str, str, str]]:
    """Yield the columns of each quantity, whose it is, and its unit, words and bound."""
    heads = dict.fromkeys(name.rpartition(".")[0] for name in own)
    for head in heads:
        kind, _, name = head.partition(".")
        if kind == "body":
            for quantity, (unit, words, bound) in _UNITS.items():
                columns = [f"{head}.{column}" for column in COLUMNS[quantity]]
                if all(column in own for column in columns):
                    yield columns, f"body {name}", unit, words, bound
            continue
        ball = [f"{head}.{column}" for column in COLUMNS["quaternion"]]
        spins = [f"{head}.rate_{axis}" for axis in "xyz"]
        for columns, unit, words, bound in (
            ([f"{head}.q_rad"], "rad", "angle", "bound_rad"),
            ([f"{head}.q_m"], "m", "distance", "bound_m"),
            (ball, "rad", "orientation", "bound_rad"),
            ([f"{head}.rate"], "m/s" if f"{head}.q_m" in own else "rad/s", "rate", "bound_omega_rad_s"),
            (spins, "rad/s", "rate", "bound_omega_rad_s"),
        ):
            if all(column in own for column in columns):
                yield columns, f"joint of {name}", unit, words, bound


def _spacing(values: Array) -> float:
    """Return half the spacing of the numbers that a column states."""
    digits = digits_of(values)
    return 0.0 if digits is None else 0.5 * digits.spacing(float(np.max(np.abs(values))))


def _cause(
    tree: TreeScenario,
    spec: str,
    own: Mapping[str, Array],
    t_s: Array,
    dt_s: float | None,
    cache: Cache | None,
) -> Diagnosis | None:
    """Return what explains a complete motion at the samples of the scenario; None for any other."""
    scene = tree.scene
    motion = _complete(scene, own, t_s)
    if motion is None or dt_s is None or len(t_s) != scene.samples:
        return None
    if not np.allclose(t_s, scene.sample_times, rtol=0.0, atol=1e-9 * scene.duration_s):
        return None
    from bodycheck.examine.dynamics.tree_motion_diagnosis import diagnosed_tree  # imports numba

    return diagnosed_tree(scene, motion, Problem.of(tree, spec, cache).scales, dt_s)


def _complete(scene: TreeScene, own: Mapping[str, Array], t_s: Array) -> Trajectory | None:
    """Return the motion if the file has all coordinates and rates, else None."""
    q, u = [], []
    for body in scene.bodies:
        places, rates = state_columns(body)
        if not all(name in own for name in (*places, *rates)):
            return None
        q += [own[name] for name in places]
        u += [own[name] for name in rates]
    return tree_trajectory(scene, t_s, np.column_stack(q), np.column_stack(u))


def tree_judgement(found: JudgedTree) -> Document:
    """Return the conclusion, the cause where one was sought, and one row per quantity."""
    wrong = [one for one in found.errors if one.is_wrong]
    joints = [one for one in wrong if one.name.startswith("joint")]
    if not wrong:
        text = "the motion is the truth, to the digits of the file and the bound of the truth"
        first = Sentence(f"{found.path}: {text}", "good", strong=True)
    else:
        worst = max(joints or wrong, key=lambda one: one.error if one.unit in ("rad", "m") else 0.0)
        off = f"{number(worst.error, 3)} {worst.unit} off at {number(worst.at_s, 4)} s"
        text = f"{found.path}: the {worst.quantity} of the {worst.name} is {off}, the largest error"
        first = Sentence(text + " of a joint" * bool(joints), "bad", strong=True)
    cause = () if found.diagnosis is None else (Sentence(f"cause: {found.diagnosis.sentence}"),)
    heads = (Column("of", "name"), Column("error of"), Column("largest", "number"), Column("unit"))
    rows = tuple(
        (one.name, one.quantity, number(one.error, 3), one.unit, f"{number(one.at_s, 4)} s")
        for one in found.errors
    )
    table = Table((*heads, Column("at", "fixed")), rows, "Largest errors")
    return Document("bodycheck judge", (first, *cause, table))


def tree_judgement_data(found: JudgedTree) -> dict[str, Any]:
    """Return the same as data."""
    cause = None if found.diagnosis is None else found.diagnosis.sentence
    rows = [{**vars(one), "is_wrong": one.is_wrong} for one in found.errors]
    return {"file": str(found.path), "errors": rows, "cause": cause}
