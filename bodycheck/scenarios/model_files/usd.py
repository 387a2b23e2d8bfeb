"""Read the rigid bodies of a USD stage: mass, centre, diagonal inertia and principal axes, in kg and m.

Source: OpenUSD, UsdPhysics: https://openusd.org/release/api/usd_physics_page_front.html. USD stores these
numbers in single precision.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.child_python import child_python
from bodycheck._util.errors import InputError
from bodycheck._util.formatting import unread
from bodycheck._util.untrusted import open_input, printable
from bodycheck.scenarios.model_files.exact_arithmetic import (
    ExactInertia,
    Frame,
    doubles,
    exact,
    identity,
    mp,
    rotation_of_quaternion,
    rotation_to,
)
from bodycheck.scenarios.model_files.joint import StatedJoint
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, Shape, StatedInertia

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_TIMEOUT_S = 120.0
_MAX_BYTES = 1 << 30
_SAME = 1e-6
"""Relative: the round-off of two spellings of a tensor in single precision."""
_Z = exact([0.0, 0.0, 1.0])


def read_usd(path: Path) -> ModelFile:
    """Return the model of a stage; raises InputError with one line if it cannot be read."""
    facts = _facts(path)
    metre, kilogram = (float(facts[name]) for name in ("meters_per_unit", "kilograms_per_unit"))
    if not (0.0 < metre < math.inf and 0.0 < kilogram < math.inf):
        raise InputError(
            f"{path}: metersPerUnit {metre:g} and kilogramsPerUnit {kilogram:g} must be positive"
        )
    names = _names(facts["bodies"])
    notes = [f"the stage has {metre:g} m and {kilogram:g} kg per unit, {facts['up_axis']} up"]
    notes += [f"the stage is incomplete: {printable(fault, 200)}" for fault in facts["faults"]]
    links = []
    for body in facts["bodies"]:
        link = _link(path, body, names[body["path"]], metre, kilogram)
        links.append(link)
        if link.stated is not None and (note := _contradiction(body, link.stated, metre, kilogram)):
            notes.append(f"{link.name}: {note}")
    links = _connected(links, facts, names, metre)
    if not links:
        raise InputError(f"{path}: has no rigid body (a prim with PhysicsRigidBodyAPI)")
    reads = tuple(sorted(Path(layer) for layer in facts["layers"] if Path(layer) != path.resolve()))
    settings = {name: str(facts[name]) for name in ("meters_per_unit", "kilograms_per_unit", "up_axis")}
    return ModelFile(path, "usd", tuple(links), reads, tuple(notes), settings)


def _facts(path: Path) -> dict[str, Any]:
    """Return what OpenUSD reads from a stage; raises InputError with one line if it cannot be read."""
    if importlib.util.find_spec("pxr") is None:
        raise InputError(f"{path}: reading USD requires OpenUSD: pip install 'bodycheck[usd]'")
    try:
        open_input(path, _MAX_BYTES).close()
    except OSError as error:
        raise InputError(unread(path, error)) from None
    facts = asked(path)
    if "error" in facts:
        raise InputError(f"{path}{_reason(str(facts['error']))}")
    return facts


def asked(path: Path) -> dict[str, Any]:
    """Return what a process of its own reads from a stage, or {"error": WHY}."""
    command, variables = child_python("bodycheck.scenarios.model_files.usd_stage", str(path.absolute()))
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            timeout=_TIMEOUT_S,
            env={**os.environ, **variables},
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: cannot be read: OpenUSD did not finish within {_TIMEOUT_S:g} s") from None
    if done.returncode:
        raise InputError(f"{path}: cannot be read: OpenUSD ended with status {done.returncode}")
    facts: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return facts


def _reason(error: str) -> str:
    """Return ':LINE: why' or ': why' of OpenUSD's error, which names each function of its own on the way."""
    if found := re.search(r":(\d+):\d+: ([^'\n]*)", error):
        reason = "syntax error" if "pxrInternal" in found[2] else printable(found[2], 200)
        return f":{found[1]}: is not USD: {reason}"
    found = re.search(r" : '(.*)'", error)
    return f": is not USD: {printable(found[1] if found else error.splitlines()[-1], 200)}"


