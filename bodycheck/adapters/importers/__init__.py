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

DEFAULT, RECOMMENDED = "default", "recommended"
WITHOUT_MESHES = "shapes of mesh files left out"

_MODULES = {
    "mujoco": "bodycheck.adapters.importers.mujoco_import",
    "pybullet": "bodycheck.adapters.importers.pybullet_import",
    "dart": "bodycheck.adapters.importers.dart_import",
}


@dataclass(frozen=True)
class ImportedLink:
    """What an engine holds of a link: mass, centre (3,) in link axes, tensor (3, 3) about it in link axes.

    damping, limits: of the joint to its parent, in SI units; None where there is no such number.
    """

    name: str
    mass: float
    centre_m: Sequence[float]
    inertia_kg_m2: Sequence[Sequence[float]]
    damping: float | None = None
    limits: tuple[float, float] | None = None


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


def answered(engine: str, message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a worker's answer to a request `import`, with or without a spin."""
    reads = importer(engine)
    if reads is None:
        return {"outcome": "unsupported", "message": f"{engine} has no importer"}
    request = ImportRequest(**message["import"])
    if request.flags not in reads.FLAGS.get(request.format, {}):
        return {"outcome": "unsupported", "message": f"{engine} does not read {request.format}"}
    if "spin" in message:
        return {"outcome": "ok", "rotation": reads.spin(request, SpinRequest(**message["spin"])).tolist()}
    return {"outcome": "ok", "links": [_plain(link) for link in reads.imported_links(request)]}


def _plain(link: ImportedLink) -> dict[str, Any]:
    """Return a link as JSON can hold it: NaN and infinite numbers as text."""
    plain: dict[str, Any] = asdict(link)
    plain["mass"] = repr(float(link.mass))
    plain["centre_m"] = [repr(float(x)) for x in link.centre_m]
    plain["inertia_kg_m2"] = [[repr(float(x)) for x in row] for row in link.inertia_kg_m2]
    plain["limits"] = None if link.limits is None else [repr(float(x)) for x in link.limits]
    return plain


def imported_link(plain: Mapping[str, Any]) -> ImportedLink:
    """Return the link of a worker's answer; raises ValueError, TypeError or KeyError if it is not one."""
    centre, inertia = np.array(plain["centre_m"], float), np.array(plain["inertia_kg_m2"], float)
    if centre.shape != (3,) or inertia.shape != (3, 3):
        raise ValueError(
            f"link {plain['name']!r:.60} has a centre {centre.shape} and a tensor {inertia.shape}"
        )
    limits = plain.get("limits")
    return ImportedLink(
        str(plain["name"]),
        float(plain["mass"]),
        centre.tolist(),
        inertia.tolist(),
        None if plain.get("damping") is None else float(plain["damping"]),
        None if limits is None else (float(limits[0]), float(limits[1])),
    )
