"""Audit a model file: read it exactly, import it in each engine's worker, compare, lint and spin."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np

from bodycheck._util.distributions import installed
from bodycheck._util.errors import InputError, UnavailableError, WorkerLostError
from bodycheck._util.formatting import suggestion
from bodycheck._util.shard import Shard
from bodycheck._util.untrusted import read_bytes
from bodycheck.adapters.engine_names import engine_fault, pin_of
from bodycheck.adapters.importers import (
    ImportedLink,
    engines_with_importers,
    importer,
)
from bodycheck.adapters.registry import distribution_of
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.audit.audit import (
    SAME,
    SINGLE,
    Audit,
    Body,
    Difference,
    ImporterColumn,
    LinkAudit,
    LinkImport,
    MatrixComparison,
    State,
)
from bodycheck.audit.audit_imports import import_once, import_request, matrices_once
from bodycheck.audit.audit_joints import HeldJoints, audited_joints
from bodycheck.audit.audit_matrix import compared_matrices
from bodycheck.audit.causes import body_causes, with_issue
from bodycheck.audit.lint import lint
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink
from bodycheck.scenarios.model_files.rewriting import Change, changed_text

TIMEOUT_S = 60.0
_IMPORT_S = 1.0  # time limit per link, beyond a start


@dataclass(frozen=True)
class AuditOptions:
    """engines: names or NAME==VERSION, none for the linter alone. timeout_s: of one import.

    shard: the part of the links to spin; every shard imports and compares all links. matrices: compare mass
    matrices too, which takes most of the time of a large model.
    """

    engines: Sequence[str] | None = None
    spins: bool = True
    matrices: bool = True
    timeout_s: float = TIMEOUT_S
    shard: Shard | None = None

    def spins_link(self, name: str) -> bool:
        """Whether to spin a link."""
        return self.spins and (self.shard is None or spins_in(self.shard, name))


def spins_in(shard: Shard, link: str) -> bool:
    """Whether a shard spins a link."""
    return shard.has("spin", link)


@dataclass
class Imported:
    """One importer's links by name, or how its import ended."""

    column: ImporterColumn
    links: Mapping[str, ImportedLink] = field(default_factory=dict)
    joints: HeldJoints | None = None
    matrix: MatrixComparison | None = None
    discarded: Mapping[str, str] = field(default_factory=dict)


def audit(path: Path, options: AuditOptions) -> Audit:
    """Return the audit of a file.

    Raises InputError if the file or the engines cannot be used, UnavailableError if none is installed. An
    importer that crashes, hangs or refuses the file gives a column that states this.
    """
    engines = checked_engines(options.engines)
    model = read_model(path)
    if options.engines is None and model.format == "usd":
        engines = []  # no importer reads it
    elif options.engines is None and not engines:
        raise UnavailableError(
            f"{path}: no engine that imports it is installed: pip install 'bodycheck[engines]'; "
            "--lint checks the file alone"
        )
    # products of extreme numbers overflow: their differences are infinite
    with closing(EnginePool()) as pool, np.errstate(all="ignore"):
        return imported_audit(pool, model, engines, options)


def imported_audit(
    pool: EnginePool, model: ModelFile, engines: Sequence[str], options: AuditOptions
) -> Audit:
    """Return the audit of a model that was read, by the engines of a pool."""
    imported = [one for engine in engines for one in _imports(pool, engine, model, options)]
    links = [link_audit(model, link, imported) for link in model.links]
    if options.spins and imported:
        from bodycheck.audit.audit_spins import with_spins

        columns = [one.column for one in imported]
        links = [
            with_spins(pool, model, link, columns, options.timeout_s)
            if options.spins_link(link.name)
            else link
            for link in links
        ]
    held = {one.column.name: (one.column.engine, one.joints) for one in imported if one.joints is not None}
    joints, orders = audited_joints(model, held)
    return Audit(
        str(model.path),
        model.format,
        sha256(read_bytes(model.path)).hexdigest(),
        tuple(one.column for one in imported),
        tuple(links),
        tuple(lint(model)),
        tuple(str(other) for other in model.outside()),
        model.notes,
        {one.column.name: extra for one in imported if (extra := _extra(model, one))},
        joints=joints,
        matrices={one.column.name: one.matrix for one in imported if one.matrix is not None},
        orders=orders,
    )


