"""Find the releases of an engine that differ in the audit of a file; each runs in its own environment."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count, names, number
from bodycheck.adapters.importers import importer
from bodycheck.adapters.versions.uv import releases
from bodycheck.adapters.workers.engine_pool import EnginePool, announced
from bodycheck.audit.audit import Audit
from bodycheck.audit.audit_run import AuditOptions, imported_audit
from bodycheck.audit.audit_summary import joint_groups
from bodycheck.reports.comparison.release_results import Found, ReleaseFinding
from bodycheck.runs.version_search import Releases
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.model_file import ModelFile


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
    found = Releases(engine, versions, lambda name: _audit_release(name, model, timeout_s), announce, every)
    tracks = (
        found.track(flags, partial(_audit_finding, flags), lambda a, b: a.value != b.value)
        for flags in reads.FLAGS[model.format]
    )
    return found.found(file.name, "audit", tracks)


def _audit_release(name: str, model: ModelFile, timeout_s: float) -> Audit | str:
    engine = announced([name])[name]
    if isinstance(engine, str):
        return engine
    with closing(EnginePool()) as pool:
        return imported_audit(pool, model, [name], AuditOptions(spins=False, timeout_s=timeout_s))


def _audit_finding(flags: str, audit: Audit) -> ReleaseFinding:
    """Return the audit of one importer in one line: states of links, largest difference, causes, joints."""
    (column,) = (one for one in audit.columns if one.flags == flags)
    if column.outcome != "ok":
        return ReleaseFinding(column.outcome, "")
    comparisons = [link.held[column.name] for link in audit.links]
    states = Counter(one.state for one in comparisons)
    states_text = names([f"{amount} {state}" for state, amount in sorted(states.items())])
    differing = [one for one in comparisons if one.state == "differs"]
    largest = max((one.difference.largest for one in differing if one.difference is not None), default=0.0)
    causes = dict.fromkeys(cause for one in differing for cause in one.causes)
    size = f"by up to a relative {number(largest, 2)}"
    text = f"{states_text}, {size}: {'; '.join(causes)}" if causes else states_text
    joints = [group for group in joint_groups(audit) if group.importer == column.name]
    of_joints = (f"{group.kind} in {count(len(group.joints), 'joint')}" for group in joints)
    return ReleaseFinding("; ".join([text, *of_joints]), "")
