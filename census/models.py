"""Published models: what importers make of them, and certain errors that exact arithmetic confirms.

The confirmation has a reader of its own: the numbers of the element in the line of the finding, as fractions.
"""

from __future__ import annotations

import math
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from bodycheck._util.errors import InputError
from bodycheck.adapters.versions.uv import uv
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.audit.audit import Audit, LintFinding
from bodycheck.audit.audit_run import AuditOptions, checked_engines, imported_audit
from bodycheck.scenarios.model_files import read_model
from census.csv_rows import read_rows, write_rows
from census.finding import HERE
from census.imports import IMPORTS, ImportCount, counted, read_imports

PACKAGES, ERRORS = HERE / "packages.toml", HERE / "models.csv"
_SUFFIXES = (".urdf", ".xml", ".sdf", ".world")
_ROOTS = (b"<robot", b"<mujoco", b"<sdf")
_ALIKE = "random_urdfs"
"""Folder of 1,000 generated models of one link in pybullet_data, which are linted and not imported."""
Numbers = tuple[Fraction, list[Fraction]]
_ROUNDED = Fraction(1, 1000)
"""Relative error of the moments that a file may have by rounding its numbers."""
_LEAST = Fraction(1, 10**8)
"""Trace in kg m^2 below which a tensor stands for none."""


@dataclass(frozen=True)
class ModelError:
    """One error: the package, its version, the file, the line and the link, and how it was confirmed."""

    package: str
    version: str
    file: str
    line: int
    link: str
    rule: str
    message: str
    confirmed: str


def read_errors() -> list[ModelError]:
    """Return the errors of models.csv."""
    return read_rows(ERRORS, ModelError)


def audit_packages(names: list[str]) -> None:
    """Install, import, lint and confirm; replace the rows of these packages, of all without names."""
    versions: dict[str, str] = tomllib.loads(PACKAGES.read_text(encoding="utf-8"))
    if unknown := [name for name in names if name not in versions]:
        raise InputError(f"{unknown[0]!r} is not in {PACKAGES}: {', '.join(versions)}")
    for name in names or list(versions):
        with tempfile.TemporaryDirectory() as folder:
            uv("pip", "install", "--no-deps", "--target", folder, f"{name}=={versions[name]}")
            audits = list(audits_of(Path(folder)))
            errors = [
                one for audit in audits for one in confirmed_errors(audit, Path(folder), name, versions[name])
            ]
        print(f"{name} {versions[name]}: {len(audits)} files, {len(errors)} confirmed errors", flush=True)
        imports = [one for one in read_imports() if one.package != name]
        write_rows(IMPORTS, ImportCount, [*imports, *counted(name, versions[name], audits)])
        errors += (one for one in read_errors() if one.package != name)
        errors.sort(key=lambda one: (one.package, one.file, one.line))
        write_rows(ERRORS, ModelError, errors)


def audits_of(folder: Path) -> Iterator[Audit]:
    """Yield the audit of each model file below a folder, by all installed importers."""
    options = AuditOptions(spins=False, matrices=False)
    with closing(EnginePool()) as pool, np.errstate(all="ignore"):
        for path in sorted(
            path for path in folder.rglob("*") if path.suffix in _SUFFIXES and _is_model(path)
        ):
            engines = [] if _ALIKE in path.parts else checked_engines(None)
            try:
                yield imported_audit(pool, read_model(path), engines, options)
            except InputError:
                continue  # an include without a root of its own, or not a model


def confirmed_errors(audit: Audit, folder: Path, package: str, version: str) -> Iterator[ModelError]:
    """Yield the certain errors of a file that exact arithmetic confirms."""
    path = Path(audit.file)
    for one in filter(_is_certain, audit.findings):
        place = Path(one.file) if Path(one.file).is_absolute() else path.parent / one.file
        if why := confirmation(place if place.is_file() else path, one):
            name = path.relative_to(folder).as_posix()
            yield ModelError(package, version, name, one.line, one.link, one.rule, one.message, why)


def _is_model(path: Path) -> bool:
    return path.is_file() and any(root in path.read_bytes() for root in _ROOTS)


def _is_certain(one: LintFinding) -> bool:
    return one.severity == "error" and one.confidence == "certain"


def confirmation(path: Path, finding: LintFinding) -> str:
    """Return why the numbers in the file itself are impossible, in exact arithmetic; empty if they are not.

    A tensor I is that of a body only if tr(I)/2 - I has no negative principal minor, and of a body within the
    distance r of its centre of mass only if its trace is at most 2 m r^2; both are given a part in 1000.
    """
    for mass, tensor in _numbers(path, finding):
        if abs(tensor[0] + tensor[3] + tensor[5]) < _LEAST:
            continue
        if mass < 0:
            return f"mass {float(mass):g} kg"
        if (least := min(_minors(tensor))) < 0:
            return f"tr(I)/2 - I has the principal minor {float(least):.3g}"
        if finding.rule == "beyond-shape" and (reach := _reach_squared(path, finding)) is not None:
            trace = tensor[0] + tensor[3] + tensor[5]
            if mass > 0 and trace > 2 * mass * reach * (1 + _ROUNDED):
                return f"tr(I) = {float(trace):.4g} exceeds 2 m r^2 = {float(2 * mass * reach):.4g} kg m^2"
    return ""


