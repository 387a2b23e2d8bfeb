"""Print what a USD stage states about its rigid bodies as JSON, in a process of its own.

OpenUSD writes to the error stream, and a damaged file can end the process that reads it.

Source: OpenUSD, UsdPhysics schema (MassAPI, RigidBodyAPI, Joint), UsdPhysicsRigidBodyAPI's mass properties.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from typing import Any

_AXES = {"X": 0, "Y": 1, "Z": 2}


def stage_facts(path: str) -> dict[str, Any]:
    """Return units, up axis, layers, bodies, shapes and joints of a stage, in the units of the stage."""
    from pxr import Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.Open(path, Usd.Stage.LoadAll)
    if stage is None:
        raise ValueError("is not a USD stage")
    prims = list(stage.Traverse(Usd.TraverseInstanceProxies()))
    return {
        "meters_per_unit": UsdGeom.GetStageMetersPerUnit(stage),
        "kilograms_per_unit": UsdPhysics.GetStageKilogramsPerUnit(stage),
        "up_axis": str(UsdGeom.GetStageUpAxis(stage)),
        "layers": [layer.realPath for layer in stage.GetUsedLayers() if layer.realPath],
        "faults": [str(error) for error in stage.GetCompositionErrors()],
        "bodies": [_body(prim) for prim in prims if prim.HasAPI(UsdPhysics.RigidBodyAPI)],
        "joints": [_joint(prim) for prim in prims if prim.IsA(UsdPhysics.Joint)],
    }


def _body(prim: Any) -> dict[str, Any]:
    from pxr import Gf, UsdGeom, UsdPhysics

    world = UsdGeom.XformCache().GetLocalToWorldTransform(prim)
    api = UsdPhysics.MassAPI(prim) if prim.HasAPI(UsdPhysics.MassAPI) else None
    centre = None if api is None else list(api.GetCenterOfMassAttr().Get())
    full = prim.GetAttribute("newton:inertia").Get()
    return {
        "path": str(prim.GetPath()),
        "name": prim.GetName(),
        "display_name": prim.GetDisplayName(),
        "pose": _matrix(world.RemoveScaleShear()),
        "scale": list(Gf.Transform(world).GetScale()),
        "mass": 0.0 if api is None else api.GetMassAttr().Get(),
        "centre": None if centre is None or not all(map(math.isfinite, centre)) else centre,
        "diagonal": [0.0] * 3 if api is None else list(api.GetDiagonalInertiaAttr().Get()),
        "axes": [0.0] * 4 if api is None else _quaternion(api.GetPrincipalAxesAttr().Get()),
        "full": None if full is None else list(full),
        "shapes": [_shape(part, world) for part in _parts(prim) if part.IsA(UsdGeom.Gprim)],
        "collides": any(part.HasAPI(UsdPhysics.CollisionAPI) for part in (prim, *_parts(prim))),
    }


def _parts(prim: Any) -> Iterator[Any]:
    """Yield the prims below a body that do not belong to another body."""
    from pxr import Usd, UsdPhysics

    for child in prim.GetFilteredChildren(Usd.TraverseInstanceProxies()):
        if not child.HasAPI(UsdPhysics.RigidBodyAPI):
            yield child
            yield from _parts(child)


def _shape(prim: Any, body: Any) -> dict[str, Any]:
    """Return kind, scaled sizes, and pose in the body; no sizes where the scale distorts the kind."""
    from pxr import Gf, UsdGeom, UsdPhysics

    world = UsdGeom.XformCache().GetLocalToWorldTransform(prim)
    scale = [abs(x) for x in Gf.Transform(world).GetScale()]
    uniform = max(scale) - min(scale) <= 1e-9 * max(scale)
    kind, sizes, along = "mesh", list[float](), "Z"
    if prim.IsA(UsdGeom.Cube):
        kind, sizes = "box", [UsdGeom.Cube(prim).GetSizeAttr().Get() * x for x in scale]
    elif prim.IsA(UsdGeom.Sphere) and uniform:
        kind, sizes = "sphere", [UsdGeom.Sphere(prim).GetRadiusAttr().Get() * scale[0]]
    elif (prim.IsA(UsdGeom.Cylinder) or prim.IsA(UsdGeom.Capsule)) and uniform:
        kind = "cylinder" if prim.IsA(UsdGeom.Cylinder) else "capsule"
        shape = UsdGeom.Cylinder(prim) if kind == "cylinder" else UsdGeom.Capsule(prim)
        sizes = [shape.GetRadiusAttr().Get() * scale[0], shape.GetHeightAttr().Get() * scale[0]]
        along = str(shape.GetAxisAttr().Get())
    pose = world.RemoveScaleShear() * body.RemoveScaleShear().GetInverse()
    return {
        "kind": kind,
        "sizes": sizes,
        "along": _AXES[along],
        "pose": _matrix(pose),
        "collides": prim.HasAPI(UsdPhysics.CollisionAPI),
    }


def _joint(prim: Any) -> dict[str, Any]:
    from pxr import UsdPhysics

    kind = prim.GetTypeName().removeprefix("Physics").removesuffix("Joint").lower() or "generic"
    joint = UsdPhysics.Joint(prim)
    return {
        "name": prim.GetName(),
        "kind": kind,
        "parent": _target(joint.GetBody0Rel(), prim),
        "child": _target(joint.GetBody1Rel(), prim),
    }


def _target(relation: Any, prim: Any) -> str:
    """Return the path of the rigid body that a joint names, or that has what it names; "" for the world."""
    from pxr import UsdPhysics

    for target in relation.GetTargets():
        at = prim.GetStage().GetPrimAtPath(target)
        while at and not at.IsPseudoRoot():
            if at.HasAPI(UsdPhysics.RigidBodyAPI):
                return str(at.GetPath())
            at = at.GetParent()
    return ""


def _matrix(matrix: Any) -> list[list[float]]:
    """Return a matrix (4, 4) for row vectors, x' = x M, as lists."""
    return [[matrix[i][j] for j in range(4)] for i in range(4)]


def _quaternion(quaternion: Any) -> list[float]:
    return [quaternion.GetReal(), *quaternion.GetImaginary()]


def _text(error: Exception) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except UnicodeDecodeError:  # OpenUSD quotes what it cannot read
        return f"{type(error).__name__}: a character that is not UTF-8"


def main() -> None:
    """Print the facts, or {"error": WHY}."""
    try:
        facts = stage_facts(sys.argv[1])
    except Exception as error:  # noqa: BLE001 - the process that asked reports it
        facts = {"error": _text(error)}
    print(json.dumps(facts))


if __name__ == "__main__":
    main()
