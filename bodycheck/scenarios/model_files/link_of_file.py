"""One link of a URDF or MJCF file as the body of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from importlib.resources.abc import Traversable
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion

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


def link_of_file(folder: Traversable, file: str, kind: str, name: str | None) -> LinkOfFile:
    """Return a link of a model file in a folder; name None: the only one with an inertia.

    Raises InputError with one line if the file, its format or the link is wrong.
    """
    # importing lxml and mpmath takes time, and few scenarios name model files
    from bodycheck.scenarios.model_files.exact import doubles
    from bodycheck.scenarios.model_files.model_reader import read_model

    path = Path(str(folder)) / file
    model = read_model(path)
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
        sha256(path.read_bytes()).hexdigest(),
        float(body.mass),
        tuple(doubles(body.centre).tolist()),
        tuple(tuple(row) for row in tensor.tolist()),
        tuple(filter(None, (derived, *(f"also read {other}" for other in model.outside())))),
    )
