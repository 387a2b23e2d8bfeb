"""Serialise scenarios for a stored run, and read them back exactly, without their mesh files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from bodycheck._util.errors import InputError
from bodycheck.scenarios.body import MODEL_FORMATS, FileBody, LinkOfFile, MeshBody, ShapeBody
from bodycheck.scenarios.mass_properties.solid import MassProperties
from bodycheck.scenarios.mesh_files.decimation import read_obj_text
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import AnyScenario, fault_lines
from bodycheck.scenarios.shapes import MeshSolid

if TYPE_CHECKING:
    from bodycheck.scenarios.tree_model import TreeScenario

_LINK = ("link_offset_m", "link_quaternion")
_MESH = ("mesh_unit", "mesh_overlap")
_NUMBERS = ("mass_kg", "inertia_kg_m2", *_LINK)


def serialized(scenario: AnyScenario) -> dict[str, Any]:
    """Return a scenario as plain data, with the numbers computed from its mesh or shape."""
    return scenario.model_dump(mode="json", exclude_none=True)


def deserialized(
    data: Mapping[str, Any], where: str, *, allow_code: bool = False, file: Path | None = None
) -> AnyScenario:
    """Return the scenario from the output of `serialized`; `where` names it in messages.

    allow_code: it may name functions, whose code runs. file: has the data. Raises InputError with one line
    per error, also if `serialized` would not give the same data again.
    """
    try:
        context = {"stored": True, "allow_code": allow_code, "file": file}
        scenario: AnyScenario
        if isinstance(data["body"], list):
            scenario = _tree(data, context)
        else:
            scenario = Scenario.model_validate({**data, "body": _by_numbers(data["body"])}, context=context)
            if (shaped := _shaped(data["body"])) is not None:
                scenario = scenario.model_copy(update={"body": shaped})
        is_same = serialized(scenario) == data
    except ValidationError as error:
        raise InputError("\n".join(f"{where}: {line}" for line in fault_lines(error))) from None
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise InputError(f"{where}: is not a scenario as a run writes it: {error!r}") from None
    if not is_same:
        raise InputError(f"{where}: is not a scenario as this version of bodycheck writes it")
    return scenario


def _by_numbers(body: Mapping[str, Any], kept: tuple[str, ...] = ()) -> dict[str, Any]:
    return {name: body[name] for name in (*_NUMBERS, *kept) if name in body}


def _tree(data: Mapping[str, Any], context: dict[str, Any]) -> TreeScenario:
    """Return a tree whose bodies from meshes, shapes and files have their stored numbers."""
    from bodycheck.scenarios.tree_model import TreeScenario  # makes the tables of every kind of joint

    bodies = [_by_numbers(body, ("name", "joint")) for body in data["body"]]
    return TreeScenario.model_validate({**data, "body": bodies}, context=context)


def _shaped(data: Mapping[str, Any]) -> MeshBody | ShapeBody | FileBody | None:
    """Return the body of a mesh, shape or model file with its stored numbers; else None."""
    if "of_file" in data:
        return _of_file(data)
    if "mesh" not in data and "shape" not in data:
        return None
    solid = MassProperties(
        data["mass_kg"], np.array(data["centre_m"]), np.array(data["inertia_kg_m2"]), tuple(data["notes"])
    )
    known: dict[str, Any] = {name: tuple(data[name]) for name in ("size_m", *_LINK) if name in data}
    density = data["density_kg_m3"]
    body: MeshBody | ShapeBody
    if "shape" in data:
        body = ShapeBody.model_construct(None, shape=data["shape"], density_kg_m3=density, **known)
    else:
        known |= {name: data[name] for name in _MESH if name in data}
        facts, light = data["mesh"], solid.at_density(1.0 / density)
        surface = str(facts.get("surface", ""))
        if surface:
            read_obj_text(surface)  # raises ValueError here, and not where it is drawn
        mesh = MeshSolid(facts["file"], facts["sha256"], data.get("mesh_unit"), light, surface)
        body = MeshBody.model_construct(None, mesh=mesh, density_kg_m3=density, **known)
    vars(body)["solid"] = solid  # fills the cached property, which would read the file
    return body


def _of_file(data: Mapping[str, Any]) -> FileBody:
    link = LinkOfFile(
        data["of_file"]["name"],
        data["of_file"]["sha256"],
        data["mass_kg"],
        tuple(data["centre_m"]),
        tuple(tuple(row) for row in data["inertia_kg_m2"]),
        tuple(data["notes"]),
    )
    known: dict[str, Any] = {name: data[name] for name in MODEL_FORMATS if name in data}
    known |= {name: tuple(data[name]) for name in _LINK if name in data}
    return FileBody.model_construct(None, of_file=link, **known)
