"""An audit as a document, as data with all digits, and as SARIF."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

from bodycheck._util.formatting import count, names, number, scientific, vector
from bodycheck.audit.audit import (
    SAME,
    SINGLE,
    Audit,
    Body,
    Difference,
    LinkAudit,
    LinkImport,
    Spin,
)
from bodycheck.audit.audit_summary import (
    LEVELS,
    TINTS,
    answer,
    by_severity,
    joint_groups,
    moving_joints,
    repeated,
    said_once,
)
from bodycheck.audit.joint_causes import QUANTITIES
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reports.alerts import Alert
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.table_layout import Cell, Column, Span
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint

_MAX_FINDINGS = 40
_MAX_JOINTS = 12
_MOST_JOINTS = 3  # names in a cell


def audit_document(audit: Audit, machines: Sequence[str] = ()) -> Document:
    """Return the document: the answer, then findings, differences, spins that differ, importers.

    machines: how the machines of merged shards differ.
    """
    title = f"{Path(audit.file).name}: import audit"
    if audit.compared:
        title = f"{Path(audit.compared).name}: compared with {Path(audit.file).name}"
    return Document(
        title,
        (
            *answer(audit),
            *_remarks(audit),
            *map(Sentence, machines),
            _findings(audit),
            _differences(audit),
            _joint_differences(audit),
            _matrices(audit),
            _spins(audit),
            _importers(audit),
            *([_joints(audit)] if audit.format != "usd" else []),
            *([_bodies(audit)] if audit.format == "usd" and not audit.columns else []),
        ),
    )


def _remarks(audit: Audit) -> list[Sentence]:
    found = []
    unread = [link for link in audit.links if link.unread]
    if unread:
        names_ = names([f"{link.name} ({link.unread})" for link in unread])
        found.append(Sentence(f"Not computed, and so not compared: {names_}."))
    if audit.outside:
        found.append(Sentence(f"Names files outside of its folder: {names(list(audit.outside))}."))
    found += [Sentence(note) for note in audit.notes]
    for name, extra in audit.extra.items():
        found.append(Sentence(f"{name} also has links that the file does not name: {names(list(extra))}."))
    orders: dict[tuple[str, ...], list[str]] = {}
    for name, order in audit.orders.items():
        orders.setdefault(tuple(order), []).append(name)
    for order, importers in orders.items():
        own = [joint.stated.name for joint in audit.joints if joint.stated.name in set(order)]
        held, stated = next(pair for pair in zip(order, own, strict=True) if len(set(pair)) > 1)
        found.append(
            Sentence(f"Joints in another order: {names(importers)} with {held} where the file has {stated}.")
        )
    return [*found, *_not_spun(audit)]


def _not_spun(audit: Audit) -> list[Sentence]:
    """Name the links that an importer read, but that could not be spun alone."""
    links: dict[str, list[str]] = {}
    for link in audit.links:
        for name, spin in link.spins.items():
            if spin.message and name not in audit.failed:
                links.setdefault(spin.message, []).append(f"{link.name} in {name}")
    return [Sentence(f"Not spun: {names(where)} ({why}).") for why, where in links.items()]


def _bodies(audit: Audit) -> Table:
    """Return the bodies of a stage, whose numbers a reader does not find in the file as text."""
    columns = (
        Column("link", "name"),
        Column("mass, kg", "number"),
        Column("centre, m"),
        Column("principal moments, kg m^2"),
        Column("principal axes, as a quaternion (w, x, y, z)"),
    )
    rows = []
    for link in audit.links:
        if link.stated is not None:
            moments, axes = link.stated.principal
            centre, quaternion = link.stated.centre_m, matrix_to_quaternion(axes)
            mass = number(link.stated.mass_kg, 6)
            rows.append((link.name, mass, vector(centre), vector(moments), vector(quaternion)))
    return Table(columns, tuple(rows), "Rigid bodies")


def _importers(audit: Audit) -> Table:
    columns = (Column("importer", "fixed"), Column("version"), Column("result"), Column("import"))
    rows = []
    for one in audit.columns:
        states = Counter(link.held[one.name].state for link in audit.links if one.name in link.held)
        summary = names([f"{amount} {_state_of(amount, state)}" for state, amount in states.items()])
        result: Cell = summary or Span(f"{one.outcome}: {one.message}", "fault")
        rows.append((one.name, one.version, result, one.settings))
    if audit.compared:
        files = tuple((name, result) for name, _, result, _ in rows)
        return Table((Column("file", "fixed"), Column("result")), files, "Compared file")
    return Table(columns, tuple(rows), "Importers")


def _state_of(amount: int, state: str) -> str:
    return state if amount == 1 else state.removesuffix("s")


def _differences(audit: Audit) -> Table:
    columns = (
        Column("link", "name"),
        Column("file" if audit.compared else "importer", "fixed"),
        Column("mass", "number"),
        Column("centre", "number"),
        Column("tensor", "number"),
        Column("cause"),
    )
    rows = []
    known = repeated(audit)
    for name in said_once(audit):
        links = [link for link in audit.links if (link.name, name) in known]
        own = [link.held[name] for link in links]
        largest = Difference(
            *map(max, zip(*(astuple(one.difference) for one in own if one.difference), strict=True))
        )
        cause = Span(own[0].causes[0].partition(":")[0], "bad")
        place = f"{len(links)} links, at most" if len(links) > 1 else links[0].name
        rows.append((place, name, *_relative(largest), cause))
    for link in audit.links:
        for name, one in link.held.items():
            if one.state in ("differs", "absent") and (link.name, name) not in known:
                rows.append(
                    (link.name, name, *_relative(one.difference), Span("; ".join(one.causes), tint_of(one)))
                )
    file = Path(audit.file).name if audit.compared else "the file"
    return Table(columns, tuple(rows), f"Differences, relative to {file}")


def _joint_differences(audit: Audit) -> Table:
    columns = (
        Column("file" if audit.compared else "importer", "fixed"),
        Column("joints", "number"),
        Column("difference"),
        Column("in"),
    )
    rows = []
    for group in joint_groups(audit):
        text = group.first if group.same else f"{group.kind}, such as {group.first.partition(': ')[2]}"
        rows.append((group.importer, str(len(group.joints)), Span(text, "bad"), _some(group.joints)))
    missing: dict[tuple[str, str], list[str]] = {}
    for joint in audit.joints:
        for importer, one in joint.held.items():
            for text in one.not_held:
                missing.setdefault((importer, text.partition(":")[0]), []).append(joint.name)
    for (importer, text), joints in missing.items():
        rows.append((importer, str(len(joints)), Span(text, "open"), _some(joints)))
    title = f"Joints that differ{', and what importers do not hold' * bool(missing)}"
    return Table(columns, tuple(rows), title)


def _some(joints: Sequence[str]) -> str:
    more = len(joints) - _MOST_JOINTS
    return names([*joints[:_MOST_JOINTS], *([f"{more} more"] if more > 0 else [])])


def _matrices(audit: Audit) -> Table:
    columns = (
        Column("importer", "name"),
        Column("difference", "number"),
        Column("largest in"),
        Column("cause"),
    )
    rows: list[tuple[Cell, ...]] = []
    not_compared: dict[str, list[str]] = {}
    for name, one in audit.matrices.items():
        if one.deviation is None:
            not_compared.setdefault(one.cause, []).append(name)
        else:
            tint = "bad" if one.differs else "good"
            rows.append((name, Span(scientific(one.deviation), tint), names(list(one.joints)), one.cause))
    rows += [(names(where), "", "", f"not compared: {why}") for why, where in not_compared.items()]
    return Table(columns, tuple(rows), "Mass matrix at random configurations, relative to that of the file")


def _joints(audit: Audit) -> Table:
    columns = (Column("joint", "name"), Column("kind", "fixed"), Column("in the file"))
    rows = [
        (joint.name, joint.stated.kind, ", ".join(joint_numbers(joint.stated)))
        for joint in moving_joints(audit)
    ]
    rest = "--json has all of them"
    return Table(columns, tuple(rows), "Joints in the file", max_rows=_MAX_JOINTS, rest=rest)


def joint_numbers(joint: StatedJoint) -> list[str]:
    """Return what is stated or held of a joint in words, without what is neutral."""
    found = [] if joint.axis is None else [f"axis {vector(joint.axis)}"]
    found += [f"at {vector(joint.at_m)} m"] if any(joint.at_m) else []
    if joint.limits is not None and joint.limits != UNLIMITED:
        found.append(f"limits [{number(joint.limits[0], 4)}, {number(joint.limits[1], 4)}]")
    for one in QUANTITIES:
        value = getattr(joint, one.attribute)
        if value is not None and value != one.neutral:
            found.append(f"{one.name} {number(value, 4)}")
    if joint.mimic is not None:
        found.append(f"follows {joint.mimic[0] or 'another joint'}")
    if joint.gains is not None and any(joint.gains):
        found.append(f"gains {number(joint.gains[0], 4)} and {number(joint.gains[1], 4)}")
    return found


def _relative(difference: Difference | None) -> tuple[str, str, str]:
    if difference is None:
        return "", "", ""
    mass, centre, inertia = (
        "0" if value <= SAME else scientific(value)
        for value in (difference.mass, difference.centre, difference.inertia)
    )
    return mass, centre, inertia


def tint_of(comparison: LinkImport) -> str:
    """Return the tint of a comparison: how far the held body is from the file's."""
    match comparison.state:
        case "agrees":
            return "good"
        case "rounded":
            return "floor"
        case "merged" | "not computed":
            return "none"
        case "absent":
            return "fault"
    largest = math.inf if comparison.difference is None else comparison.difference.largest
    return "open" if largest < 1e-2 else "bad"


