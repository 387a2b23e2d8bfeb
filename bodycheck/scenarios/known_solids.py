"""Solids of mesh files that were worked out before: sealed lines beside the compiled kernels."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bodycheck.reference_impl.cache_home import cache_directory, digest_of
from bodycheck.reference_impl.mass_properties.solid import MassProperties
from bodycheck.reference_impl.seal import opened, sealed


def known_solid(name: str, work_out: Callable[[], MassProperties]) -> MassProperties:
    """Return the solid of a mesh file, from disk where it is there and whole, else worked out and kept.

    name: the file's hash and ending. What reads meshes and what integrates over them count too: another
    release of bodycheck, numpy or numba works it out anew. A folder that cannot be written keeps nothing.
    """
    code = digest_of(Path(__file__).parent / "mesh_files")[:16]
    libraries = "-".join(version(library) for library in ("numpy", "numba"))
    place = cache_directory() / "solids" / f"{code}-{libraries}-{name}"
    with suppress(OSError):
        kept = opened(place.read_bytes())
        if kept is not None:
            centre, inertia = np.array(kept["centre"]), np.array(kept["inertia"])
            return MassProperties(kept["mass"], centre, inertia, tuple(kept["notes"]))
    found = work_out()
    arrays = {"centre": found.centre.tolist(), "inertia": found.inertia.tolist()}
    with suppress(OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(sealed({"mass": found.mass, **arrays, "notes": list(found.notes)}))
    return found