def _minors(tensor: list[Fraction]) -> Iterator[Fraction]:
    """Yield the principal minors of J = tr(I)/2 - I, of I as xx, xy, xz, yy, yz, zz."""
    half = (tensor[0] + tensor[3] + tensor[5]) / 2 * (1 + _ROUNDED)
    xx, xy, xz, yy, yz, zz = (
        half - tensor[0], -tensor[1], -tensor[2], half - tensor[3], -tensor[4], half - tensor[5],
    )  # fmt: skip
    yield from (xx, yy, zz)
    yield from (xx * yy - xy * xy, xx * zz - xz * xz, yy * zz - yz * yz)
    yield xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)


def _link(path: Path, finding: LintFinding) -> etree._Element | None:
    root = etree.fromstring(path.read_bytes(), etree.XMLParser(resolve_entities=False, recover=True))
    name = finding.link.rpartition("::")[2].rpartition("/")[2]
    named = [one for one in root.iter("link", "body") if one.get("name") == name]
    return named[0] if len(named) == 1 else None


def _numbers(path: Path, finding: LintFinding) -> Iterator[Numbers]:
    """Yield mass and xx, xy, xz, yy, yz, zz of the link with this name, where the file states both."""
    link = _link(path, finding)
    inertial = None if link is None else link.find("inertial")
    if inertial is None:
        return
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia, mass = inertial.find("inertia"), inertial.find("mass")
    try:
        if inertia is not None and mass is not None:
            texts = [inertia.get(key) or inertia.findtext(key) or "0" for key in keys]
            yield (
                Fraction((mass.get("value") or mass.text or "").strip()),
                [Fraction(t.strip()) for t in texts],
            )
        elif (full := inertial.get("fullinertia")) is not None:
            xx, yy, zz, xy, xz, yz = map(Fraction, full.split())
            yield Fraction(inertial.get("mass")), [xx, xy, xz, yy, yz, zz]
        elif (diagonal := inertial.get("diaginertia")) is not None:
            x, y, z = map(Fraction, diagonal.split())
            yield Fraction(inertial.get("mass")), [x, Fraction(0), Fraction(0), y, Fraction(0), z]
    except (ValueError, TypeError):
        return


def _reach_squared(path: Path, finding: LintFinding) -> Fraction | None:
    """Return an upper bound of r^2 of a URDF link, whatever turns its shapes; None if a shape cannot be read.

    r is at most the distance of the centre of mass from a shape's origin plus the shape's own reach.
    """
    link = _link(path, finding)
    if link is None or link.tag != "link":
        return None
    centre = _vector(link.find("inertial/origin"))
    reaches = []
    for shape in (*link.iter("collision"), *link.iter("visual")):
        own = _own_reach(shape.find("geometry"), path.parent)
        if own is None:
            return None
        offset = [float(a - b) for a, b in zip(_vector(shape.find("origin")), centre, strict=True)]
        reaches.append((math.hypot(*offset) + own) * (1 + 1e-12))
    return Fraction(max(reaches)) ** 2 if reaches else None


def _vector(origin: etree._Element | None) -> list[Fraction]:
    text = None if origin is None else origin.get("xyz")
    return [Fraction(one) for one in text.split()] if text else [Fraction(0)] * 3


def _own_reach(geometry: etree._Element | None, folder: Path) -> float | None:
    """Return the distance of the farthest point of a box, cylinder, sphere or mesh from its origin."""
    for shape in [] if geometry is None else geometry.iterchildren(tag=etree.Element):
        if shape.tag == "box":
            return math.hypot(*(float(one) / 2 for one in shape.get("size", "").split()))
        if shape.tag == "cylinder":
            return math.hypot(float(shape.get("radius")), float(shape.get("length")) / 2)
        if shape.tag == "sphere":
            return float(shape.get("radius"))
        if shape.tag == "mesh":
            scale = [float(one) for one in shape.get("scale", "1 1 1").split()]
            points = _vertices(folder, shape.get("filename", ""))
            return None if points is None else float(np.max(np.linalg.norm(points * scale, axis=1)))
    return None


def _vertices(folder: Path, name: str) -> NDArray[np.float64] | None:
    """Return the vertices of an OBJ or binary STL file next to a model, or in the package that it names."""
    parts = Path(name.removeprefix("package://")).parts
    places = [folder / name] if "://" not in name else [up.joinpath(*parts) for up in folder.parents]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return None
    if path.suffix.lower() == ".obj":
        lines = path.read_text(errors="replace").splitlines()
        return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=float)
    content = path.read_bytes()
    if path.suffix.lower() != ".stl" or content[:5] == b"solid":
        return None
    triangles = np.frombuffer(
        content[84:], dtype=[("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("end", "<u2")]
    )
    return triangles["points"].reshape(-1, 3).astype(float)
