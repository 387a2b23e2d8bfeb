"""[body]: a rigid body given by mass and inertia, a mesh file, a primitive, or a link of a model file."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PlainSerializer,
    PlainValidator,
    SerializerFunctionWrapHandler,
    StrictStr,
    Tag,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck._util.untrusted import read_bytes
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Link
from bodycheck.scenarios.fields import (
    ALIGNED,
    ZERO,
    Matrix,
    Positive,
    TomlTable,
    UnitQuaternion,
    Vector,
    finite_numbers,
    rows,
)
from bodycheck.scenarios.mass_properties.solid import (
    PRIMITIVES,
    MassProperties,
    Overlap,
    known_shape,
    primitive,
)
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.shapes import MeshSolid, Unit, mesh_solid

_TENSOR_TOLERANCE = 1e-12  # relative: for symmetry and the triangle inequality


def _inertia(value: Any) -> Matrix:
    """Accept three principal moments (3,) or a tensor (3, 3) of finite numbers that a body can have."""
    inertia = finite_numbers(value, "three principal moments or a 3x3 tensor of numbers", (3,), (3, 3))
    return _physical_tensor(np.diag(inertia) if inertia.shape == (3,) else inertia)


def _physical_tensor(inertia: Array) -> Matrix:
    """Return a tensor (3, 3), made exactly symmetric; raises ValueError if no body can have it."""
    if np.max(np.abs(inertia - inertia.T)) > _TENSOR_TOLERANCE * np.max(np.abs(inertia)):
        raise ValueError("must be symmetric: I_xy = I_yx = -sum m x y")
    inertia = 0.5 * (inertia + inertia.T)
    moments = np.linalg.eigvalsh(inertia)
    if not moments[0] > 0.0:
        raise ValueError(f"must be positive definite; the smallest principal moment is {moments[0]:.6g}")
    if moments[0] + moments[1] < moments[2] * (1.0 - _TENSOR_TOLERANCE):
        raise ValueError(
            "no body has these moments: the sum of the two smaller must be at least the largest (triangle "
            f"inequality), but {moments[0]:.6g} + {moments[1]:.6g} < {moments[2]:.6g}"
        )
    return rows(inertia)


class _BodyTable(TomlTable):
    link_offset_m: Vector | None = None
    link_quaternion: UnitQuaternion | None = None

    @property
    def link(self) -> Link | None:
        """The engine's own frame of the body; None if the file does not specify it."""
        if self.link_offset_m is None and self.link_quaternion is None:
            return None
        return Link(np.array(self.link_offset_m or ZERO), np.array(self.link_quaternion or ALIGNED))


class GivenBody(_BodyTable):
    """A body given by its mass in kg and its inertia about the centre of mass, in body axes, in kg m^2."""

    mass_kg: Positive
    inertia_kg_m2: Annotated[Matrix, BeforeValidator(_inertia, json_schema_input_type=Vector | Matrix)]

    @property
    def notes(self) -> tuple[str, ...]:
        """Always empty: given numbers are not corrected."""
        return ()


