"""The page of an audit: one row per link, one column per importer or file, and ellipsoids of inertia."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape

from bodycheck._util.formatting import number, scientific
from bodycheck.audit.audit import Audit, Body, JointAudit, LinkAudit, LinkImport, LintFinding
from bodycheck.audit.audit_document import audit_document, joint_numbers, tint_of
from bodycheck.audit.audit_summary import TINTS, by_severity, impossible, moving_joints, repeated
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.document import page
from bodycheck.reports.render.styles import engine_colour

_VIEW = 110.0  # side of a drawing in px
_POINTS = 48
_CAMERA = (math.radians(-60.0), math.radians(25.0))  # azimuth, elevation


@dataclass(frozen=True)
class _Cell:
    """A cell of the map: tint, what it says, the causes, the numbers and a drawing."""

    tint: str
    text: str
    causes: tuple[str, ...]
    details: tuple[str, ...]
    drawing: Markup


@dataclass(frozen=True)
class _Row:
    """A row of the map: the link, its findings with the tint of the worst, the file's numbers, the cells."""

    name: str
    line: int
    tint: str
    findings: list[str]
    stated: tuple[str, ...]
    cells: list[_Cell]


def audit_page(audit: Audit) -> str:
    """Return the audit as one self-contained HTML page."""
    heads = [(one.name, ": ".join(filter(None, (one.version, one.settings)))) for one in audit.columns]
    found: dict[str, list[LintFinding]] = {}
    for finding in by_severity(audit.findings):
        found.setdefault(finding.link, []).append(finding)
    wrong = {finding.link for finding in impossible(audit)}
    known = repeated(audit)
    rows = [
        _Row(
            link.name,
            link.line,
            TINTS[found[link.name][0].severity] if link.name in found else "none",
            [f"{one.severity}: {one.rule}" for one in found.get(link.name, ())],
            _stated(link),
            [
                _cell(
                    link,
                    column.name,
                    column.outcome,
                    impossible=link.name in wrong,
                    repeated=(link.name, column.name) in known,
                )
                for column in audit.columns
            ],
        )
        for link in audit.links
    ]
    file, other = Path(audit.file).name, Path(audit.compared).name
    where = "both files" if audit.compared else "every importer"
    maps = [("link", f"Every link in {where}", rows)]
    if joints := [_joint_row(audit, joint) for joint in moving_joints(audit)]:
        maps.append(("joint", f"Every joint in {where}", joints))
    return page(
        audit_document(audit),
        "audit.html",
        maps=maps,
        stated=f"in {file}" if audit.compared else "in the file",
        held=f"in {other}" if audit.compared else "in the engine",
        heads=heads,
        rows=rows,
        file=audit.file,
        sha256=audit.sha256,
    )


def _joint_row(audit: Audit, joint: JointAudit) -> _Row:
    cells = []
    for column in audit.columns:
        one = joint.held.get(column.name)
        if one is None:
            cells.append(_without(column.outcome))
            continue
        tint = (
            "fault" if one.state == "absent" else "bad" if one.causes else "open" if one.not_held else "good"
        )
        held = () if one.held is None else tuple(joint_numbers(one.held))
        cells.append(_Cell(tint, one.state, (*one.causes, *one.not_held), held, Markup("")))
    stated = (joint.stated.kind, *joint_numbers(joint.stated))
    return _Row(joint.name, joint.stated.line, "none", [], stated, cells)


def _stated(link: LinkAudit) -> tuple[str, ...]:
    if link.stated is None:
        return (link.unread or "no inertia in the file",)
    return (*_numbers(link.stated), *filter(None, (link.derived,)))


def _numbers(body: Body) -> tuple[str, ...]:
    centre, moments, products = (
        ", ".join(number(float(value), 5) for value in values)
        for values in (body.centre_m, np.diag(body.inertia_kg_m2), body.inertia_kg_m2[[0, 0, 1], [1, 2, 2]])
    )
    tensor = f"I xx, yy, zz ({moments}) kg m²", f"I xy, xz, yz ({products}) kg m²"
    return f"m {number(body.mass_kg, 6)} kg", f"c ({centre}) m", *tensor


