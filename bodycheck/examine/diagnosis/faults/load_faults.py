"""Faults of loads: their sizes, axes, points and times."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from bodycheck.examine.diagnosis.engine_model import Loads, Model
from bodycheck.examine.diagnosis.faults.fault import (
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
from bodycheck.reference_impl.arrays import Array


def _frozen(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    turned = loads.torque_body @ at.scene.initial.rotation.T
    return {"torque_body": 0.0 * loads.torque_body, "torque_world": loads.torque_world + turned}


def _applied_as_world(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {
        "torque_world": loads.torque_world + loads.torque_body + loads.lever_torque,
        "torque_body": 0.0 * loads.torque_body,
        "lever": 0.0 * loads.lever,
    }


def _wrench_as_world(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    force = {"force_body": 0.0 * loads.force_body, "force_world": loads.force_world + loads.force_body}
    return _applied_as_world(loads, values, at) | force


def _arms_turned(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {"moment": np.einsum("ji,pjk->pik", at.scene.initial.rotation, loads.moment)}


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


_LOAD_ALONE = "apply the load alone to a body at rest, and compare the momentum gained with its impulse"
_OTHER_ATTITUDE = "start from an attitude other than identity, and apply the load alone"
_END_LOAD = "end the load and wait: momentum must be constant"
_HALVE = "halve the step: the {} must halve"

_Applies: TypeAlias = Callable[[FaultContext], bool]
_Texts: TypeAlias = tuple[tuple[float, str], ...]


def _has(*parts: str, moving: bool = False) -> _Applies:
    """Return whether all these parts of the loads act; moving: and the trajectory shows the translation."""
    return lambda at: set(parts) <= at.loads and (at.shows_translation or not moving)


def _stepped(at: FaultContext) -> bool:
    return at.stepped and bool(at.loads)


def _staged(at: FaultContext) -> bool:
    """Return whether loads change within a step of the method, which evaluates them more than once."""
    turning = at.loads & {"force_body", "torque_world", "moment"} or (at.has_gravity and not at.is_free)
    return at.stepped and at.base.order > 1 and bool(turning or at.scene.continuous_loads)


def _switched(at: FaultContext) -> bool:
    return at.stepped and at.switches


def _moved(**to: str) -> Plant:
    """Return what adds each part of the loads to another one, part=other, and leaves none of it."""

    def change(held: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
        total = {other: getattr(held, other) + getattr(held, part) for part, other in to.items()}
        return {part: 0.0 * getattr(held, part) for part in to} | total

    return changed_loads(change)


def _load(name: str, sentence: str, plant: Plant, applies: _Applies, confirm: str = _LOAD_ALONE) -> Fault:
    """Return a fault without parameters."""
    return Fault(name, "loads", sentence, plant, applies=applies, confirm=confirm)


def _scaled(name: str, sentence: str, parts: str, applies: _Applies, special: _Texts = ()) -> Fault:
    """Return the fault that parts of the loads, separated by blanks, are multiplied by a factor."""
    names = parts.split()
    plant = changed_loads(lambda held, s, _: {part: s[0] * getattr(held, part) for part in names})
    return Fault(name, "loads", sentence, plant, (FACTOR,), near(1.0), applies, special, confirm=_LOAD_ALONE)


def _factor_texts(noun: str) -> _Texts:
    return (
        (0.0, f"{noun} is missing"),
        (2.0, f"{noun} is applied twice"),
        (-1.0, f"{noun} has the opposite sign"),
    )


def _moment_texts(force: str, at_centre: str) -> _Texts:
    return (0.0, at_centre), (-1.0, f"the moment of {force} is F x r instead of r x F")


def load_faults() -> Iterator[Fault]:
    """Yield the faults of loads."""
    torques, forces = "torque_body torque_world", "force_body force_world"
    yield _scaled(
        "torque",
        "torques are multiplied by {0}",
        torques,
        lambda at: at.has_torque,
        _factor_texts("the torque"),
    )
    text = "a torque in body axes acts in world axes"
    yield _load("torque-body-as-world", text, _moved(torque_body="torque_world"), _has("torque_body"))
    text = "a torque in world axes acts in body axes"
    yield _load("torque-world-as-body", text, _moved(torque_world="torque_body"), _has("torque_world"))
    text = "a torque in body axes keeps its initial direction in world axes"
    yield _load("torque-frozen", text, changed_loads(_frozen), _has("torque_body"))
    special = _moment_texts("a force", "forces act at the centre of mass, not at their points")
    yield _scaled(
        "moment",
        "the moments of forces are multiplied by {0}",
        "lever moment",
        lambda at: at.has_moment,
        special,
    )
    yield _scaled(
        "force",
        "forces are multiplied by {0}",
        f"{forces} lever moment",
        lambda at: at.has_force,
        _factor_texts("the force"),
    )
    yield _scaled(
        "force-without-moment",
        "forces are multiplied by {0}, their moments are right",
        forces,
        lambda at: at.has_force and at.has_moment and at.shows_translation,
        ((0.0, "forces have moments, but do not push the centre of mass"),),
    )
    yield _scaled(
        "torque-and-moment",
        "torques and the moments of forces are multiplied by {0}",
        f"{torques} lever moment",
        lambda at: at.has_torque and at.has_moment,
        _factor_texts("every torque"),
    )
    yield _scaled(
        "all-loads",
        "all loads except gravity are multiplied by {0}",
        f"{forces} {torques} lever moment",
        lambda at: at.has_torque and at.has_force,
        ((2.0, "all loads are applied twice"), (0.0, "all loads except gravity are missing")),
    )
    yield from _applied_faults()
    for axes, moment in (("body", "lever"), ("world", "moment")):
        force, both = f"force_{axes}", _has("force_body", "force_world")
        special = _factor_texts(f"the force in {axes} axes")
        yield _scaled(
            f"force-{axes}",
            f"forces in {axes} axes are multiplied by {{0}}",
            f"{force} {moment}",
            both,
            special,
        )
        special = _moment_texts(
            f"the force in {axes} axes",
            f"the force in {axes} axes acts at the centre of mass, not at its point",
        )
        text = f"the moments of forces in {axes} axes are multiplied by {{0}}"
        yield _scaled(f"moment-{axes}", text, moment, _has("lever", "moment"), special)
        text = f"forces in {axes} axes are multiplied by {{0}}, their moments are right"
        moving = _has("force_body", "force_world", moving=True)
        yield _scaled(f"force-{axes}-without-moment", text, force, moving)
        yield _scaled(
            f"torque-{axes}",
            f"torques in {axes} axes are multiplied by {{0}}",
            f"torque_{axes}",
            _has("torque_body", "torque_world"),
            _factor_texts(f"the torque in {axes} axes"),
        )
    for name, sentence, plant, applies in (
        (
            "force-body-as-world",
            "a force in body axes acts in world axes, its moment is right",
            _moved(force_body="force_world"),
            _has("force_body", moving=True),
        ),
        (
            "force-world-as-body",
            "a force in world axes acts in body axes, its moment is right",
            _moved(force_world="force_body"),
            _has("force_world", moving=True),
        ),
        (
            "force-axes-exchanged",
            "forces act in the other axes, their moments are right",
            changed_loads(lambda h, _, __: {"force_body": h.force_world, "force_world": h.force_body}),
            _has("force_body", "force_world", moving=True),
        ),
        (
            "force-body-in-wrong-axes",
            "a force in body axes acts in world axes, and its moment too",
            _moved(force_body="force_world", lever="moment"),
            lambda at: "force_body" in at.loads and at.has_moment,
        ),
        (
            "force-world-in-wrong-axes",
            "a force in world axes acts in body axes, and its moment too",
            _moved(force_world="force_body", moment="lever"),
            lambda at: "force_world" in at.loads and at.has_moment,
        ),
    ):
        yield _load(name, sentence, plant, applies)
    yield from _rotated_wrongly()
    for name, sentence, plant in (
        (
            "arm-in-world-axes",
            "the point of a world force is an offset in world axes, not in body axes",
            constant(arm_in_world=1.0),
        ),
        (
            "arm-frozen",
            "the point of a world force does not rotate with the body",
            constant(arm_in_world=2.0),
        ),
        (
            "arm-rotated",
            "the point of a world force is taken as an offset in world axes at the start",
            changed_loads(_arms_turned),
        ),
    ):
        yield _load(name, sentence, plant, _has("moment"))
    text = "the point of a body force is an offset in world axes, not in body axes"
    yield _load("body-arm-in-world-axes", text, constant(body_arm_in_world=1.0), _has("lever"))
    yield from _timed_wrongly()
    text = "the loads are evaluated once per step, at its start, not in every stage"
    yield _load("loads-held", text, constant(held_loads=1.0), _staged, _HALVE.format("error"))
    text = "loads are applied again in each step and never cleared"
    confirm = "apply a constant load: momentum must grow with the time, not with its square"
    yield _load("load-accumulates", text, constant(ramp=1.0), _stepped, confirm)
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


def _timed_wrongly() -> Iterator[Fault]:
    """Yield faults of the times at which loads begin and end."""
    for steps, word in ((1, "one step"), (2, "two steps")):
        text = f"each load begins and ends {word} late"
        yield _load(f"load-late-{steps}", text, _shifted(steps), _stepped, _HALVE.format("delay"))
    early = Changed("timeline", lambda line, _: np.concatenate([line[1:], line[-1:]]))
    text = "each load begins and ends one step early"
    yield _load("load-early", text, early, _switched, _HALVE.format("lead"))
    text = "each load ends one step late"
    yield _load("release-late", text, _released_late, _switched, _HALVE.format("delay"))
    text = "no load acts in the first step"
    yield _load("first-step-free", text, _first_step_free, _stepped, _HALVE.format("error"))
    text = "loads are added to the previous ones and never cleared"
    plant = changed_loads(_never_cleared)
    yield _load("load-never-cleared", text, plant, lambda at: at.switches, _END_LOAD)
    text, plant = "a load continues after its end", changed_loads(_prolonged)
    yield _load("load-held-on", text, plant, lambda at: at.switches, _END_LOAD)


def _rotated_wrongly() -> Iterator[Fault]:
    """Yield faults of loads that are rotated by the transpose of R, or twice."""
    right = ", its moment is right"
    body, world = _has("force_body", moving=True), _has("force_world", moving=True)
    text = f"a force in body axes is rotated by the transpose: it acts as R^T F, not R F{right}"
    yield _turned("force-body-by-transpose", text, body, force_body_by=1.0)
    text = f"a force in body axes is rotated twice: it acts as R R F{right}"
    yield _turned("force-body-rotated-twice", text, body, force_body_by=2.0)
    text = f"a force in world axes acts as R^T F{right}"
    yield _turned("force-world-by-transpose", text, world, force_world_by=1.0)
    text = f"a force in world axes acts as R R F{right}"
    yield _turned("force-world-rotated-twice", text, world, force_world_by=2.0)
    name = "force-world-to-body-by-transpose"
    text = "a force in world axes is taken into body axes by R, not R^T: it acts as R R F, its moment too"
    yield _turned(name, text, _has("moment", moving=True), force_world_by=2.0, moment_by=1.0)
    text = "the moment of a force in world axes is r x R F in body axes, not r x R^T F"
    yield _turned("moment-by-transpose", text, _has("moment"), moment_by=1.0)
    body, world = _has("torque_body"), _has("torque_world")
    text = "a torque in world axes is taken into body axes by R, not R^T"
    yield _turned("torque-world-by-transpose", text, world, torque_world_by=1.0)
    text = "a torque in world axes is taken into body axes by R^T twice"
    yield _turned("torque-world-rotated-twice", text, world, torque_world_by=2.0)
    yield _turned("torque-body-rotated", "a torque in body axes is rotated by R", body, torque_body_by=1.0)
    text = "a torque in body axes is rotated by R^T twice"
    yield _turned("torque-body-rotated-twice", text, body, torque_body_by=2.0)
    wrench, body = (
        "forces and torques in body axes, with the moments of the forces,",
        _has("lever", moving=True),
    )
    text = f"{wrench} act in world axes"
    yield _load("wrench-body-as-world", text, changed_loads(_wrench_as_world), body, _OTHER_ATTITUDE)
    text = f"{wrench} are rotated by the transpose: they act as R^T F and R^T (r x F)"
    yield _turned("wrench-body-by-transpose", text, body, force_body_by=1.0, torque_body_by=2.0)
    text = f"{wrench} are rotated twice: they act as R R F and R R (r x F)"
    yield _turned("wrench-body-rotated-twice", text, body, force_body_by=2.0, torque_body_by=1.0)


def _turned(name: str, sentence: str, applies: _Applies, **changes: float) -> Fault:
    return _load(name, sentence, constant(**changes), applies, _OTHER_ATTITUDE)


def _applied_faults() -> Iterator[Fault]:
    """Yield faults of the torque in body axes as an adapter applies it, with the moments of body forces."""
    yield _scaled(
        "applied-torque",
        "torques are multiplied by {0}, the moments of body forces too",
        "torque_body torque_world lever",
        lambda at: at.has_torque and "lever" in at.loads,
        _factor_texts("every torque in body or world axes"),
    )
    both = "a torque in body axes, and the moment of a body force,"
    text = f"{both} acts in world axes"
    yield _load("applied-torque-body-as-world", text, changed_loads(_applied_as_world), _has("lever"))
    plant = changed_loads(
        lambda h, values, at: {
            **_frozen(replace(h, torque_body=h.torque_body + h.lever_torque), values, at),
            "lever": 0.0 * h.lever,
        }
    )
    text = f"{both} keeps its initial direction in world axes"
    yield _load("applied-torque-frozen", text, plant, _has("lever"))
    yield _scaled(
        "applied-moment",
        "the torque in body axes and the moments of forces are multiplied by {0}",
        "torque_body lever moment",
        _has("torque_body", "lever"),
        (
            (0.0, "torques in body axes and moments are missing"),
            (-1.0, "torques in body axes and moments have the opposite sign"),
        ),
    )
    yield _scaled(
        "applied-force",
        "forces and the torque in body axes are multiplied by {0}",
        "force_body force_world torque_body lever moment",
        _has("torque_body", "lever"),
    )
    yield _scaled(
        "applied-force-without-lever",
        "forces are multiplied by {0}, the moments of body forces are right",
        "force_body force_world moment",
        _has("lever", "moment", moving=True),
        ((0.0, "forces do not push the centre of mass, and world forces have no moment"),),
    )