def checked_engines(requested: Sequence[str] | None) -> list[str]:
    """Return the engines to audit: by default all installed ones with an importer.

    Raises InputError for a name that is unknown or has no importer.
    """
    known = engines_with_importers()
    if requested is None:
        return [name for name in known if installed(distribution_of(name) or name) is not None]
    for name in requested:
        if (fault := engine_fault(name)) is not None:
            raise InputError(f"--engine {fault}")
        if base_engine(name) not in known:
            raise InputError(f"--engine {name}: has no importer of model files{suggestion(name, known)}")
    return list(dict.fromkeys(requested))


def base_engine(engine: str) -> str:
    """Return the engine of NAME or NAME==VERSION."""
    pin = pin_of(engine)
    return engine if pin is None else pin.engine


def _imports(pool: EnginePool, engine: str, model: ModelFile, options: AuditOptions) -> Iterable[Imported]:
    reads = importer(base_engine(engine))
    assert reads is not None
    variants = reads.FLAGS.get(model.format)
    if variants is None:
        yield Imported(
            ImporterColumn(engine, "", "default", "", "unsupported", f"does not read {model.format}")
        )
        return
    timeout_s = max(options.timeout_s, _IMPORT_S * len(model.links))
    for flags, settings in variants.items():
        request = import_request(model.path, model.format, flags)
        found, outcome, message = import_once(pool, engine, request, timeout_s)
        version = _version(pool, engine)
        column = ImporterColumn(engine, version, flags, settings, outcome, message)
        if outcome != "ok":
            yield Imported(column)
            continue
        named = _named(model, found)
        discarded = _discarded(pool, engine, model, flags, named, timeout_s)
        joints = HeldJoints.of(found, named, model)
        matrix = None
        if options.matrices and any(joint.motion != "fixed" for link in model.links for joint in link.joints):
            matrix = compared_matrices(model, joints, *matrices_once(pool, engine, request, timeout_s))
        yield Imported(column, named, joints, matrix, discarded)


def _version(pool: EnginePool, engine: str) -> str:
    try:
        return pool.announced(engine).version
    except (UnavailableError, WorkerLostError):
        return ""


def _named(model: ModelFile, found: Sequence[ImportedLink]) -> dict[str, ImportedLink]:
    """Return name -> link.

    Engines leave the names of MJCF's nameless bodies empty, and those of SDFormat's models out, but keep the
    order.
    """
    if model.format != "urdf" and len(found) == len(model.links):
        pairs = list(zip(model.links, found, strict=True))
        if all(
            found_link.name in ("", link.name, link.name.rpartition("::")[2]) for link, found_link in pairs
        ):
            return {link.name: found_link for link, found_link in pairs}
    named: dict[str, ImportedLink] = {}
    for found_link in found:
        named.setdefault(found_link.name, found_link)
    return named


def _discarded(
    pool: EnginePool,
    engine: str,
    model: ModelFile,
    flags: str,
    before: Mapping[str, ImportedLink],
    timeout_s: float,
) -> dict[str, str]:
    """Return link -> where a tensor comes from that does not follow the file's, found by two more imports."""
    suspects = []
    for link in model.links:
        if model.format != "mjcf" and link.name in before and link.stated is not None:
            difference = Difference.between(Body.of(link.stated.in_link), _body(before[link.name]))
            if difference.inertia > SINGLE:
                suspects.append(link.name)
    if not suspects:
        return {}

    def after(change: Change) -> Mapping[str, ImportedLink]:
        with tempfile.TemporaryDirectory(prefix="bodycheck-audit-") as folder:
            path = Path(folder) / model.path.name
            path.write_text(changed_text(model, change), encoding="utf-8")
            request = import_request(path, model.format, flags)
            found, _, _ = import_once(pool, engine, request, timeout_s)
        return _named(model, found)

    altered = after("tensors changed")
    unmoved = [name for name in suspects if name in altered and _same_tensor(before[name], altered[name])]
    if not unmoved:
        return {}
    shapeless = after("no collision shapes")
    return {
        name: "not that of the file, whatever the file says"
        if name not in shapeless
        else f"{'a placeholder' if np.any(before[name].inertia_kg_m2) else 'zero'} in its place"
        if _same_tensor(before[name], shapeless[name])
        else "recomputed from the collision shape"
        for name in unmoved
    }


