"""Find the releases of an engine between which the audit of a model file changed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import names, number
from bodycheck.adapters.importers import importer
from bodycheck.adapters.versions.pins import Pin
from bodycheck.adapters.versions.uv import releases
from bodycheck.adapters.workers.engine_pool import EnginePool, announced
from bodycheck.reports.audit.audit import Audit
from bodycheck.reports.comparison.release_results import Finding, Found, Track, changes, every_change
from bodycheck.runs.audit_run import AuditOptions, imported_audit
from bodycheck.scenarios.model_files.model_file import ModelFile
from bodycheck.scenarios.model_files.model_reader import read_model


def audit_versions(
    engine: str,
    since: str,
    until: str | None,
    file: Path,
    *,
    every: bool,
    timeout_s: float,
    announce: Callable[[str], None],
) -> Found:
    """Audit a file in every release, or bisect between the first and the last one.

    announce: called with each release before it imports the file. Raises InputError if the input is
    wrong or no release can be run.
    """
    reads = importer(engine)
    model = read_model(file)
    if reads is None or model.format not in reads.FLAGS:
        raise InputError(f"--audit {file}: {engine} does not import {model.format.upper()}")
    versions = releases(engine, since, until)
    audits: dict[str, Audit | str] = {}

    def audited(version: str) -> Audit | str:
        if version not in audits:
            name = Pin(engine, version).name
            announce(name)
            audits[version] = _audit(name, model, timeout_s)
        return audits[version]

    tracks = []
    for flags in reads.FLAGS[model.format]:
        findings: dict[str, Finding] = {}
        search = every_change if every else changes
        found = search(versions, partial(_finding, audited, flags, findings), lambda a, b: a.value != b.value)
        tracks.append(Track(flags, findings, found))
    failed = {version: why for version, why in audits.items() if isinstance(why, str)}
    if len(failed) == len(audits):
        raise InputError("\n".join(failed.values()))
    return Found(engine, file.name, "audit", tuple(versions), tuple(tracks), failed, every)


def _audit(name: str, model: ModelFile, timeout_s: float) -> Audit | str:
    engine = announced([name])[name]
    if isinstance(engine, str):
        return engine
    with closing(EnginePool()) as pool:
        return imported_audit(pool, model, [name], AuditOptions(spins=False, timeout_s=timeout_s))


def _finding(
    audited: Callable[[str], Audit | str], flags: str, findings: dict[str, Finding], version: str
) -> Finding | None:
    found = audited(version)
    if isinstance(found, str):
        return None
    findings[version] = Finding(summary(found, flags), "")
    return findings[version]


def summary(audit: Audit, flags: str) -> str:
    """Return the audit of one importer in one line: states of the links, largest difference, causes."""
    (column,) = (one for one in audit.columns if one.flags == flags)
    if column.outcome != "ok":
        return column.outcome
    comparisons = [link.held[column.name] for link in audit.links]
    states = Counter(one.state for one in comparisons)
    states_text = names([f"{amount} {state}" for state, amount in sorted(states.items())])
    differing = [one for one in comparisons if one.state == "differs"]
    largest = max((one.difference.largest for one in differing if one.difference is not None), default=0.0)
    causes = dict.fromkeys(cause for one in differing for cause in one.causes)
    return states_text if not causes else f"{states_text}, by up to {number(largest, 2)}: {'; '.join(causes)}"
