"""Merge the shards of an audit: the spins of all links, and whether the machines' importers agree."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.shard import Shard
from bodycheck.audit.audit import Audit, Body, Difference, read_audit, write_audit
from bodycheck.audit.audit_page import audit_page
from bodycheck.audit.audit_run import spins_in
from bodycheck.reports.run_files.sentinels import machine_facts
from bodycheck.reports.run_files.writer import atomic_folder
from bodycheck.runs.manifest import machine, software
from bodycheck.runs.shards import StoredShard, all_shards, machine_findings


@dataclass(frozen=True, eq=False)
class _Part(StoredShard):
    """A shard with its audit."""

    audit: Audit


def write_shard(audit: Audit, shard: Shard, out: Path) -> None:
    """Write a shard of an audit to a new folder."""
    with atomic_folder(out) as folder:
        write_audit(audit, folder, shard=str(shard), machine={**software(), **machine()})


def merge_audits(folders: Sequence[Path], out: Path) -> tuple[Audit, list[str]]:
    """Write the audit that these shards are parts of, and its page, to `out`; return it and the findings.

    Raises InputError where a folder is not a shard, a shard is missing or given twice, or the shards are not
    of one request.
    """
    parts = all_shards([_part(folder) for folder in folders])
    first = parts[0].audit
    links = [
        replace(link, spins=_owner(parts, link.name).audit.links[index].spins)
        for index, link in enumerate(first.links)
    ]
    audit = replace(first, links=tuple(links))
    findings = [*machine_findings(parts), *_disagreements(parts)]
    with atomic_folder(out) as folder:
        write_audit(audit, folder, bodycheck=version("bodycheck"), findings=findings)
        (folder / "audit.html").write_text(audit_page(audit), encoding="utf-8")
    return audit, findings


def _part(folder: Path) -> _Part:
    audit, facts = read_audit(folder)
    if not isinstance(facts.get("shard"), str) or not isinstance(facts.get("machine"), dict):
        raise InputError(f"{folder}: a whole audit (expected a folder written with --shard)")
    engines = {column.engine: column.version for column in audit.columns}
    same = {
        f"the SHA-256 of {audit.file}": audit.sha256,
        "links": [link.name for link in audit.links],
        "importers": [column.name for column in audit.columns],
    }
    machine = machine_facts(facts["machine"]) | engines
    return _Part(folder, Shard.parse(facts["shard"]), same, machine, audit)


def _owner(parts: Sequence[_Part], link: str) -> _Part:
    return next(part for part in parts if spins_in(part.shard, link))


def _disagreements(parts: Sequence[_Part]) -> Iterator[str]:
    """Yield which importers hold other numbers, or end otherwise, on some machines than on the first.

    All shards import the whole file: its links are the sentinels.
    """
    first, *others = parts
    for other in others:
        for index, column in enumerate(first.audit.columns):
            its = other.audit.columns[index]
            if its.outcome != column.outcome:
                yield (
                    f"{column.name}: ended {its.outcome} in shard {other.shard}, and {column.outcome} in "
                    f"shard {first.shard}"
                )
        for own, link in zip(first.audit.links, other.audit.links, strict=True):
            for name in own.held.keys() & link.held.keys():
                digits = _digits(own.held[name].held, link.held[name].held)
                if digits is not None:
                    yield (
                        f"{name}: {link.name} as held in shard {other.shard} agrees with shard "
                        f"{first.shard} to {digits:.1f} digits"
                    )


def _digits(one: Body | None, other: Body | None) -> float | None:
    """Return to how many digits two bodies agree, None where they have the same bits or neither is held."""
    if one is None or other is None:
        return None if one is other else 0.0
    if _bits(one) == _bits(other):
        return None
    gap = Difference.between(one, other).largest
    return -math.log10(gap) if 0.0 < gap < 1.0 else 0.0


def _bits(body: Body) -> bytes:
    return np.array([body.mass_kg, *body.centre_m, *body.inertia_kg_m2.flat]).tobytes()