def _without(outcome: str) -> _Cell:
    """Return the cell of an importer that holds nothing."""
    return _Cell("none" if outcome in ("ok", "unsupported") else "fault", outcome, (), (), Markup(""))


def _cell(link: LinkAudit, name: str, outcome: str, *, impossible: bool, repeated: bool) -> _Cell:
    one = link.held.get(name)
    if one is None:
        return _without(outcome)
    text: str = one.state
    if one.difference is not None and one.state != "agrees":
        text = f"{one.state}: {scientific(one.difference.largest)}"
    details = () if one.held is None else _numbers(one.held)
    spin = link.spins.get(name)
    if spin is not None:
        texts = {True: "like the file's body", False: "off"}
        for how, error in (("as imported", spin.held_rad), ("imported alone", spin.excerpt_rad)):
            follows = spin.follows(error)
            if follows is not None and error is not None:
                details += (f"{how}, spins {texts[follows]}: {scientific(error)} rad after 1 s",)
    tint = tint_of(one)
    if impossible and tint in ("good", "floor"):
        tint, text = "open", f"{text}, but no body has these numbers"
    causes = () if repeated else one.causes  # the sentence on the importer states it
    return _Cell(tint, text, causes, details, _ellipsoids(one, name))


def _ellipsoids(one: LinkImport, importer: str) -> Markup:
    """Draw the equivalent uniform ellipsoids of both bodies about their centres of mass, to one scale."""
    if one.held is None or one.expected is None or not one.held.possible or not one.expected.possible:
        return Markup("")
    outlines = [
        (kind, _outline(body), _projected(body.centre_m))
        for kind, body in (("true", one.expected), ("held", one.held))
    ]
    points = np.concatenate([outline + centre for _, outline, centre in outlines])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = 0.9 * _VIEW / max(float(np.max(high - low)), 1e-300)
    middle = 0.5 * (low + high)
    paths = []
    for kind, outline, centre in outlines:
        xy = (outline + centre - middle) * scale
        at = (centre - middle) * scale
        line = "L".join(f"{x:.1f} {-y:.1f}" for x, y in xy)
        paths.append(
            f'<path class="{kind}" d="M{line}Z"/>'
            f'<circle class="{kind}" cx="{at[0]:.1f}" cy="{-at[1]:.1f}" r="1.6"/>'
        )
    half = _VIEW / 2.0
    label = escape("ellipsoids of inertia: dashed as stated, solid as held")
    colour = engine_colour(importer.partition(":")[0])
    return Markup(
        f'<svg class="engine-{colour}" viewBox="{-half} {-half} {_VIEW} {_VIEW}" width="{_VIEW:.0f}" '
        f'height="{_VIEW:.0f}" role="img" aria-label="{label}">{"".join(paths)}</svg>'
    )


def _projected(vector: Array) -> Array:
    return np.asarray(_screen() @ vector)


def _screen() -> Array:
    """Return the two axes of the drawing (2, 3): to the right and upwards."""
    azimuth, elevation = _CAMERA
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    view_axis = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    return np.array([right, np.cross(view_axis, right)])


def _outline(body: Body) -> Array:
    """Return the outline (n, 2) of the uniform ellipsoid with these moments: S = P A diag(a^2) A^T P^T."""
    moments, axes = body.principal
    squares = np.maximum(2.5 / body.mass_kg * (moments.sum() - 2.0 * moments), 0.0)
    P = _screen()
    shadow = P @ (axes * squares) @ axes.T @ P.T
    values, vectors = np.linalg.eigh(shadow)
    angle = np.linspace(0.0, 2.0 * math.pi, _POINTS, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray((vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * circle)).T)
