"""Compare the bodies that two model files state, such as a USD stage and the URDF that it was made of."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from hashlib import sha256
from itertools import permutations, product
from pathlib import Path
from typing import TypeAlias

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number
from bodycheck._util.untrusted import read_bytes
from bodycheck.adapters.importers import ImportedLink
from bodycheck.audit.audit import (
    SAME,
    SINGLE,
    Audit,
    Body,
    Difference,
    ImporterColumn,
    JointAudit,
    LinkImport,
    State,
)
from bodycheck.audit.audit_joints import HeldJoints, audited_joints
from bodycheck.audit.audit_matrix import compared_matrices, matrices_of_file
from bodycheck.audit.audit_run import Imported, compared, link_audit
from bodycheck.audit.causes import body_causes, with_issue
from bodycheck.audit.lint import lint
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.exact_arithmetic import Frame, doubles
from bodycheck.scenarios.model_files.model_file import Format, ModelFile, ModelLink

_FRAME = 1e-6
"""m and rad up to which two link frames are the same: USD stores quaternions in single precision."""


def audit_against(path: Path, other_path: Path) -> Audit:
    """Return the audit of a file whose bodies are compared with those of another, in place of importers.

    The findings are about the first file. Raises InputError if a file cannot be read, or if no link of one
    has the name of a link of the other.
    """
    model, other = read_model(path), read_model(other_path)
    links = _named(model, other)
    if not links:
        raise InputError(f"{path}: no link has the name of a link of {other_path}")
    every = _as_held(model)
    place = {link.name: index for index, link in enumerate(model.links)}
    held = {name: replace(every[place[link.name]], name=name) for name, link in links.items()}
    column = ImporterColumn(path.name, "", "", f"as the {model.format.upper()} file states them", "ok")
    imported = Imported(column, held)
    moved = _moved(model, other, links)
    audited = []
    for link in other.links:
        one = link_audit(other, link, [])
        twin = links.get(link.name)
        if twin is not None and twin.unread:
            comparison = LinkImport("not computed", causes=(twin.unread,))
        else:
            comparison = _explained(other, link, imported, moved.get(link.name), twin, model.format)
        audited.append(replace(one, held={column.name: comparison}))
    extra = tuple(link.name for link in model.links if link not in links.values())
    joints: list[JointAudit] = []
    orders: dict[str, list[str]] = {}
    matrices = {}
    if "usd" not in (model.format, other.format):  # whose joints are read as kinds only
        its = HeldJoints(every, {name: place[link.name] for name, link in links.items()})
        joints, orders = audited_joints(other, {column.name: ("", its)})
        matrices = {column.name: compared_matrices(other, its, *matrices_of_file(model))}
    return Audit(
        str(other.path),
        other.format,
        sha256(read_bytes(other.path)).hexdigest(),
        (column,),
        tuple(audited),
        tuple(lint(model)),
        tuple(str(one) for one in (*model.outside(), *other.outside())),
        (*model.notes, *other.notes),
        {column.name: extra} if extra else {},
        str(model.path),
        joints,
        matrices,
        orders,
    )


def _named(model: ModelFile, other: ModelFile) -> dict[str, ModelLink]:
    """Return name in the other file -> link, also of names that were made identifiers."""
    plain = {_identifier(link.name): link for link in model.links}
    pairs = (
        (link.name, model.by_name.get(link.name) or plain.get(_identifier(link.name))) for link in other.links
    )
    return {name: link for name, link in pairs if link is not None}


def _identifier(name: str) -> str:
    return re.sub(r"\W", "_", name.rpartition("::")[2])


def _as_held(model: ModelFile) -> list[ImportedLink]:
    """Return the links of a file as an importer would hold them."""
    place = {link.name: index for index, link in enumerate(model.links)}
    found = []
    for link in model.links:
        stated = link.stated
        body = Body(0.0, np.zeros(3), np.zeros((3, 3))) if stated is None else Body.of(stated.in_link)
        found.append(
            ImportedLink(
                link.name,
                body.mass_kg,
                body.centre_m.tolist(),
                body.inertia_kg_m2.tolist(),
                doubles(model.placed[link.name].position).tolist(),
                doubles(model.placed[link.name].rotation).tolist(),
                -1 if link.parent is None else place[link.parent],
                link.joints,
            )
        )
    return found


def _explained(
    other: ModelFile,
    link: ModelLink,
    imported: Imported,
    moved: Frame | None,
    twin: ModelLink | None,
    form: Format,
) -> LinkImport:
    """Return the comparison of a link, with causes of differences between files."""
    found = compared(other, link, imported)
    expected, held, difference = found.expected, found.held, found.difference
    if expected is None or held is None or difference is None or difference.largest <= SINGLE:
        return found
    if twin is not None and twin.stated is None:
        return replace(found, causes=("states no inertia",))
    if moved is not None and twin is not None and twin.stated is not None:
        placed = Body.of(twin.stated.in_link.placed(moved))
        there = Difference.between(expected, placed)
        if there.largest <= SINGLE:
            state: State = "agrees" if there.largest <= SAME else "rounded"
            return replace(found, state=state, held=placed, difference=there, causes=(_described(moved),))
    members = other.members(
        link.name, frozenset(one.name for one in other.links if one.name not in imported.links)
    )

    def others(rest: Body, remaining: Difference) -> tuple[str, ...]:
        causes = body_causes(other, members, expected, rest, remaining, "")
        return tuple(with_issue(form, cause) for cause in causes)

    return replace(found, causes=file_causes(expected, held, others))


def _moved(model: ModelFile, other: ModelFile, links: Mapping[str, ModelLink]) -> dict[str, Frame]:
    """Return the pose of each link frame of a file in that of the other, where they differ.

    Both files are taken as posed alike, relative to the first link that both have.
    """
    here, there = model.placed, other.placed
    first = next(iter(links))
    ours, theirs = here[links[first].name].inverse(), there[first].inverse()
    found = {}
    for name, link in links.items():
        moved = (theirs @ there[name]).inverse() @ (ours @ here[link.name])
        if _angle(moved) > _FRAME or _distance(moved) > _FRAME:
            found[name] = moved
    return found


def _angle(frame: Frame) -> float:
    R = doubles(frame.rotation)
    return float(np.arctan2(np.linalg.norm(R - R.T) / 2.0**1.5, (np.trace(R) - 1.0) / 2.0))


def _distance(frame: Frame) -> float:
    return float(np.linalg.norm(doubles(frame.position)))


def _described(moved: Frame) -> str:
    return (
        "the same body: only the link frame is another, turned by "
        f"{number(float(np.degrees(_angle(moved))), 4)} degrees and moved by {number(_distance(moved), 4)} m"
    )


_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}
_MASSES = {"g": 1e-3, "lb": 0.45359237}

Others: TypeAlias = Callable[[Body, Difference], tuple[str, ...]]


def file_causes(expected: Body, held: Body, others: Others) -> tuple[str, ...]:
    """Return the causes of a difference between the body of one file and that of another.

    Wrong units are divided out first, so that they hide no other fault; `others` names the causes of what
    remains.
    """
    found = []
    mass = _ratio(held.mass_kg, expected.mass_kg)
    centre = _parallel(held.centre_m, expected.centre_m)
    tensor = _ratio(float(np.trace(held.inertia_kg_m2)), float(np.trace(expected.inertia_kg_m2)))
    factors = []
    for what, ratio, powers in (
        ("mass", mass, (1, 0)),
        ("centre of mass", centre, (0, 1)),
        ("tensor", tensor, (1, 2)),
    ):
        factor, unit = next(
            ((value, text) for value, text in _units(*powers) if abs(ratio - value) <= 2.0 * SINGLE * value),
            (1.0, ""),
        )
        factors.append(factor)
        if unit:
            found.append(f"{what} times {number(factor, 6)}: {unit}")
    rest = Body(held.mass_kg / factors[0], held.centre_m / factors[1], held.inertia_kg_m2 / factors[2])
    difference = Difference.between(expected, rest)
    if found and difference.largest <= SINGLE:
        return tuple(found)
    if turn := _turn(expected, rest):
        return (*found, turn)
    return (*found, *others(rest, difference))


def _ratio(held: float, expected: float) -> float:
    return held / expected if expected else 1.0


def _parallel(held: Array, expected: Array) -> float:
    """Return |held| / |expected| of parallel vectors, else 1."""
    norms = float(np.linalg.norm(held)), float(np.linalg.norm(expected))
    if not norms[0] > 0.0 < norms[1] or float(held @ expected) < norms[0] * norms[1] * (1.0 - SINGLE**2):
        return 1.0
    return norms[0] / norms[1]


def _units(mass_power: int, length_power: int) -> Iterator[tuple[float, str]]:
    """Yield each factor that a wrong unit makes of a quantity kg^a m^b, and what it means."""
    lengths = {"m": 1.0} | (_LENGTHS if length_power else {})
    masses = {"kg": 1.0} | (_MASSES if mass_power else {})
    for (mass, kilogram), (length, metre) in product(masses.items(), lengths.items()):
        for power in range(1, length_power + 1) if metre != 1.0 else (length_power,):
            factor = kilogram * metre**power
            if factor == 1.0:
                continue
            unit = " ".join(filter(None, (mass if mass_power else "", _raised(length, power))))
            si = " ".join(filter(None, ("kg" if mass_power else "", _raised("m", power))))
            yield 1.0 / factor, f"{unit} taken as {si}"
            yield factor, f"{si} taken as {unit}"


def _raised(unit: str, power: int) -> str:
    return "" if power == 0 else unit if power == 1 else f"{unit}^{power}"


def _turn(expected: Body, held: Body) -> str:
    """Return the exchange of axes that turns a body, or its tensor alone, into another; "" if none does."""
    for whole, R in product((True, False), sorted(_exchanges(), key=_order)):
        centre = R @ expected.centre_m if whole else expected.centre_m
        turned = Body(expected.mass_kg, centre, R @ expected.inertia_kg_m2 @ R.T)
        if Difference.between(turned, held).largest <= SINGLE < Difference.between(expected, turned).largest:
            what = "the body" if whole else "the tensor"
            names = [("-" if row.sum() < 0 else "") + "xyz"[int(np.abs(row).argmax())] for row in R]
            up = " (one is up in place of the other)" if _about_x(R) else ""
            return f"axes of {what} exchanged: ({', '.join(names)}) in place of (x, y, z){up}"
    return ""


def _exchanges() -> Iterator[Array]:
    """Yield the 24 rotations that map axes onto axes."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[range(3), order] = signs
        if np.linalg.det(R) > 0.0:
            yield R


def _about_x(R: Array) -> bool:
    return bool(R[0, 0] == 1.0 and R[1, 1] == 0.0)


def _order(R: Array) -> tuple[bool, float]:
    """Return the rank of an exchange: the one between y up and z up first, then the smallest angles."""
    return not _about_x(R), math.acos(max(-1.0, min(1.0, (float(np.trace(R)) - 1.0) / 2.0)))
