"""Faults of loads: their sizes, axes, points and times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import vee
from bodycheck.reference_impl.scene import PointForce
from bodycheck.reports.diagnosis.engine_model import Loads, Model
from bodycheck.reports.diagnosis.faults.fault import (
    FACTOR,
    Changed,
    Fault,
    FaultContext,
    Plant,
    assigned,
    changed_loads,
    constant,
    near,
)


def _frozen(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    turned = loads.torque_body @ at.scene.initial.rotation.T
    return {"torque_body": 0.0 * loads.torque_body, "torque_world": loads.torque_world + turned}


def _arms_turned(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {"moment": np.einsum("ji,pjk->pik", at.scene.initial.rotation, loads.moment)}


def _forces_swapped(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {"force_body": loads.force_world, "force_world": loads.force_body}


def _body_forces_in_world_axes(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    # the moment a x F of a body force, with F in world axes, needs a F^T, which the lever lacks
    forces = [load for load in at.scene.loads if isinstance(load, PointForce) and load.axes == "body"]
    sums = sum((np.outer(load.at, load.value) for load in forces), np.zeros((3, 3)))
    total = sum((load.value for load in forces), np.zeros(3))
    share = (loads.force_body @ total) / max(float(total @ total), 1e-300)
    return {
        "moment": loads.moment + share[:, None, None] * sums,
        "lever": 0.0 * loads.lever,
        "force_world": loads.force_world + loads.force_body,
        "force_body": 0.0 * loads.force_body,
    }


def _world_forces_in_body_axes(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {
        "lever": loads.lever - 2.0 * vee(loads.moment),
        "moment": 0.0 * loads.moment,
        "force_body": loads.force_body + loads.force_world,
        "force_world": 0.0 * loads.force_world,
    }


def _shifted(steps: int) -> Plant:
    def plant(model: Model, values: Array, at: FaultContext) -> None:
        line, none = model.timeline, len(model.loads.torque_body) - 1
        model.timeline = np.concatenate([np.full(steps, none), line[:-steps]])

    return plant


def _first_step_free(model: Model, values: Array, at: FaultContext) -> None:
    line = model.timeline.copy()
    line[0] = len(model.loads.torque_body) - 1
    model.timeline = line


def _released_late(model: Model, values: Array, at: FaultContext) -> None:
    """Let each segment but the first begin a step late, where the one before it has loads."""
    line = model.timeline
    parts = (
        model.loads.force_body,
        model.loads.force_world,
        model.loads.torque_body,
        model.loads.torque_world,
    )
    loaded = np.array([any(np.any(part[row]) for part in parts) for row in range(len(parts[0]))])
    delayed = line.copy()
    starts = np.flatnonzero(line[1:] != line[:-1]) + 1
    for index in starts:
        if loaded[line[index - 1]]:
            delayed[index] = line[index - 1]
    model.timeline = delayed


def _never_cleared(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    """Return each segment's loads with those of all earlier segments."""
    return {
        name: np.concatenate([np.cumsum(part[:-1], axis=0), part[-1:]]) for name, part in vars(loads).items()
    }


