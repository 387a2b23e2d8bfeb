"""Compare the bodies that two model files state, such as a USD stage and the URDF that it was made of."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

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
from bodycheck.audit.file_causes import file_causes
from bodycheck.audit.lint import lint
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
