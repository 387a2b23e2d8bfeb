"""Find the releases of an engine that differ in a measure; each runs in its own environment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Generic, TypeVar

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.engine_names import Pin
from bodycheck.adapters.versions.uv import releases
from bodycheck.adapters.workers.engine_pool import announced
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
from bodycheck.scenarios.reader import AnyScenario

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


_Run = TypeVar("_Run")


@dataclass(frozen=True, eq=False)
class Releases(Generic[_Run]):
    """The releases of an engine, each of which is run when it is first needed.

    run_one: name -> what running it gives, or why it cannot be run. announce: called before, with the name.
    """

    engine: str
    versions: tuple[str, ...]
    run_one: Callable[[str], _Run | str]
    announce: Callable[[str], None]
    every: bool
    runs: dict[str, _Run | str] = field(default_factory=dict)

    def run(self, version: str) -> _Run | str:
        """Return what running a release gave, or why it cannot be run."""
        if version not in self.runs:
            name = Pin(self.engine, version).name
            self.announce(name)
            self.runs[version] = self.run_one(name)
        return self.runs[version]

    def track(
        self,
        name: str,
        finding: Callable[[_Run], ReleaseFinding],
        differ: Callable[[ReleaseFinding, ReleaseFinding], bool],
    ) -> Track:
        """Find where a finding changes: in every release, or by bisection."""
        findings: dict[str, ReleaseFinding] = {}

        def found(version: str) -> ReleaseFinding | None:
            if isinstance(release := self.run(version), str):
                return None
            findings[version] = finding(release)
            return findings[version]

        return Track(name, findings, (every_change if self.every else changes)(self.versions, found, differ))

    def found(self, subject: str, measure: str, tracks: Iterable[Track]) -> Found:
        """Return the result of a search; raises InputError if no release can be run."""
        tracks = tuple(tracks)
        failed = {version: why for version, why in self.runs.items() if isinstance(why, str)}
        if len(failed) == len(self.runs):
            raise InputError("\n".join(failed.values()))
        return Found(self.engine, subject, measure, self.versions, tracks, failed, self.every)


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

    def run_one(name: str) -> _Release | str:
        return _run(request, name, (scenario_spec, scenario), options, progress_for(name))

    versions = releases(request.engine, request.since, request.until)
    found = Releases(request.engine, versions, run_one, announce, request.every)
    ends = [
        next((one for version in order if isinstance(one := found.run(version), _Release)), None)
        for order in (versions, versions[::-1])
    ]
    methods = {name: method for end in ends if end is not None for name, method in end.methods.items()}
    if not methods and any(ends):
        raise InputError(_no_method(request, found.runs))

    def track(method: Method) -> Track:
        one = _measure_of(request, scenario, method)
        return found.track(method.name, partial(_finding, one), one.differ)

    return found.found(scenario.name, request.measure, map(track, methods.values()))


def _one_scenario(request: ReleaseSearch) -> tuple[str, AnyScenario]:
    """Return the spec and the requested scenario; raises InputError if the spec names several."""
    first, *others = checked_scenarios([request.scenario], request.dt_s, allow_code=request.allow_code)
    if others:
        raise InputError(
            f"--scenario {request.scenario}: names {len(others) + 1} scenarios; give one of them"
        )
    return first


def _measure_of(request: ReleaseSearch, scenario: AnyScenario, method: Method) -> OneMeasure:
    """Return the measure of a method at the finest requested step or tolerance."""
    fineness = method.setting(min(request.dt_s or scenario.steps)).fineness
    key = scenario.name, request.engine, method.name
    return OneMeasure(*key, request.measure, method.control, fineness, request.thresholds)


def _finding(one: OneMeasure, release: _Release) -> ReleaseFinding:
    """Return the value of a measure in a release."""
    if release.tables is None or one.method not in release.methods:
        return ReleaseFinding(_NO_METHOD, "")
    return one.finding(release.tables)


def _run(
    request: ReleaseSearch,
    name: str,
    scenario: tuple[str, AnyScenario],
    options: Request,
    make_progress: ProgressFactory,
) -> _Release | str:
    """Run one release, or return why it cannot be run."""
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


def _no_method(request: ReleaseSearch, runs: Mapping[str, _Release | str]) -> str:
    """Return that no release has the method, and which is meant."""
    engines = [release.engine for release in runs.values() if isinstance(release, _Release)]
    has = dict.fromkeys(name for engine in engines for name in engine.methods)
    instead = suggestion(str(request.method), has)
    return f"--method {request.method}: {request.engine} has no such method{instead}"
