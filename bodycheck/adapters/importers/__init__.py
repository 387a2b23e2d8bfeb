"""The importers of engines: the bodies of a model file, read from the engine after its import.

One module per engine, which imports the engine within its functions: `FLAGS` is known without the engine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol, cast

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files.joint import StatedJoint

DEFAULT, RECOMMENDED = "default", "recommended"
WITHOUT_MESHES = "shapes of mesh files left out"
CONFIGURATIONS = 3
"""At which mass matrices are compared."""

_MODULES = {
    "mujoco": "bodycheck.adapters.importers.mujoco_import",
    "pybullet": "bodycheck.adapters.importers.pybullet_import",
    "dart": "bodycheck.adapters.importers.dart_import",
}


@dataclass(frozen=True)
class ImportedLink:
    """What an engine holds of a link: mass, centre (3,) in link axes, tensor (3, 3) about it in link axes.

    position_m (3,), rotation (3, 3): of the link in the world with all joints as in the file.
    parent: the index of a link, -1 for the world. joints: to the parent, the first next to it.
    """

    name: str
    mass: float
    centre_m: Sequence[float]
    inertia_kg_m2: Sequence[Sequence[float]]
    position_m: Sequence[float]
    rotation: Sequence[Sequence[float]]
    parent: int
    joints: tuple[StatedJoint, ...]


@dataclass(frozen=True, eq=False)
class MassMatrices:
    """Mass matrices M (k, n, n) of some links at k configurations, in the coordinates of their joints.

    columns: the link and the number of its joint that each rate belongs to. displacements (k, n): from the
    configuration of the file, in rad and m; those of a ball are a rotation vector in child axes.
    """

    columns: Sequence[tuple[int, int]]
    displacements: Array
    values: Array


@dataclass(frozen=True)
class ImportRequest:
    """A file to import: its path and format, the flags, and its text without meshes (URDF, SDFormat)."""

    file: str
    format: str
    flags: str
    bare: str = ""


@contextmanager
def file_to_import(request: ImportRequest) -> Iterator[str]:
    """Yield the path of the file, for the recommended import that of a copy without meshes."""
    if request.flags != RECOMMENDED or not request.bare:
        yield request.file
        return
    with TemporaryDirectory(prefix="bodycheck-import-") as folder:
        path = Path(folder) / Path(request.file).name
        path.write_text(request.bare, encoding="utf-8")
        yield str(path)


@dataclass(frozen=True)
class SpinRequest:
    """A free spin of the only link of a file from rest at its own axes: omega (3,) in link axes, rad/s."""

    omega_rad_s: Sequence[float]
    dt_s: float
    steps_per_sample: int
    samples: int


class Importer(Protocol):
    """A module of this package."""

    FLAGS: Mapping[str, Mapping[str, str]]
    """Format -> flags -> the settings that they mean. Formats that the engine does not read are absent."""

    imported_links: Callable[[ImportRequest], list[ImportedLink]]
    """Import a file and return the engine's links; any exception means that the import failed."""

    mass_matrices: Callable[[ImportRequest, int], list[MassMatrices]]
    """Import a file and return M of each tree that the engine has it of, at some random configurations."""

    spin: Callable[[ImportRequest, SpinRequest], Array]
    """Import a file of one link, spin it freely, and return R (n, 3, 3), link to world."""


def importer(engine: str) -> Importer | None:
    """Return the importer of an engine; None if it has none."""
    name = _MODULES.get(engine)
    return None if name is None else cast(Importer, import_module(name))


def engines_with_importers() -> tuple[str, ...]:
    """Return the names of the engines that import model files."""
    return tuple(_MODULES)


def tensor_of(moments: Sequence[float], quaternion: Sequence[float]) -> list[list[float]]:
    """R diag(J) R^T for principal moments (3,) and their axes as a quaternion (w, x, y, z)."""
    from bodycheck.reference_impl.rotations import quaternion_to_matrix

    R = quaternion_to_matrix(np.array(quaternion))
    return ((R * np.array(moments)) @ R.T).tolist()


_RATES = {"hinge": 1, "slide": 1, "ball": 3, "free": 6}


def rates_of(links: Sequence[ImportedLink]) -> list[tuple[int, int]] | None:
    """Return the link and the joint of each rate, in the order of links; None for joints of other kinds."""
    known = [(index, k, one) for index, link in enumerate(links) for k, one in enumerate(link.joints)]
    if any(one.motion not in (*_RATES, "fixed") for _, _, one in known):
        return None
    return [(index, k) for index, k, one in known for _ in range(_RATES.get(one.motion, 0))]