def _names(bodies: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return path -> name: the display name, or that of the prim, or the path if it is not unique."""
    found = {body["path"]: body["display_name"] or body["name"] for body in bodies}
    shared = list(found.values())
    return {path: name if shared.count(name) == 1 else path for path, name in found.items()}


def _frame(matrix: Sequence[Sequence[float]], metre: float) -> Frame:
    """Return the pose that a matrix (4, 4) for row vectors states."""
    M = np.array(matrix, dtype=np.float64)
    return Frame(exact(M[:3, :3].T), exact(M[3, :3]) * mp.mpf(metre))


def _link(path: Path, body: Mapping[str, Any], name: str, metre: float, kilogram: float) -> ModelLink:
    stated, unread = _stated(body, metre, kilogram)
    shapes = [_shape(one, metre) for one in body["shapes"]]
    return ModelLink(
        name,
        0,
        path,
        None,
        _frame(body["pose"], metre),
        None,
        stated,
        tuple(shape for shape in shapes if shape.collides),
        unread,
        visuals=tuple(shape for shape in shapes if not shape.collides),
    )


def _stated(body: Mapping[str, Any], metre: float, kilogram: float) -> tuple[StatedInertia | None, str]:
    """Return the inertia that a prim states, or what it leaves to the importers."""
    absent = [
        quantity
        for quantity, given in (
            ("mass", body["mass"] > 0.0),
            ("centre of mass", body["centre"] is not None or not body["collides"]),
            ("diagonal inertia", any(body["diagonal"])),
        )
        if not given
    ]
    if len(absent) > 1 and not body["collides"]:
        return None, ""
    if absent:
        source = "its colliders" if body["collides"] else "nothing in the file"
        return None, f"states no {' and no '.join(absent)}: importers compute it from {source}"
    u, k = mp.mpf(metre), mp.mpf(kilogram)
    moments = exact(np.diag(body["diagonal"])) * (k * u * u)
    inertia = ExactInertia(mp.mpf(body["mass"]) * k, exact(np.zeros(3)), moments)
    centre = exact(body["centre"] or np.zeros(3)) * exact(body["scale"]) * u
    axes = rotation_of_quaternion(body["axes"]) if any(body["axes"]) else identity()
    return StatedInertia(0, inertia, Frame(axes, centre)), ""


def _contradiction(body: Mapping[str, Any], stated: StatedInertia, metre: float, kilogram: float) -> str:
    """Return how newton:inertia, in body axes, differs from the principal form; "" if it does not."""
    if body["full"] is None or len(body["full"]) != 6:
        return ""
    xx, yy, zz, xy, xz, yz = (value * kilogram * metre**2 for value in body["full"])
    full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    tensor = doubles(stated.in_link.tensor)
    difference = float(np.max(np.abs(full - tensor))) / float(np.max(np.abs(tensor)))
    if difference <= _SAME:
        return ""
    return (
        f"newton:inertia differs by {difference:.2g} of the largest moment from physics:diagonalInertia with "
        "physics:principalAxes, which are compared here"
    )


def _shape(one: Mapping[str, Any], metre: float) -> Shape:
    """Return a shape with its axis along z; sizes in m."""
    frame = _frame(one["pose"], metre)
    if one["along"] != 2:
        frame = frame @ Frame(rotation_to(exact(np.eye(3)[one["along"]])), exact(np.zeros(3)))
    return Shape(one["kind"], tuple(size * metre for size in one["sizes"]), frame, collides=one["collides"])


def _connected(
    links: Sequence[ModelLink], facts: Mapping[str, Any], names: Mapping[str, str], metre: float
) -> list[ModelLink]:
    """Return the links with their parents, by joints; a joint that would close a loop is left out."""
    by_name = {link.name: link for link in links}
    world = dict(zip(by_name, (_frame(body["pose"], metre) for body in facts["bodies"]), strict=True))
    for joint in facts["joints"]:
        child, parent = (by_name.get(names.get(joint[end], "")) for end in ("child", "parent"))
        if child is None or child.parent is not None or _is_above(by_name, child, parent):
            continue
        made = StatedJoint(joint["name"], joint["kind"], 0)
        if parent is None:
            by_name[child.name] = replace(child, joint=made)
            continue
        pose = world[parent.name].inverse() @ world[child.name]
        by_name[child.name] = replace(child, joint=made, parent=parent.name, pose=pose)
    return list(by_name.values())


def _is_above(by_name: Mapping[str, ModelLink], link: ModelLink, at: ModelLink | None) -> bool:
    """Return whether a link is another one or above it."""
    while at is not None:
        if at.name == link.name:
            return True
        at = None if at.parent is None else by_name[at.parent]
    return False