def _same_tensor(a: ImportedLink, b: ImportedLink) -> bool:
    first, second = np.array(a.inertia_kg_m2), np.array(b.inertia_kg_m2)
    return bool(np.max(np.abs(first - second)) <= SAME * np.max(np.abs(first)))


def _body(link: ImportedLink) -> Body:
    return Body(link.mass, np.array(link.centre_m), np.array(link.inertia_kg_m2))


def link_audit(model: ModelFile, link: ModelLink, imported: Sequence[Imported]) -> LinkAudit:
    """Return the body of a link as stated, and as each importer holds it."""
    stated = None if link.stated is None else Body.of(link.stated.in_link)
    comparisons = {
        one.column.name: compared(model, link, one) for one in imported if one.column.outcome == "ok"
    }
    derived = "" if link.stated is None else link.stated.derived
    return LinkAudit(link.name, link.place, stated, derived, link.unread, comparisons)


def compared(model: ModelFile, link: ModelLink, imported: Imported) -> LinkImport:
    """Return what one importer holds of a link, with the causes of differences."""
    link_read = imported.links.get(link.name)
    absent = frozenset(one.name for one in model.links if one.name not in imported.links)
    is_base = model.format == "urdf" and link.parent is None and link.name != "world"
    if link_read is None:
        into = _merged_into(model, link, absent)
        if not into:
            return LinkImport("absent", causes=("the import has no link of this name",))
        cause = f"links merged: part of {into}"
        if into == "the world":
            cause = "links merged into the world: fixed, so that its mass and inertia have no effect"
        return LinkImport("merged", causes=(cause,), into=into, fixed=is_base and into == "the world")
    members = model.members(link.name, absent)
    merged = tuple(one.name for one, _ in members[1:])
    combined = model.merged(link.name, absent)
    fixed = is_base and link_read.parent < 0 and all(joint.motion == "fixed" for joint in link_read.joints)
    body = _body(link_read)
    if combined is None:
        return LinkImport("not computed", held=body, merged=merged, fixed=fixed)
    has_inertia = link.stated is not None or any(model.by_name[name].stated for name in merged)
    expected = Body.of(combined) if has_inertia else None
    nothing = Body(0.0, np.zeros(3), np.zeros((3, 3)))
    difference = Difference.between(expected or nothing, body)
    if expected is None and body.mass_kg == 0.0:
        difference = Difference(0.0, 0.0, 0.0)  # where the centre of nothing is does not matter
    causes: tuple[str, ...] = ()
    if difference.largest > SAME:
        causes = body_causes(
            model, members, expected, body, difference, imported.discarded.get(link.name, "")
        )
    causes = tuple(with_issue(imported.column.engine, cause) for cause in causes)
    return LinkImport(_state(difference), expected, body, difference, causes, merged, fixed=fixed)


def _state(difference: Difference) -> State:
    if difference.largest > SINGLE:
        return "differs"
    return "agrees" if difference.largest <= SAME else "rounded"


def _merged_into(model: ModelFile, link: ModelLink, absent: frozenset[str]) -> str:
    """Return the link that a link with fixed joints became part of; "" if it just is not there."""
    at = link
    while at.name in absent:
        if at.parent is None:
            return "the world" if model.format == "urdf" or at.joint is None or at.joint.fixed else ""
        if at.joint is not None and not at.joint.fixed:
            return ""
        at = model.by_name[at.parent]
    return at.name


def _extra(model: ModelFile, imported: Imported) -> tuple[str, ...]:
    return tuple(name for name in imported.links if name not in model.by_name)