def _prolonged(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    """Return the loads with those of the segment before it in each segment without loads."""
    parts = {name: part.copy() for name, part in vars(loads).items()}
    for row in range(1, len(loads.torque_body) - 1):
        if not any(np.any(part[row]) for part in vars(loads).values()):
            for part in parts.values():
                part[row] = part[row - 1]
    return parts


_ALL_LOADS = ("force_body", "force_world", "torque_body", "torque_world", "lever", "moment")


def _factor_texts(noun: str) -> tuple[tuple[float, str], ...]:
    return (
        (0.0, f"{noun} is missing"),
        (2.0, f"{noun} is applied twice"),
        (-1.0, f"{noun} has the opposite sign"),
    )


_LOAD_ALONE = "apply the load alone to a body at rest, and compare the momentum gained with its impulse"


def _scaled(
    name: str,
    sentence: str,
    parts: Sequence[str],
    applies: Callable[[FaultContext], bool],
    special: tuple[tuple[float, str], ...] = (),
) -> Fault:
    """Return the fault that parts of the loads are multiplied by a factor."""
    plant = changed_loads(lambda held, s, _: {part: s[0] * getattr(held, part) for part in parts})
    return Fault(name, "loads", sentence, plant, (FACTOR,), near(1.0), applies, special, confirm=_LOAD_ALONE)


def load_faults() -> Iterator[Fault]:
    """Yield the faults of loads."""
    yield _scaled(
        "torque",
        "torques are multiplied by {0}",
        ("torque_body", "torque_world"),
        lambda at: at.has_torque,
        _factor_texts("the torque"),
    )
    yield Fault(
        "torque-body-as-world",
        "loads",
        "a torque in body axes acts in world axes",
        changed_loads(
            lambda h, _, __: {
                "torque_body": 0.0 * h.torque_body,
                "torque_world": h.torque_world + h.torque_body,
            }
        ),
        applies=lambda at: "torque_body" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "torque-world-as-body",
        "loads",
        "a torque in world axes acts in body axes",
        changed_loads(
            lambda h, _, __: {
                "torque_body": h.torque_body + h.torque_world,
                "torque_world": 0.0 * h.torque_world,
            }
        ),
        applies=lambda at: "torque_world" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "torque-frozen",
        "loads",
        "a torque in body axes keeps its initial direction in world axes",
        changed_loads(_frozen),
        applies=lambda at: "torque_body" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield _scaled(
        "moment",
        "the moments of forces are multiplied by {0}",
        ("lever", "moment"),
        lambda at: at.has_moment,
        (
            (0.0, "forces act at the centre of mass, not at their points"),
            (-1.0, "the moment of a force is F x r instead of r x F"),
        ),
    )
    yield _scaled(
        "force",
        "forces are multiplied by {0}",
        ("force_body", "force_world", "lever", "moment"),
        lambda at: at.has_force,
        _factor_texts("the force"),
    )
    yield _scaled(
        "force-without-moment",
        "forces are multiplied by {0}, their moments are right",
        ("force_body", "force_world"),
        lambda at: at.has_force and at.has_moment and at.shows_translation,
        ((0.0, "forces have moments, but do not push the centre of mass"),),
    )
    yield _scaled(
        "torque-and-moment",
        "torques and the moments of forces are multiplied by {0}",
        ("torque_body", "torque_world", "lever", "moment"),
        lambda at: at.has_torque and at.has_moment,
        _factor_texts("every torque"),
    )
    yield _scaled(
        "all-loads",
        "all loads except gravity are multiplied by {0}",
        _ALL_LOADS,
        lambda at: at.has_torque and at.has_force,
        ((2.0, "all loads are applied twice"), (0.0, "all loads except gravity are missing")),
    )
    yield from _applied_faults()
    for axes in ("body", "world"):
        moment = "lever" if axes == "body" else "moment"
        yield _scaled(
            f"force-{axes}",
            f"forces in {axes} axes are multiplied by {{0}}",
            (f"force_{axes}", moment),
            lambda at: {"force_body", "force_world"} <= at.loads,
            _factor_texts(f"the force in {axes} axes"),
        )
        yield _scaled(
            f"moment-{axes}",
            f"the moments of forces in {axes} axes are multiplied by {{0}}",
            (moment,),
            lambda at: {"lever", "moment"} <= at.loads,
            (
                (0.0, f"the force in {axes} axes acts at the centre of mass, not at its point"),
                (-1.0, f"the moment of the force in {axes} axes is F x r instead of r x F"),
            ),
        )
        yield _scaled(
            f"force-{axes}-without-moment",
            f"forces in {axes} axes are multiplied by {{0}}, their moments are right",
            (f"force_{axes}",),
            lambda at: {"force_body", "force_world"} <= at.loads and at.shows_translation,
        )
        yield _scaled(
            f"torque-{axes}",
            f"torques in {axes} axes are multiplied by {{0}}",
            (f"torque_{axes}",),
            lambda at: {"torque_body", "torque_world"} <= at.loads,
            _factor_texts(f"the torque in {axes} axes"),
        )
    yield Fault(
        "force-body-as-world",
        "loads",
        "a force in body axes acts in world axes, its moment is right",
        changed_loads(
            lambda h, _, __: {"force_body": 0.0 * h.force_body, "force_world": h.force_world + h.force_body}
        ),
        applies=lambda at: "force_body" in at.loads and at.shows_translation,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-world-as-body",
        "loads",
        "a force in world axes acts in body axes, its moment is right",
        changed_loads(
            lambda h, _, __: {"force_body": h.force_body + h.force_world, "force_world": 0.0 * h.force_world}
        ),
        applies=lambda at: "force_world" in at.loads and at.shows_translation,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-axes-exchanged",
        "loads",
        "forces act in the other axes, their moments are right",
        changed_loads(_forces_swapped),
        applies=lambda at: {"force_body", "force_world"} <= at.loads and at.shows_translation,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-body-in-wrong-axes",
        "loads",
        "a force in body axes acts in world axes, and its moment too",
        changed_loads(_body_forces_in_world_axes),
        applies=lambda at: "force_body" in at.loads and at.has_moment,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-world-in-wrong-axes",
        "loads",
        "a force in world axes acts in body axes, and its moment too",
        changed_loads(_world_forces_in_body_axes),
        applies=lambda at: "force_world" in at.loads and at.has_moment,
        confirm=_LOAD_ALONE,
    )
    yield from _rotated_wrongly()
    yield Fault(
        "arm-in-world-axes",
        "loads",
        "the point of a world force is an offset in world axes, not in body axes",
        constant(arm_in_world=1.0),
        applies=lambda at: "moment" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "arm-frozen",
        "loads",
        "the point of a world force does not rotate with the body",
        constant(arm_in_world=2.0),
        applies=lambda at: "moment" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "arm-rotated",
        "loads",
        "the point of a world force is taken as an offset in world axes at the start",
        changed_loads(_arms_turned),
        applies=lambda at: "moment" in at.loads,
        confirm=_LOAD_ALONE,
    )
    for steps in (1, 2):
        word = "one step" if steps == 1 else "two steps"
        yield Fault(
            f"load-late-{steps}",
            "loads",
            f"each load begins and ends {word} late",
            _shifted(steps),
            applies=lambda at: at.stepped and bool(at.loads),
            confirm="halve the step: the delay must halve",
        )
    yield Fault(
        "load-early",
        "loads",
        "each load begins and ends one step early",
        Changed("timeline", lambda line, _: np.concatenate([line[1:], line[-1:]])),
        applies=lambda at: at.stepped and at.switches,
        confirm="halve the step: the lead must halve",
    )
    yield Fault(
        "release-late",
        "loads",
        "each load ends one step late",
        _released_late,
        applies=lambda at: at.stepped and at.switches,
        confirm="halve the step: the delay must halve",
    )
    yield Fault(
        "first-step-free",
        "loads",
        "no load acts in the first step",
        _first_step_free,
        applies=lambda at: at.stepped and bool(at.loads),
        confirm="halve the step: the error must halve",
    )
    yield Fault(
        "load-never-cleared",
        "loads",
        "loads are added to the previous ones and never cleared",
        changed_loads(_never_cleared),
        applies=lambda at: at.switches,
        confirm="end the load and wait: momentum must be constant",
    )
    yield Fault(
        "load-held-on",
        "loads",
        "a load continues after its end",
        changed_loads(_prolonged),
        applies=lambda at: at.switches,
        confirm="end the load and wait: momentum must be constant",
    )
    yield Fault(
        "load-accumulates",
        "loads",
        "loads are applied again in each step and never cleared",
        constant(ramp=1.0),
        applies=lambda at: at.stepped and bool(at.loads),
        confirm="apply a constant load: momentum must grow with the time, not with its square",
    )
    yield Fault(
        "continuous-loads",
        "loads",
        "continuous loads are multiplied by {0}",
        assigned("continuous"),
        (FACTOR,),
        near(1.0),
        lambda at: bool(at.scene.continuous_loads),
        _factor_texts("the continuous load"),
        confirm=_LOAD_ALONE,
    )


def _rotated_wrongly() -> Iterator[Fault]:
    """Yield faults of loads that are rotated by the transpose of R, or twice."""
    right = ", its moment is right"
    kinds: tuple[tuple[str, str, dict[str, float], Callable[[FaultContext], bool]], ...] = (
        (
            "force-body-by-transpose",
            f"a force in body axes is rotated by the transpose: it acts as R^T F, not R F{right}",
            {"force_body_by": 1.0},
            lambda at: "force_body" in at.loads and at.shows_translation,
        ),
        (
            "force-body-rotated-twice",
            f"a force in body axes is rotated twice: it acts as R R F{right}",
            {"force_body_by": 2.0},
            lambda at: "force_body" in at.loads and at.shows_translation,
        ),
        (
            "force-world-by-transpose",
            f"a force in world axes acts as R^T F{right}",
            {"force_world_by": 1.0},
            lambda at: "force_world" in at.loads and at.shows_translation,
        ),
        (
            "force-world-rotated-twice",
            f"a force in world axes acts as R R F{right}",
            {"force_world_by": 2.0},
            lambda at: "force_world" in at.loads and at.shows_translation,
        ),
        (
            "force-world-to-body-by-transpose",
            "a force in world axes is taken into body axes by R, not R^T: it acts as R R F, its moment too",
            {"force_world_by": 2.0, "moment_by": 1.0},
            lambda at: "moment" in at.loads and at.shows_translation,
        ),
        (
            "moment-by-transpose",
            "the moment of a force in world axes is r x R F in body axes, not r x R^T F",
            {"moment_by": 1.0},
            lambda at: "moment" in at.loads,
        ),
        (
            "torque-world-by-transpose",
            "a torque in world axes is taken into body axes by R, not R^T",
            {"torque_world_by": 1.0},
            lambda at: "torque_world" in at.loads,
        ),
        (
            "torque-world-rotated-twice",
            "a torque in world axes is taken into body axes by R^T twice",
            {"torque_world_by": 2.0},
            lambda at: "torque_world" in at.loads,
        ),
        (
            "torque-body-rotated",
            "a torque in body axes is rotated by R",
            {"torque_body_by": 1.0},
            lambda at: "torque_body" in at.loads,
        ),
        (
            "torque-body-rotated-twice",
            "a torque in body axes is rotated by R^T twice",
            {"torque_body_by": 2.0},
            lambda at: "torque_body" in at.loads,
        ),
    )
    for name, sentence, changes, applies in kinds:
        confirm = "start from an attitude other than identity, and apply the load alone"
        yield Fault(name, "loads", sentence, constant(**changes), applies=applies, confirm=confirm)


def _applied_faults() -> Iterator[Fault]:
    """Yield faults of the torque in body axes as an adapter applies it, with the moments of body forces."""
    yield _scaled(
        "applied-torque",
        "torques are multiplied by {0}, the moments of body forces too",
        ("torque_body", "torque_world", "lever"),
        lambda at: at.has_torque and "lever" in at.loads,
        _factor_texts("every torque in body or world axes"),
    )
    yield Fault(
        "applied-torque-body-as-world",
        "loads",
        "a torque in body axes, and the moment of a body force, acts in world axes",
        changed_loads(
            lambda h, _, __: {
                "torque_body": 0.0 * h.torque_body,
                "lever": 0.0 * h.lever,
                "torque_world": h.torque_world + h.torque_body + h.lever,
            }
        ),
        applies=lambda at: "lever" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "applied-torque-frozen",
        "loads",
        "a torque in body axes, and the moment of a body force, keeps its initial direction in world axes",
        changed_loads(
            lambda h, values, at: {
                **_frozen(replace(h, torque_body=h.torque_body + h.lever), values, at),
                "lever": 0.0 * h.lever,
            }
        ),
        applies=lambda at: "lever" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield _scaled(
        "applied-moment",
        "the torque in body axes and the moments of forces are multiplied by {0}",
        ("torque_body", "lever", "moment"),
        lambda at: {"torque_body", "lever"} <= at.loads,
        (
            (0.0, "torques in body axes and moments are missing"),
            (-1.0, "torques in body axes and moments have the opposite sign"),
        ),
    )
    yield _scaled(
        "applied-force",
        "forces and the torque in body axes are multiplied by {0}",
        ("force_body", "force_world", "torque_body", "lever", "moment"),
        lambda at: {"torque_body", "lever"} <= at.loads,
    )
    yield _scaled(
        "applied-force-without-lever",
        "forces are multiplied by {0}, the moments of body forces are right",
        ("force_body", "force_world", "moment"),
        lambda at: {"lever", "moment"} <= at.loads and at.shows_translation,
        ((0.0, "forces do not push the centre of mass, and world forces have no moment"),),
    )
