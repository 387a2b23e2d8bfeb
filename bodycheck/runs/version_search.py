"""Find the releases of an engine that differ in a measure or an audit; each runs in its own environment."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count, names, number, suggestion
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.engine_names import Pin
from bodycheck.adapters.importers import importer
from bodycheck.adapters.versions.uv import releases
from bodycheck.adapters.workers.engine_pool import EnginePool, announced
from bodycheck.reports.comparison.compare import renamed
from bodycheck.reports.comparison.release_results import (
    Found,
    OneMeasure,
    ReleaseFinding,
    Track,
    changes,
    comparable,
    every_change,
)
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import ProgressFactory, no_progress
from bodycheck.runs.runner import run_selection
from bodycheck.runs.selection import Selection, checked_scenarios
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.model_files import read_model

if TYPE_CHECKING:
    from bodycheck.reports.audit.audit import Audit
    from bodycheck.scenarios.model_files.model_file import ModelFile

_NO_METHOD = "no such method"


@dataclass(frozen=True)
class ReleaseSearch:
    """A search for changes of a measure of an engine's methods on one scenario.

    since, until: the first and the last release to consider; until None: the newest. method None: all
    methods. dt_s, allow_code: as in a run. every: run every release and skip none. thresholds: the size above
    which a change counts.
    """

    engine: str
    since: str
    until: str | None
    scenario: str
    method: str | None
    measure: str
    dt_s: Sequence[float] | None
    allow_code: bool = False
    every: bool = False
    thresholds: Thresholds = DEFAULT_THRESHOLDS


@dataclass(frozen=True, eq=False)
class _Release:
    """A release that was run: its engine, the requested methods that it has, and their tables."""

    engine: Engine
    methods: Mapping[str, Method]
    tables: Tables | None


def search(
    request: ReleaseSearch,
    options: Request,
    announce: Callable[[str], None],
    progress_for: Callable[[str], ProgressFactory] = lambda name: no_progress,  # noqa: ARG005 - a factory per release
) -> Found:
    """Run every release, or bisect between the first and the last release to find where the measure changed.

    announce: called with the name of each release before it runs. progress_for: name -> what shows the
    progress of that release. Releases that cannot be installed or run are skipped. Raises InputError if the
    input is wrong or no release can be run.
    """
    comparable(request.measure)
    scenario_spec, scenario = _one_scenario(request)
    versions = releases(request.engine, request.since, request.until)
    runs: dict[str, _Release | str] = {}

    def run(version: str) -> _Release | str:
        if version not in runs:
            announce(Pin(request.engine, version).name)
            make_progress = progress_for(Pin(request.engine, version).name)
            runs[version] = _run(request, version, (scenario_spec, scenario), options, make_progress)
        return runs[version]

    ends = [
        next((found for version in order if isinstance(found := run(version), _Release)), None)
        for order in (versions, versions[::-1])
    ]
    methods = {name: method for end in ends if end is not None for name, method in end.methods.items()}
    if not methods:
        raise InputError(_failure_text(request, runs))
    found_by = every_change if request.every else changes
    tracks = []
    for name, method in methods.items():
        one = _measure_of(request, scenario, method)
        findings: dict[str, ReleaseFinding] = {}
        changed = found_by(versions, partial(_finding, run, one, findings), one.differ)
        tracks.append(Track(name, findings, changed))
    failed = {version: why for version, why in runs.items() if isinstance(why, str)}
    return Found(
        request.engine, scenario.name, request.measure, versions, tuple(tracks), failed, request.every
    )


def _one_scenario(request: ReleaseSearch) -> tuple[str, Scenario]:
    """Return the spec and the requested scenario; raises InputError if the spec names several."""
    first, *others = checked_scenarios([request.scenario], request.dt_s, allow_code=request.allow_code)
    if others:
        raise InputError(
            f"--scenario {request.scenario}: names {len(others) + 1} scenarios; give one of them"
        )
    return first


def _measure_of(request: ReleaseSearch, scenario: Scenario, method: Method) -> OneMeasure:
    """Return the measure of a method at the finest requested step or tolerance."""
    fineness = method.setting(min(request.dt_s or scenario.steps)).fineness
    key = scenario.name, request.engine, method.name
    return OneMeasure(*key, request.measure, method.control, fineness, request.thresholds)


def _finding(
    run: Callable[[str], _Release | str], one: OneMeasure, findings: dict[str, ReleaseFinding], version: str
) -> ReleaseFinding | None:
    """Return and store the value of a measure in a release; None if the release cannot be run."""
    release = run(version)
    if isinstance(release, str):
        return None
    if release.tables is None or one.method not in release.methods:
        findings[version] = ReleaseFinding(_NO_METHOD, "")
    else:
        findings[version] = one.finding(release.tables)
    return findings[version]


def _run(
    request: ReleaseSearch,
    version: str,
    scenario: tuple[str, Scenario],
    options: Request,
    make_progress: ProgressFactory,
) -> _Release | str:
    """Run one release, or return why it cannot be run."""
    name = Pin(request.engine, version).name
    engine = announced([name])[name]
    if isinstance(engine, str):
        return engine
    methods = {
        method.name: method
        for method in engine.methods.values()
        if (method.name == request.method if request.method else not method.on_request)
    }
    if not methods:
        return _Release(engine, methods, None)
    selection = Selection(
        scenarios=(scenario,),
        methods=tuple((engine, method) for method in methods.values()),
        unavailable={},
        dt_s=tuple(request.dt_s) if request.dt_s else None,
        tolerances=None,
    )
    with make_progress(selection.cases_listed()) as progress:
        measured = run_selection(selection, options, Identity.new(), journal=None, progress=progress)
    return _Release(engine, methods, renamed(measured, {name: request.engine}))


def _failure_text(request: ReleaseSearch, runs: Mapping[str, _Release | str]) -> str:
    """Return why nothing was found: every release failed, or no release has the method."""
    engines = [release.engine for release in runs.values() if isinstance(release, _Release)]
    if not engines:
        return "\n".join(str(why) for why in runs.values())
    has = dict.fromkeys(name for engine in engines for name in engine.methods)
    instead = suggestion(str(request.method), has)
    return f"--method {request.method}: {request.engine} has no such method{instead}"


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
            audits[version] = _audit_release(name, model, timeout_s)
        return audits[version]

    tracks = []
    for flags in reads.FLAGS[model.format]:
        findings: dict[str, ReleaseFinding] = {}
        search = every_change if every else changes
        found = search(
            versions, partial(_audit_finding, audited, flags, findings), lambda a, b: a.value != b.value
        )
        tracks.append(Track(flags, findings, found))
    failed = {version: why for version, why in audits.items() if isinstance(why, str)}
    if len(failed) == len(audits):
        raise InputError("\n".join(failed.values()))
    return Found(engine, file.name, "audit", tuple(versions), tuple(tracks), failed, every)


def _audit_release(name: str, model: ModelFile, timeout_s: float) -> Audit | str:
    from bodycheck.runs.audit_run import AuditOptions, imported_audit

    engine = announced([name])[name]
    if isinstance(engine, str):
        return engine
    with closing(EnginePool()) as pool:
        return imported_audit(pool, model, [name], AuditOptions(spins=False, timeout_s=timeout_s))


def _audit_finding(
    audited: Callable[[str], Audit | str], flags: str, findings: dict[str, ReleaseFinding], version: str
) -> ReleaseFinding | None:
    found = audited(version)
    if isinstance(found, str):
        return None
    findings[version] = ReleaseFinding(_audit_summary(found, flags), "")
    return findings[version]


def _audit_summary(audit: Audit, flags: str) -> str:
    """Return the audit of one importer in one line: states of links, largest difference, causes, joints."""
    from bodycheck.reports.audit.audit_summary import joint_groups

    (column,) = (one for one in audit.columns if one.flags == flags)
    if column.outcome != "ok":
        return column.outcome
    comparisons = [link.held[column.name] for link in audit.links]
    states = Counter(one.state for one in comparisons)
    states_text = names([f"{amount} {state}" for state, amount in sorted(states.items())])
    differing = [one for one in comparisons if one.state == "differs"]
    largest = max((one.difference.largest for one in differing if one.difference is not None), default=0.0)
    causes = dict.fromkeys(cause for one in differing for cause in one.causes)
    text = states_text if not causes else f"{states_text}, by up to {number(largest, 2)}: {'; '.join(causes)}"
    joints = [group for group in joint_groups(audit) if group.importer == column.name]
    return "; ".join([text, *(f"{group.kind} in {count(len(group.joints), 'joint')}" for group in joints)])