def _spins(audit: Audit) -> Table:
    columns = (
        Column("link", "name"),
        Column("importer", "fixed"),
        Column("engine's own error", "number"),
        Column("as imported", "number"),
        Column("imported alone", "number"),
    )
    rows = []
    known = repeated(audit)
    for link in audit.links:
        for name, spin in link.spins.items():
            if spin.deviates and (link.name, name) not in known:
                cells = (_spin_cell(spin, error) for error in (spin.held_rad, spin.excerpt_rad))
                rows.append((link.name, name, _radians(spin.control_rad), *cells))
    return Table(
        columns, tuple(rows), "Links that turn otherwise than in the file: rad off after a free spin of 1 s"
    )


def _radians(value: float | None) -> str:
    return "" if value is None else scientific(value)


def _spin_cell(spin: Spin, error_rad: float | None) -> Cell:
    return Span(_radians(error_rad), "bad" if spin.follows(error_rad) is False else "none")


def _findings(audit: Audit) -> Table:
    columns = (
        Column("place", "fixed"),
        Column("link", "name"),
        Column("finding"),
        Column("expected"),
    )
    rows = tuple(
        (
            f"{Path(one.file).name}:{one.line}",
            one.link,
            (
                Span(f"{one.rule} ({one.severity}, {one.confidence}): ", TINTS[one.severity]),
                Span(one.message),
            ),
            one.expected,
        )
        for one in by_severity(audit.findings)
    )
    rest = "--json has all of them"
    return Table(columns, rows, "Findings in the file", max_rows=_MAX_FINDINGS, rest=rest)