class _Solid(_BodyTable):
    """A solid of uniform density; body axes are those of the shape, with the origin at the centre of mass."""

    @property
    @abstractmethod
    def solid(self) -> MassProperties:
        """The mass properties at this density, in the shape's own axes."""

    @property
    def mass_kg(self) -> float:
        """The mass in kg."""
        return self.solid.mass

    @property
    def inertia_kg_m2(self) -> Matrix:
        """The tensor about the centre of mass, in the shape's own axes, in kg m^2."""
        return _physical_tensor(self.solid.inertia)

    @property
    def notes(self) -> tuple[str, ...]:
        """The corrections made to the shape, one sentence each."""
        return self.solid.notes

    @model_serializer(mode="wrap")
    def _with_results(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Add the resulting numbers to the keys of the file, so that the mesh file is no longer needed."""
        return {
            **handler(self),
            "centre_m": self.solid.centre.tolist(),
            "mass_kg": self.mass_kg,
            "inertia_kg_m2": self.inertia_kg_m2,
            "notes": self.notes,
        }


def _checked_density(density: float, solid: MassProperties) -> float:
    """Return the density; raises ValueError if the solid's inertia at this density is not usable."""
    _physical_tensor(solid.at_density(density).inertia)
    return density


def _meshed(value: Any, info: ValidationInfo) -> MeshSolid:
    """Read the mesh of this name from the folder in the validation context."""
    if not isinstance(value, str):
        raise ValueError("needs the name of a mesh file, relative to the scenario's folder")
    folder = (info.context or {}).get("folder", Path())
    return mesh_solid(folder, value, info.data.get("mesh_unit"), info.data.get("mesh_overlap"))


def _mesh_facts(mesh: MeshSolid) -> dict[str, str]:
    facts = {"file": mesh.name, "sha256": mesh.sha256}
    return facts | {"surface": mesh.surface} if mesh.surface else facts


class MeshBody(_Solid):
    """The solid bounded by a mesh file; lengths in the file are in mesh_unit [default: m]."""

    # before `mesh`, whose validator uses them
    mesh_unit: Unit | None = None
    mesh_overlap: Overlap | None = None
    mesh: Annotated[
        MeshSolid, PlainValidator(_meshed, json_schema_input_type=str), PlainSerializer(_mesh_facts)
    ]
    density_kg_m3: Positive

    @field_validator("density_kg_m3")
    @classmethod
    def _not_absurd(cls, value: float, info: ValidationInfo) -> float:
        if "mesh" in info.data:
            _physical_tensor(info.data["mesh"].at_density(value).inertia)
        return value

    @cached_property
    def solid(self) -> MassProperties:
        """The mass properties at this density, in the file's own axes."""
        return self.mesh.at_density(self.density_kg_m3)


class ShapeBody(_Solid):
    """A primitive with its axis along z; `scenarios.shapes.primitive` defines the sizes in m."""

    shape: Annotated[StrictStr, AfterValidator(known_shape), Field(json_schema_extra={"enum": [*PRIMITIVES]})]
    size_m: tuple[Positive, ...]
    density_kg_m3: Positive

    @field_validator("size_m")
    @classmethod
    def _fitting(cls, value: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if "shape" in info.data:
            primitive(info.data["shape"], value)
        return value

    @field_validator("density_kg_m3")
    @classmethod
    def _not_absurd(cls, value: float, info: ValidationInfo) -> float:
        if not {"shape", "size_m"} <= info.data.keys():
            return value
        return _checked_density(value, primitive(info.data["shape"], info.data["size_m"]))

    @cached_property
    def solid(self) -> MassProperties:
        """The mass properties at this density, in the shape's own axes."""
        return primitive(self.shape, self.size_m).at_density(self.density_kg_m3)


MODEL_FORMATS = ("urdf", "mjcf")
"""The formats, as keys of [body]."""


@dataclass(frozen=True)
class LinkOfFile:
    """Name, SHA-256 of the file, mass in kg, centre in m, tensor about it in link axes in kg m^2."""

    name: str
    sha256: str
    mass: float
    centre: tuple[float, ...]
    inertia: tuple[tuple[float, ...], ...]
    notes: tuple[str, ...] = ()


def _of_file(value: Any, info: ValidationInfo) -> LinkOfFile:
    """Read the link of this name from the model file that the table names."""
    if value is not None and not isinstance(value, str):
        raise ValueError("needs the name of a link")
    named = [info.data.get(name) for name in MODEL_FORMATS]
    if sum(name is not None for name in named) != 1:
        raise ValueError("needs either urdf or mjcf, the name of a model file")
    folder = (info.context or {}).get("folder", Path())
    kind = MODEL_FORMATS[0] if named[0] is not None else MODEL_FORMATS[1]
    found = _link_of_file(folder, str(info.data[kind]), kind, value)
    _physical_tensor(np.array(found.inertia))
    return found


def _link_of_file(folder: Traversable, file: str, kind: str, name: str | None) -> LinkOfFile:
    """Return a link of a model file in a folder; name None: the only one with an inertia.

    Raises InputError with one line if the file, its format or the link is wrong.
    """
    from bodycheck.scenarios.model_files.exact_arithmetic import doubles  # imports mpmath

    path = Path(str(folder)) / file
    model = read_model(path)
    if model.format not in MODEL_FORMATS:
        raise InputError(
            f"{path}: is {model.format.upper()}, and [body] takes a link of URDF or MJCF only; write "
            f"mass_kg and inertia_kg_m2, which 'bodycheck audit {file} --lint --json' prints"
        )
    if model.format != kind:
        raise InputError(f"{path}: is {model.format.upper()}; write {model.format} = {file!r}")
    known = [link.name for link in model.links if link.stated is not None]
    if name is None:
        if len(known) != 1:
            raise InputError(
                f"{path}: has {len(known)} links with inertia; name one by link{suggestion('', known)}"
            )
        (name,) = known
    link = model.by_name.get(name)
    if link is None:
        raise InputError(f"{path}: has no link {name!r}{suggestion(name, known)}")
    if link.unread:
        raise InputError(f"{path}:{link.line}: {name}: {link.unread}")
    if link.stated is None or not link.stated.inertia.mass > 0:
        raise InputError(f"{path}:{link.line}: link {name!r} has no mass and inertia")
    body = link.stated.in_link
    tensor = doubles(0.5 * (body.tensor + body.tensor.T))
    derived = f"inertia {link.stated.derived}" if link.stated.derived else ""
    return LinkOfFile(
        name,
        sha256(read_bytes(path)).hexdigest(),
        float(body.mass),
        tuple(doubles(body.centre).tolist()),
        tuple(tuple(row) for row in tensor.tolist()),
        tuple(filter(None, (derived, *(f"also read {other}" for other in model.outside())))),
    )


def _link_facts(link: LinkOfFile) -> dict[str, str]:
    return {"name": link.name, "sha256": link.sha256}


class FileBody(_BodyTable):
    """A link of a model file, alone; body axes are the link's, with the origin at its centre of mass."""

    urdf: StrictStr | None = None
    mjcf: StrictStr | None = None
    of_file: Annotated[
        LinkOfFile,
        PlainValidator(_of_file, json_schema_input_type=str),
        PlainSerializer(_link_facts),
        Field(alias="link"),
    ]

    @model_validator(mode="before")
    @classmethod
    def _only_link(cls, value: Any) -> Any:
        return {**value, "link": value.get("link")} if isinstance(value, dict) else value

    @property
    def mass_kg(self) -> float:
        """The mass in kg."""
        return self.of_file.mass

    @property
    def inertia_kg_m2(self) -> Matrix:
        """The tensor about the centre of mass, in link axes, in kg m^2."""
        return _physical_tensor(np.array(self.of_file.inertia))

    @property
    def notes(self) -> tuple[str, ...]:
        """How the inertia follows from the file, if it is not written there."""
        return self.of_file.notes

    @model_serializer(mode="wrap")
    def _with_results(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Add the resulting numbers to the keys of the file, so that the model file is no longer needed."""
        return {
            **handler(self),
            "centre_m": list(self.of_file.centre),
            "mass_kg": self.mass_kg,
            "inertia_kg_m2": self.inertia_kg_m2,
            "notes": self.notes,
        }


GIVEN = "a [body] with mass_kg, inertia_kg_m2"
MESH = "a [body] with mesh, density_kg_m3"
SHAPE = "a [body] with shape, size_m, density_kg_m3"
FILE = "a [body] with urdf or mjcf, link"
BODY_FORMS = (GIVEN, MESH, SHAPE, FILE)
"""The members of the union below, named as in messages."""


def form_of(value: Any) -> str:
    """Return which of the forms a table, or a body to be serialised, has by its keys."""
    keys = value if isinstance(value, dict) else getattr(type(value), "model_fields", ())
    if "urdf" in keys or "mjcf" in keys:
        return FILE
    if "mesh" in keys:
        return MESH
    return SHAPE if "shape" in keys or "size_m" in keys else GIVEN


Body: TypeAlias = Annotated[
    Annotated[GivenBody, Tag(GIVEN)]
    | Annotated[MeshBody, Tag(MESH)]
    | Annotated[ShapeBody, Tag(SHAPE)]
    | Annotated[FileBody, Tag(FILE)],
    Discriminator(form_of),
]
