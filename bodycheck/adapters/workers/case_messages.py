"""Requests to a worker as plain data: cases with their scenes, searches for the largest stable step.

Numbers are JSON numbers, which Python and all serious parsers read back to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np

from bodycheck.adapters.batches import Batch
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import StableStepSearch
from bodycheck.adapters.workers.protocol import Message, packed, unpacked
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.load import checked
from bodycheck.reference_impl.random_bodies import Bodies
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Link,
    Load,
    PointForce,
    RigidBody,
    Scene,
    State,
    Torque,
)
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    Joint,
    JointSineTorque,
    JointTorque,
    TreeBody,
    TreeLoad,
    TreeScene,
)
from bodycheck.scenarios.user_functions import UserWrench, user_function


def case_message(case: Case) -> Message:
    """Return a case as plain data."""
    return {
        "scene": scene_message(case.scene),
        "method": case.method,
        "dt_s": case.setting.dt_s,
        "tolerance": case.setting.tolerance,
    }


def case_of(message: Message) -> Case:
    """Return the case of a message."""
    setting = Setting(message["dt_s"], message["tolerance"])
    return Case(scene_of(message["scene"]), message["method"], setting)


def batch_message(batch: Batch) -> Message:
    """Return the request for a batch of cases as plain data."""
    template = Case(batch.template, batch.method, batch.setting)
    bodies = {field.name: packed(getattr(batch.bodies, field.name)) for field in fields(batch.bodies)}
    return {"do": "batch", "case": case_message(template), "bodies": bodies}


def batch_of(message: Message) -> Batch:
    """Return the batch of a message."""
    case = case_of(message["case"])
    assert isinstance(case.scene, Scene)
    bodies = Bodies(**{name: unpacked(array) for name, array in message["bodies"].items()})
    return Batch(case.scene, bodies, case.method, case.setting)


def search_bounds(search: StableStepSearch) -> dict[str, float | None]:
    """Return within what the largest stable step of a case is looked for, as plain data."""
    return {
        "lowest_s": search.lowest_s,
        "highest_s": search.highest_s,
        "kinetic_limit_j": None if search.kinetic_limit_j == math.inf else search.kinetic_limit_j,
    }


def search_message(search: StableStepSearch) -> Message:
    """Return a search for the largest stable step as plain data."""
    return {"case": case_message(search.case), **search_bounds(search)}


def search_of(message: Message) -> StableStepSearch:
    """Return the search of a message."""
    limit = message["kinetic_limit_j"]
    return StableStepSearch(
        case_of(message["case"]),
        message["lowest_s"],
        message["highest_s"],
        math.inf if limit is None else limit,
    )


def scene_message(scene: Scene | TreeScene) -> Message:
    """Return a scene as plain data, in SI units, loads by the kinds of the scenario format.

    A pivot and a link frame are present only if the scene has them; of a tree, its bodies are a list.
    """
    if isinstance(scene, TreeScene):
        return _tree_message(scene)
    message = {
        "body": _plain(scene.body),
        "initial": {name: value for name, value in _plain(scene.initial).items() if value is not None},
        "loads": [_load_message(load) for load in scene.loads],
        "gravity": scene.gravity.tolist(),
        "duration_s": scene.duration_s,
        "samples": scene.samples,
    }
    if scene.pivot is not None:
        message["pivot"] = scene.pivot.tolist()
    if scene.link is not None:
        message["link"] = _plain(scene.link)
    return message


def scene_of(message: Message) -> Scene | TreeScene:
    """Return the scene of a message."""
    if "bodies" in message:
        return _tree(message)
    return Scene(
        body=RigidBody(**_arrays(message["body"])),
        initial=State(**_arrays(message["initial"])),
        loads=tuple(_load(load) for load in message["loads"]),
        gravity=np.array(message["gravity"], dtype=np.float64),
        duration_s=message["duration_s"],
        samples=message["samples"],
        pivot=np.array(message["pivot"], dtype=np.float64) if "pivot" in message else None,
        link=Link(**_arrays(message["link"])) if "link" in message else None,
    )


def _tree_message(scene: TreeScene) -> Message:
    return {
        "bodies": [
            {
                "name": body.name,
                "mass": body.mass,
                "inertia": body.inertia.tolist(),
                "joint": _plain(body.joint),
            }
            for body in scene.bodies
        ],
        "loads": [_tree_load_message(load) for load in scene.loads],
        "gravity": scene.gravity.tolist(),
        "duration_s": scene.duration_s,
        "samples": scene.samples,
    }


def _tree(message: Message) -> TreeScene:
    return TreeScene(
        bodies=tuple(
            TreeBody(body["name"], body["mass"], np.array(body["inertia"]), Joint(**_arrays(body["joint"])))
            for body in message["bodies"]
        ),
        loads=tuple(_tree_load(load) for load in message["loads"]),
        gravity=np.array(message["gravity"], dtype=np.float64),
        duration_s=message["duration_s"],
        samples=message["samples"],
    )


_JOINT_LOADS = {"joint-torque": JointTorque, "joint-sine-torque": JointSineTorque}


def _tree_load_message(load: TreeLoad) -> Message:
    if isinstance(load, BodyLoad):
        return {**_load_message(load.load), "body": load.body}
    return {"kind": next(kind for kind, of in _JOINT_LOADS.items() if isinstance(load, of)), **_plain(load)}


def _tree_load(message: Message) -> TreeLoad:
    if (of := _JOINT_LOADS.get(message["kind"])) is not None:
        values = _arrays({name: value for name, value in message.items() if name != "kind"})
        return of(**{name: math.inf if value is None else value for name, value in values.items()})
    load = _load({name: value for name, value in message.items() if name != "body"})
    assert isinstance(load, Torque | PointForce)
    return BodyLoad(message["body"], load)


def _load_message(load: Load) -> Message:
    """Return a load as plain data; a function travels as its name."""
    kind = checked(load, "a message to a worker").kind
    if isinstance(load, CallbackLoad):
        return {"kind": kind, "name": load.name}
    return {"kind": kind, **_plain(load)}


def _load(message: Message) -> Load:
    if message["kind"] == CallbackLoad.kind:
        # the run that sends it was allowed to run code
        return CallbackLoad(
            message["name"], UserWrench(message["name"], user_function(message["name"], allow_code=True))
        )
    values = _arrays({name: value for name, value in message.items() if name != "kind"})
    if "until_s" in values and values["until_s"] is None:
        values["until_s"] = math.inf
    return load_kinds()[message["kind"]](**values)


def _plain(holder: Any) -> Message:
    """Return the fields as JSON has them: infinity, which it has not, as null."""
    plain = {}
    for field in fields(holder):
        value = getattr(holder, field.name)
        value = value.tolist() if isinstance(value, np.ndarray) else value
        plain[field.name] = None if value == math.inf else value
    return plain


def _arrays(message: Message) -> Message:
    return {
        name: np.array(value, dtype=np.float64) if isinstance(value, list) else value
        for name, value in message.items()
    }
