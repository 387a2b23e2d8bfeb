"""An audit as a document, as data with all digits, and as SARIF."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bodycheck._util.formatting import count, names, number, scientific, vector
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reports.alerts import Alert
from bodycheck.reports.audit.audit import SAME, SINGLE, Audit, Body, Comparison, Difference, LinkAudit, Spin
from bodycheck.reports.audit.audit_summary import (
    LEVELS,
    TINTS,
    answer,
    by_severity,
    impossible,
    repeated,
)
from bodycheck.reports.document import Cell, Column, Document, Sentence, Span, Table

_MAX_FINDINGS = 40


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
            _spins(audit),
            _importers(audit),
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
        summary = names([f"{amount} {state}" for state, amount in states.items()])
        result: Cell = summary or Span(f"{one.outcome}: {one.message}", "fault")
        rows.append((one.name, one.version, result, one.settings))
    if audit.compared:
        files = tuple((name, result) for name, _, result, _ in rows)
        return Table((Column("file", "fixed"), Column("result")), files, "Compared file")
    return Table(columns, tuple(rows), "Importers")


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
    for link in audit.links:
        for name, one in link.held.items():
            if one.state in ("differs", "absent") and (link.name, name) not in known:
                rows.append(
                    (link.name, name, *_relative(one.difference), Span("; ".join(one.causes), tint_of(one)))
                )
    file = Path(audit.file).name if audit.compared else "the file"
    return Table(columns, tuple(rows), f"Differences, relative to {file}")


def _relative(difference: Difference | None) -> tuple[str, str, str]:
    if difference is None:
        return "", "", ""
    mass, centre, inertia = (
        "0" if value <= SAME else scientific(value)
        for value in (difference.mass, difference.centre, difference.inertia)
    )
    return mass, centre, inertia


def tint_of(comparison: Comparison) -> str:
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
        Column("file's numbers", "number"),
        Column("held", "number"),
        Column("excerpt", "number"),
    )
    rows = []
    known = repeated(audit)
    for link in audit.links:
        for name, spin in link.spins.items():
            if spin.deviates and (link.name, name) not in known:
                cells = (_spin_cell(spin, error) for error in (spin.held_rad, spin.excerpt_rad))
                rows.append((link.name, name, _radians(spin.control_rad), *cells))
    return Table(columns, tuple(rows), "Free spins that deviate from the truth, rad after 1 s")


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


def _comparison_data(one: Comparison) -> dict[str, Any]:
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
    return found


def failures(audit: Audit, fail_on: Sequence[str]) -> list[str]:
    """Return what an audit fails on: impossible numbers, findings of a severity or above, and differences."""
    if "never" in fail_on:
        return []
    found = []
    limits = [LEVELS.index(level) for level in LEVELS if level in fail_on]
    bad = [one for one in audit.findings if limits and LEVELS.index(one.severity) <= max(limits)]
    if bad := bad or impossible(audit):
        found.append(count(len(bad), "finding"))
    if "difference" in fail_on:
        differing = audit.differing()
        found += [count(len(differing), "difference")] if differing else []
        found += [f"{names(audit.failed)} did not import the file"] if audit.failed else []
    return found