def random_displacements(
    links: Sequence[ImportedLink], columns: Sequence[tuple[int, int]], count: int
) -> Array:
    """Return (count, n) displacements: up to 1.7 rad, 0.3 m, and none of a free joint."""
    size = {"hinge": 1.7, "ball": 1.7, "slide": 0.3, "free": 0.0}
    scale = np.array([size[links[link].joints[k].motion] for link, k in columns])
    return np.asarray(np.random.default_rng(1).uniform(-1.0, 1.0, (count, len(columns))) * scale)


def answered(engine: str, message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a worker's answer to a request `import`: links, or matrices or a spin where it asks for them."""
    reads = importer(engine)
    if reads is None:
        return {"outcome": "unsupported", "message": f"{engine} has no importer"}
    request = ImportRequest(**message["import"])
    if request.flags not in reads.FLAGS.get(request.format, {}):
        return {"outcome": "unsupported", "message": f"{engine} does not read {request.format}"}
    if "spin" in message:
        return {"outcome": "ok", "rotation": reads.spin(request, SpinRequest(**message["spin"])).tolist()}
    if "matrices" in message:
        found = reads.mass_matrices(request, int(message["matrices"]))
        return {"outcome": "ok", "matrices": [_as_text(asdict(one)) for one in found]}
    return {"outcome": "ok", "links": [_as_text(asdict(link)) for link in reads.imported_links(request)]}


def _as_text(value: Any) -> Any:
    """Return plain data as JSON can hold it: numbers as text, because they may be NaN or infinite."""
    if isinstance(value, dict):
        return {key: _as_text(one) for key, one in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_as_text(one) for one in value]
    return repr(float(value)) if isinstance(value, float | np.floating) else value


def imported_link(plain: Mapping[str, Any]) -> ImportedLink:
    """Return the link of a worker's answer; raises ValueError, TypeError or KeyError if it is not one."""
    centre, position = np.array(plain["centre_m"], float), np.array(plain["position_m"], float)
    inertia, rotation = np.array(plain["inertia_kg_m2"], float), np.array(plain["rotation"], float)
    if {centre.shape, position.shape} != {(3,)} or {inertia.shape, rotation.shape} != {(3, 3)}:
        raise ValueError(
            f"link {plain['name']!r:.60} has a centre {centre.shape} and a tensor {inertia.shape}"
        )
    return ImportedLink(
        str(plain["name"]),
        float(plain["mass"]),
        centre.tolist(),
        inertia.tolist(),
        position.tolist(),
        rotation.tolist(),
        int(plain["parent"]),
        tuple(map(joint_of, plain["joints"])),
    )


def joint_of(plain: Mapping[str, Any]) -> StatedJoint:
    """Return the joint of plain data; raises ValueError, TypeError or KeyError if it is not one."""
    numbers = {"damping", "friction", "armature", "stiffness", "rest", "reference", "effort", "velocity"}
    found: dict[str, Any] = {name: str(plain[name]) for name in ("name", "kind")}
    found |= {name: float(plain[name]) for name in numbers if plain.get(name) is not None}
    for name, length in (("axis", 3), ("at_m", 3), ("limits", 2), ("gains", 2)):
        if plain.get(name) is not None:
            first, *others = map(float, plain[name])
            found[name] = (first, *others)
            if len(found[name]) != length:
                raise ValueError(f"joint {found['name']!r:.60}: {name} has {len(found[name])} numbers")
    if plain.get("mimic") is not None:
        other, multiplier, offset = plain["mimic"]
        found["mimic"] = (str(other), float(multiplier), float(offset))
    return StatedJoint(line=int(plain.get("line", 0)), **found)


def matrices_of(plain: Mapping[str, Any]) -> MassMatrices:
    """Return the matrices of a worker's answer; raises ValueError, TypeError or KeyError if they are none."""
    columns = [(int(link), int(joint)) for link, joint in plain["columns"]]
    at, values = np.array(plain["displacements"], float), np.array(plain["values"], float)
    if at.shape[1:] != (len(columns),) or values.shape != (len(at), len(columns), len(columns)):
        raise ValueError(f"matrices {values.shape} at configurations {at.shape} of {len(columns)} rates")
    return MassMatrices(columns, at, values)