# ------------------------------------------------------------------------------------------------------ data


def audit_data(audit: Audit) -> dict[str, Any]:
    """Return everything with all digits."""
    return {
        "file": audit.file,
        "format": audit.format,
        "sha256": audit.sha256,
        "same": SAME,
        "single_precision": SINGLE,
        "importers": [{"name": one.name, **vars(one)} for one in audit.columns],
        "links": [_link_data(link) for link in audit.links],
        "findings": [vars(one) for one in audit.findings],
        "outside": list(audit.outside),
        "notes": list(audit.notes),
        "links_not_in_file": {name: list(extra) for name, extra in audit.extra.items()},
        "joints": [asdict(joint) for joint in audit.joints],
        "mass_matrices": {name: vars(one) for name, one in audit.matrices.items()},
        "joint_orders": {name: list(order) for name, order in audit.orders.items()},
    }


def _link_data(link: LinkAudit) -> dict[str, Any]:
    return {
        "name": link.name,
        "line": link.line,
        "stated": body_data(link.stated),
        "derived": link.derived,
        "not_computed": link.unread,
        "held": {name: _comparison_data(one) for name, one in link.held.items()},
        "spins": {name: vars(one) for name, one in link.spins.items()},
    }


def body_data(body: Body | None) -> dict[str, Any] | None:
    """Return mass, centre, tensor, principal moments and axes (one per row)."""
    if body is None:
        return None
    moments, axes = body.principal
    return {
        "mass_kg": body.mass_kg,
        "centre_m": body.centre_m.tolist(),
        "inertia_kg_m2": body.inertia_kg_m2.tolist(),
        "principal_moments_kg_m2": moments.tolist(),
        "principal_axes": axes.T.tolist(),
    }


def _comparison_data(one: LinkImport) -> dict[str, Any]:
    return {
        "state": one.state,
        "expected": body_data(one.expected),
        "body": body_data(one.held),
        "difference": None if one.difference is None else {**vars(one.difference)},
        "causes": list(one.causes),
        "merged": list(one.merged),
        "merged_into": one.into,
    }


def alerts_of(audit: Audit, *, differences: bool) -> list[Alert]:
    """Return findings, and on request the differences of importers, with their places in the file."""
    found = []
    for one in audit.findings:
        expected = f"; expected: {one.expected}" if one.expected else ""
        text = f"{one.link}: {one.message}{expected}"
        found.append(Alert(one.rule, text, one.severity, Path(one.file), one.line))
    for link, name, why in audit.differing() if differences else ():
        text = f"{link.name}: {name} imported a different body: {why}"
        found.append(Alert("import-difference", text, "warning", Path(audit.file), link.line))
    for joint, name, cause in audit.differing_joints() if differences else ():
        text = f"{joint.name}: {name}: {cause}"
        found.append(Alert("joint-difference", text, "warning", Path(audit.file), joint.stated.line))
    return found


def failures(audit: Audit, fail_on: Sequence[str]) -> list[str]:
    """Return what an audit fails on: errors, findings of a lower severity, and differences."""
    if "never" in fail_on:
        return []
    found = []
    least = max(LEVELS.index(level) for level in LEVELS if level == "error" or level in fail_on)
    if bad := [one for one in audit.findings if LEVELS.index(one.severity) <= least]:
        found.append(count(len(bad), "finding"))
    if "difference" in fail_on:
        wrong = [name for name, one in audit.matrices.items() if one.is_wrong]
        differing = [*audit.differing(), *audit.differing_joints(), *wrong]
        found += [count(len(differing), "difference")] if differing else []
        found += [f"{names(audit.failed)} did not import the file"] if audit.failed else []
    return found
