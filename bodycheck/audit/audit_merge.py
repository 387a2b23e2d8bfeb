"""Merge the shards of an audit: the spins of all links, and whether the machines' importers agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.shard import Shard
from bodycheck.audit.audit import Audit, read_audit, write_audit
from bodycheck.audit.audit_page import audit_page
from bodycheck.audit.audit_run import spins_in
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.sentinels import MachineAnswer, machine_facts
from bodycheck.reports.run_files.writer import atomic_folder
from bodycheck.runs.manifest import machine, software
from bodycheck.runs.shards import StoredShard, all_shards, machine_findings


@dataclass(frozen=True, eq=False)
class _Part(StoredShard):
    """A shard with its audit."""

    audit: Audit

    @cached_property
    def answers(self) -> Sequence[MachineAnswer]:
        """What each importer holds of all links, which every shard imports."""
        columns = self.audit.columns
        return [MachineAnswer(c.name, c.version, c.outcome, _held(self.audit, c.name)) for c in columns]


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
    findings = machine_findings(parts)
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


def _held(audit: Audit, importer: str) -> dict[str, Array]:
    """Return the numbers that an importer holds of each link."""
    held = [(link.name, link.held[importer].held) for link in audit.links if importer in link.held]
    return {
        f"{attribute} of {name}": np.asarray(getattr(body, attribute))
        for name, body in held
        if body is not None
        for attribute in ("mass_kg", "centre_m", "inertia_kg_m2")
    }
